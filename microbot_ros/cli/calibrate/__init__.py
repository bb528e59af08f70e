"""Command `microbot calibrate`."""
