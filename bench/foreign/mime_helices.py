"""Simulate helical microrobots with mime-engine; runs in the environment of `make foreign`.

`python mime_helices.py SEED STEPS_OUT FILE.npz`: four robots under a rotating field whose
direction and frequency change in steps, for 60 s. With STEPS_OUT 1 the highest frequencies lie
beyond step-out, with 0 none does. Writes `t`, `position` (T, N, 2), `command_t`, `direction`,
`frequency`, SI. Angular velocity and speed come from the equations of motion of mime-engine
(`umr_ode_rhs`: moment against field, drag, inertia); the place is the integral of the speed along
the direction of the command, with the diffusion and the camera of this file.
"""

from __future__ import annotations

import math
import sys

import jax
import jax.numpy as jnp
import numpy as np
from mime.nodes.robot.umr_ode import pack_params, umr_ode_rhs

SECONDS, RATE, ROBOTS = 60.0, 30, 4
RADIUS, VISCOSITY, FIELD = 4e-6, 1e-3, 5e-3
DIFFUSION = 1.38e-23 * 298 / (6 * math.pi * VISCOSITY * RADIUS)
LOCALISATION = 0.1e-6
PITCH = 0.6e-6
"""Displacement [m] per turn."""
FREQUENCIES = (2.0, 4.0, 8.0, 12.0, 16.0, 20.0)
INERTIA_S = 2e-3
"""Relaxation time of rotation and translation [s]: longer than a real one, for explicit steps."""
STEP_S = 2e-4


def main() -> None:
    """Simulate one session."""
    seed, steps_out, file = int(sys.argv[1]), bool(int(sys.argv[2])), sys.argv[3]
    rng = np.random.default_rng(seed)
    begin = np.concatenate(([0.0], np.cumsum(rng.uniform(1.5, 4.0, 60))))
    begin = begin[begin < SECONDS]
    direction = rng.uniform(-math.pi, math.pi, len(begin))
    frequency = rng.choice(FREQUENCIES, len(begin))
    step_out = rng.uniform(9.0, 15.0) if steps_out else 80.0
    steps = int(SECONDS / STEP_S)
    row = np.searchsorted(begin, (np.arange(steps) + 0.5) * STEP_S, side='right') - 1
    speed = [_speeds(frequency[row], step_out, PITCH * rng.uniform(0.8, 1.2))
             for _ in range(ROBOTS)]
    aim = direction[row][:, None] + rng.uniform(-math.pi, math.pi, ROBOTS)
    moved = STEP_S * np.stack(speed, axis=1) * np.exp(1j * aim)
    moved = moved + math.sqrt(2 * DIFFUSION * STEP_S) * (
        rng.standard_normal(moved.shape) + 1j * rng.standard_normal(moved.shape))
    start = 100e-6 * (np.arange(ROBOTS) - (ROBOTS - 1) / 2)
    place = start + np.cumsum(moved, axis=0)
    t = np.arange(1, int(SECONDS * RATE)) / RATE
    seen = place[np.round(t / STEP_S).astype(int) - 1]
    position = np.stack([seen.real, seen.imag], axis=-1)
    position += LOCALISATION * rng.standard_normal(position.shape)
    np.savez(file, t=t, position=position, command_t=begin, direction=direction,
             frequency=frequency)


def _speeds(frequency: np.ndarray, step_out: float, pitch: float) -> np.ndarray:
    """Return the speed [m/s] in every step of a robot that steps out at `step_out` [Hz]."""
    drag = 8 * math.pi * VISCOSITY * RADIUS**3
    drag_of_translation = 6 * math.pi * VISCOSITY * RADIUS
    torque = drag * 2 * math.pi * step_out
    known = {'n_mag': 1, 'm_single': torque / FIELD, 'B': FIELD, 'I_eff': drag * INERTIA_S,
             'm_eff': drag_of_translation * INERTIA_S, 'C_rot': drag,
             'C_prop': pitch / (2 * math.pi) * drag_of_translation,
             'C_trans': drag_of_translation}

    def step(state: jax.Array, omega: jax.Array) -> tuple[jax.Array, jax.Array]:
        state = state + STEP_S * umr_ode_rhs(state, pack_params(omega, **known))
        return state, state[2]

    speeds = jax.lax.scan(step, jnp.zeros(3), jnp.asarray(2 * math.pi * frequency))[1]
    return np.asarray(speeds, float)


if __name__ == '__main__':
    jax.config.update('jax_enable_x64', True)
    main()
