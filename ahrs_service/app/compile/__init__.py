"""Compilation ahead of time, and progress messages where a command has to wait for it."""
