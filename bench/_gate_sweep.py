"""Ten million random, hostile and boundary values through the gate."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.drive.gate import Gate, Limits

ZERO = (0.0,) * 4

LIMIT_A = 2.0
_BATCH = 100_000
# Everything but the absolute limit is out of the way: it alone must hold. The gate remembers its
# outputs for as long as it waits for a reading: a hundred commands, which never pass in a row.
_LIMITS = Limits(current_A=LIMIT_A, step_A=1e300, slew_A_per_s=1e300, command_timeout_s=1e9,
                 deviation_A=1e9, settling_s=1e-9, feedback_timeout_s=0.1,
                 rated_current_A=1e9, thermal_s=1e9, idle_s=1e9)
_HOSTILE = np.array([
    math.nan, -math.nan, math.inf, -math.inf, 1.8e308, -1.7e308, 5e-324, -5e-324, -0.0,
    *(sign * edge for sign in (1, -1) for edge in (
        LIMIT_A, math.nextafter(LIMIT_A, 3), math.nextafter(LIMIT_A, 1), 1.001 * LIMIT_A,
        0.999 * LIMIT_A))])


def values_outside(count: int) -> tuple[int, int]:
    """How many of the values that came out are not within the limit or not what went in, and how
    many went through; `count` values go in, as commands of four.
    """
    random = np.random.default_rng(11)
    gate, now, wrong, passed = Gate(_LIMITS), 0.0, 0, 0
    for _ in range(count // (4 * _BATCH)):
        wanted = _commands(random)
        given = np.empty_like(wanted)
        for row, command in enumerate(wanted.tolist()):
            now += 1e-3
            if not gate.armed:
                gate.measured(ZERO, now)
                gate.arm(now)
            given[row] = gate.command(command, now)
        affirmed = (given == wanted).all(axis=1)
        inside = (np.abs(given) <= LIMIT_A).all(axis=1)
        wrong += int(np.count_nonzero(~inside | ~(affirmed | (given == 0.0).all(axis=1))))
        passed += 4 * int(np.count_nonzero(affirmed))
    return wrong, passed


def _commands(random: np.random.Generator) -> np.ndarray:
    """Half of the commands are within the limits altogether, the others anything at all."""
    near = LIMIT_A * random.uniform(-1.0, 1.0, (_BATCH, 4))
    wild = np.where(random.random((_BATCH, 4)) < 0.3, random.choice(_HOSTILE, (_BATCH, 4)),
                    random.normal(0, 1, (_BATCH, 4)) * 10.0 ** random.integers(-3, 4, (_BATCH, 1)))
    return np.where(random.random((_BATCH, 1)) < 0.5, near, wild)
