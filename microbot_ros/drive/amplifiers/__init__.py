"""Amplifiers, one folder for each protocol."""
