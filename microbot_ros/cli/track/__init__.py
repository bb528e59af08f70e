"""Command `microbot track`."""
