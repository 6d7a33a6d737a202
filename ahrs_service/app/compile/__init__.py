"""Machine code ahead of time, and word of it where a command has to wait for it."""
