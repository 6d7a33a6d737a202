"""A simulated autopilot that speaks MAVLink."""
