"""Amplifiers without hardware: their protocols spoken at the end of a pseudo-terminal."""
