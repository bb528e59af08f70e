"""`microbot replay`."""
