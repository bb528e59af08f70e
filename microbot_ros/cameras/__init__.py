"""Cameras and files as sources of frames, each with its moment of exposure and its number."""
