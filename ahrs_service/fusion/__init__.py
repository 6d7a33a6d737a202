"""Alignment, strapdown, gates and the attitude filter: kernels on plain numbers."""
