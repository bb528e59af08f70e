"""What the controllers share: courses, goals, the drift they learn."""
