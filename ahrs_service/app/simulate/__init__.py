"""Simulated flights, on a link or in a file."""
