"""Plans for many particles under one field."""
