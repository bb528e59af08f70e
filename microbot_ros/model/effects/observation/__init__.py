"""Effects on what the camera reports (stage 4)."""
