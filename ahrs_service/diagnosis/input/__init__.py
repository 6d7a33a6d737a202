"""From a recording and its reference to the misfit of its IMU."""
