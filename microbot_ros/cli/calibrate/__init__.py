"""`microbot calibrate`."""
