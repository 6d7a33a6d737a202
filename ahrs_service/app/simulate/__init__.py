"""Flights that were never flown, on a link or in a file."""
