"""Blind tests of the diagnosis on recordings whose truth is sealed."""
