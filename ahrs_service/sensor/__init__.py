"""The one forward model of the sensor and its inverse."""
