"""Learning a term where no effect of the library has a name for what is missing."""
