"""Checks of sessions, of residuals, and of predictions on held-out data."""
