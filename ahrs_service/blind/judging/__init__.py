"""Judging of what is found in sealed recordings: scores, and rivals in the same table."""
