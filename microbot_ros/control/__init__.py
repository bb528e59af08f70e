"""Controllers, their shared parts, and the manager that runs and switches them."""
