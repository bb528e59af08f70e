"""Physics of spheres in a fluid: drag, diffusion, inertia, floor and alignment."""
