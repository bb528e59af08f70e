"""Sabertooth packet serial: two-channel controllers that listen and never answer."""
