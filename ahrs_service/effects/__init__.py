"""Physics beyond calibration: one file per effect, each adds its part to an ideal reading."""
