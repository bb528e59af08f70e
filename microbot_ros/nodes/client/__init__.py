"""Clients that run, watch and ask the nodes of a rig from outside."""
