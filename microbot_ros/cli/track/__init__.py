"""`microbot track`."""
