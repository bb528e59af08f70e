"""The online estimator: a filter for each particle, and what all share."""
