"""Cameras and files as sources of frames, each with its time of exposure and its number."""
