"""Time after which a test gives up waiting."""

HANG_S = 600.0
"""No measure of speed: events are waited for, and a machine at load 10 takes its time over them."""
