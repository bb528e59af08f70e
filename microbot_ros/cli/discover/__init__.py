"""`microbot discover`."""
