"""Dose and response: speed, turning and slip at each plateau of a commanded quantity."""
