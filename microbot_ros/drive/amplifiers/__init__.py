"""The amplifiers, one folder for each protocol."""
