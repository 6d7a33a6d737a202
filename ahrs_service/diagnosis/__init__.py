"""Where simulation and recording differ: locate it, name the physics left out, prove the gain."""
