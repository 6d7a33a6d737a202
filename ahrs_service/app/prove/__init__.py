"""The locator of left-out physics, tested on sealed recordings."""
