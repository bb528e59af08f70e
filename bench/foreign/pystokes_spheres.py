"""Simulate propelled spheres over a wall with pystokes; runs in the environment of `make foreign`.

`python pystokes_spheres.py SEED PULLED FILE.npz`: six spheres at three radii above a no-slip wall,
each propelled along its own angle to the command, for 60 s. With PULLED 1 a constant force, such
as the weight on a tilted stage, acts on all of them. Velocities are those that the mobility of
`pystokes.wallBounded` gives: the spheres move the fluid and, through it, each other. Writes `t`,
`position` (T, N, 2), `command_t`, `direction`, SI.
"""

from __future__ import annotations

import math
import sys

import numpy as np
import pystokes

SECONDS, RATE, SPHERES = 60.0, 30, 6
RADIUS, VISCOSITY = 2.5e-6, 1e-3
LOCALISATION = 0.1e-6
SPEED, PULLED_SPEED = (3.5e-6, 6e-6), 0.3e-6


def main() -> None:
    """Simulate one session."""
    seed, pulled, file = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    rng = np.random.default_rng(seed)
    begin = np.concatenate(([0.0], np.cumsum(rng.uniform(1.0, 4.0, 80))))
    begin = begin[begin < SECONDS]
    direction = rng.uniform(-math.pi, math.pi, len(begin))
    # Lengths in radii and times in seconds: a friction of 6π η a = 1 makes forces velocities.
    fluid = pystokes.wallBounded.Rbm(radius=1.0, particles=SPHERES, viscosity=1 / (6 * math.pi))
    own = rng.uniform(*SPEED, SPHERES) / RADIUS * np.exp(
        1j * rng.uniform(-math.pi, math.pi, SPHERES))
    pull = pulled * PULLED_SPEED / RADIUS * np.exp(1j * rng.uniform(-math.pi, math.pi))
    place = 50e-6 / RADIUS * (np.arange(SPHERES) % 3 + 1j * (np.arange(SPHERES) // 3))
    thermal = 1.38e-23 * 298 / (6 * math.pi * VISCOSITY * RADIUS) / RADIUS**2
    t, height = np.arange(1, int(SECONDS * RATE)) / RATE, np.full(SPHERES, 3.0)
    parallel = 1 - 9 / 16 / height[0] + 1 / 8 / height[0] ** 3
    seen, substeps = [], 2
    for frame in t:
        for _ in range(substeps):
            row = np.searchsorted(begin, frame - 0.5 / RATE, side='right') - 1
            force = own * np.exp(1j * direction[row]) + pull
            velocity = np.zeros(3 * SPHERES)
            fluid.mobilityTT(
                velocity, np.concatenate([place.real, place.imag, height]),
                np.concatenate([force.real, force.imag, np.zeros(SPHERES)]))
            noise = rng.standard_normal((2, SPHERES))
            step = 1 / RATE / substeps
            place = place + step * (velocity[:SPHERES] + 1j * velocity[SPHERES:2 * SPHERES])
            place = place + math.sqrt(2 * thermal * parallel * step) * (noise[0] + 1j * noise[1])
        seen.append(place)
    position = RADIUS * np.stack([np.real(seen), np.imag(seen)], axis=-1)
    position += LOCALISATION * rng.standard_normal(position.shape)
    np.savez(file, t=t, position=position, command_t=begin, direction=direction)


if __name__ == '__main__':
    main()
