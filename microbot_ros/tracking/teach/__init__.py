"""Learning what to follow, from examples or without any."""
