"""Detection in a picture: bodies, their kinds, and what stands still."""
