"""Closed-loop coil control of magnetic Janus microrobots, and discovery of what a model misses."""

__version__ = '0.1.0'
