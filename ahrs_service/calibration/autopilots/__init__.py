"""The autopilots' own parameters of calibration: ours as theirs, theirs as ours."""
