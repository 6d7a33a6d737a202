"""Flights drawn from what a class of airframe states, and the air that pushes them about."""
