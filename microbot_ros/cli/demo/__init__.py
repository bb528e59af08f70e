"""`microbot demo`."""
