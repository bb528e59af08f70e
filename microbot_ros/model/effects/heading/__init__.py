"""Effects on the heading (stage 2)."""
