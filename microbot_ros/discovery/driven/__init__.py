"""Discovery that drives: what could still be, which commands tell most, and when to end."""
