"""Discovery that drives a rig: open questions, the most informative commands, and when to stop."""
