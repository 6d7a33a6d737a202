"""The service as a MAVLink component: what it sends, requests and answers. Sans I/O."""
