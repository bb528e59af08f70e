"""Command `microbot discover`."""
