"""Trajectories, scenarios and the simulated IMU with known truth."""
