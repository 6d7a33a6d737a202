"""A recording compared with its twin."""
