"""Command `microbot replay`."""
