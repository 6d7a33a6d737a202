"""Making of sealed recordings: physics of its own, hidden in motion of its own."""
