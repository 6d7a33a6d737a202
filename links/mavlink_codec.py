"""MAVLink messages to and from bytes: the only importer of pymavlink."""

from pymavlink.dialects.v20 import all as dialect

__all__ = ["dialect"]
