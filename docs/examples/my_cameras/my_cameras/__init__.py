"""Cameras of our laboratory."""
