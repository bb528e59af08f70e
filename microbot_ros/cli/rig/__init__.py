"""Commands for a running rig."""
