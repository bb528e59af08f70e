"""Controllers, what they have in common, and the manager that runs and switches them."""
