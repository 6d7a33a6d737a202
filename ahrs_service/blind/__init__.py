"""Blind test recordings: their motion, physics and noise share no code with the fitting."""
