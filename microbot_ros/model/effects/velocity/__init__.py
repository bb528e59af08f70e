"""Effects on the velocity."""
