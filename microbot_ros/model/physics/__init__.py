"""Spheres in a fluid: drag, diffusion, inertia, the floor, alignment."""
