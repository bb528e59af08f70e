"""Effects on what the camera reports."""
