"""Scoring of the findings in blind recordings, next to those of baselines."""
