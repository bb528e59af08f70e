"""Linking of detections to particles, from frame to frame."""
