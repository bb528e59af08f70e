"""What runs, watches and asks the nodes of a rig from outside."""
