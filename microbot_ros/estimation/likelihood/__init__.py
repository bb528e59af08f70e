"""Likelihood of a model on whole sessions, and estimates from it."""
