"""Bytes in and out: UDP, TCP and serial links, opened by URI."""
