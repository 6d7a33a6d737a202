"""The misfit without missing physics: its noise and likelihood."""
