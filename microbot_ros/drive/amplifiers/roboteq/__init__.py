"""Roboteq: two two-channel controllers, one line each."""
