"""Transports, MAVLink and recordings: bytes on one side, records on the other."""
