"""Which detection is which particle, from frame to frame."""
