"""Checks of sessions, of what a model leaves, and of predictions on held-out data."""
