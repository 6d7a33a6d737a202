"""The Rerun viewer: blueprint, live stream and batch export."""
