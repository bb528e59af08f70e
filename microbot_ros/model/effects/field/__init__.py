"""Effects on the field."""
