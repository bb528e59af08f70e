"""Command `microbot demo`."""
