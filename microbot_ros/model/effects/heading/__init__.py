"""Effects on the heading."""
