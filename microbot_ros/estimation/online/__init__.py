"""Online estimator: a filter for each particle, and what all particles share."""
