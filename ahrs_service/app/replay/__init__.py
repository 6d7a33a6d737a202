"""Recordings through the same estimator."""
