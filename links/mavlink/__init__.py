"""MAVLink as bytes and as readings: frames, messages, signatures."""
