"""Drift over temperature: how it is fitted, and what a fit is worth."""
