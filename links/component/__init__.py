"""The service as a MAVLink component: what it says, asks for and answers. Sans I/O."""
