"""Making of blind recordings: independently coded physics hidden in simulated motion."""
