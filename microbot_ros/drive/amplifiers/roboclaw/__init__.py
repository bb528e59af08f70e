"""RoboClaw packet serial: two two-channel controllers on one line."""
