"""Effects on the field (stage 1)."""
