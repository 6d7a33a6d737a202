"""The service on a link, live."""
