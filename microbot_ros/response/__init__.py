"""Dose and response: speed, turning and slip at each plateau of what was commanded."""
