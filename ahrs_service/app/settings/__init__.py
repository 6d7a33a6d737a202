"""The command `settings`: every setting with type, unit, value and meaning."""
