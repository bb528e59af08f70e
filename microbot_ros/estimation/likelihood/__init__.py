"""The likelihood of a model on whole sessions, and what rests on it."""
