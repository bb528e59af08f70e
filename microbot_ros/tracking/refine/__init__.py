"""Exact positions: fits to the pixels around each particle."""
