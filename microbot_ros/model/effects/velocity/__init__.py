"""Effects on the velocity (stage 3)."""
