"""Learned terms, for structure in the residual that no effect of the library explains."""
