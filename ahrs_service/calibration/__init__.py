"""From recordings of known poses, rates and temperatures to one sensor's calibration."""
