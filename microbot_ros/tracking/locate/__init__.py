"""Where in a picture something is: bodies, their kinds, what stands still."""
