"""Attitude of plain arrays."""
