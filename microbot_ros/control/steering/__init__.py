"""Shared parts of controllers: courses, goals, learned drift."""
