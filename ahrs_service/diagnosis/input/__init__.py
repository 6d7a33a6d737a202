"""The misfit of a recording's IMU to its reference."""
