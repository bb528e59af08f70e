"""Controllers, what they have in common, and the switchboard that runs and swaps them."""
