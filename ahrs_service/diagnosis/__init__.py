"""Where simulation and recording differ: locate it, name the missing physics, prove the gain."""
