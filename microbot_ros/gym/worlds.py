"""Several simulated worlds at once, each with a goal per particle and its own loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.control.contract import (
    ControllerInput,
    FieldCommand,
    Goals,
    Limits,
    Workspace,
)
from microbot_ros.control.manager import LONGEST_STEP
from microbot_ros.control.policy_task import ARRIVAL, distances, observation, wanted_field
from microbot_ros.control.steering.border import kept_in_view
from microbot_ros.drive.gate import Gate
from microbot_ros.loop.allocation import AllocationStage, GateParameters, limits
from microbot_ros.loop.controller import ControllerParameters
from microbot_ros.magnetics import Allocator
from microbot_ros.model.model import ParticleParameters
from microbot_ros.virtual_rig.body import BODY
from microbot_ros.virtual_rig.coil_gradients import coil_gradients
from microbot_ros.virtual_rig.dynamics import advance_worlds
from microbot_ros.virtual_rig.injected_effects import INJECTABLE, check, inject_effect
from microbot_ros.virtual_rig.record_session import detection_errors, picture, scatter
from microbot_ros.virtual_rig.scenario import EffectSettings, Scenario, read_scenario
from microbot_ros.virtual_rig.simulation import make_bodies, starting_places

SPEEDS = (3.5e-6, 6e-6)
"""Choice: range of the speeds of drawn particles [m/s]; the paper's are 3.7 to 5.0 µm/s."""
KNOWN_TO = 0.02
"""Choice: standard deviation of the given φ [rad], and relative one of the given speed."""
WORTH_ONE = 100e-6
"""Choice: progress [m] towards a goal that is worth a reward of 1."""
STEP = 5e-3
"""Choice: longest step [s] of the physics.

Headings are integrated exactly, so that steps longer than
those of `virtual_rig.world` cost little accuracy: 0.01 µm where the field is turned.
"""
_APART = 15e-6
"""Choice: least distance of drawn goals [m]."""

Ranges = Mapping[str, Mapping[str, tuple[float, float]]]
"""Effect → parameter → its lowest and highest value."""
Rows = np.ndarray | slice

_DEFAULT = Scenario.from_content({
    'duration_s': 60, 'radius_um': 2.3, 'reference_field_mT': 5.0, 'spread_um': 40,
    'fluid': {'viscosity_mPa_s': 1.245}, 'controller': {'name': 'policy'},
    'camera': {'frame_rate_hz': 30, 'localisation_um': 0.1},
    'particles': [{'x_um': -60, 'y_um': 20, 'v_um_s': 3.71, 'phi_rad': -1.09},
                  {'x_um': 40, 'y_um': 50, 'v_um_s': 4.38, 'phi_rad': 3.82}]})
"""Choice: two of the paper's particles for a minute, seen as on the virtual rig."""


class SteeredWorlds:
    """`count` = M worlds of N particles, begun and steered independently.

    `scenario`, `particles` and `randomise` as in `steering.SteeringEnv`. A command takes the path
    of any controller's: limits, border and slew as in the controller manager, then allocation and
    gate; the amplifier is ideal. Raises InputError for an unusable scenario.

    Parameters
    ----------
    count : int
        Number M of worlds.
    scenario : str or Path or None
        Scenario, or its file; None for the default.
    particles : int or None
        Number N of particles; None for those of the scenario.
    randomise : Ranges or None
        Ranges of effects; None for none.
    """

    def __init__(self, count: int, scenario: str | Path | None, particles: int | None,
                 randomise: Ranges | None) -> None:
        self._source = str(scenario or 'scenario')
        self.scenario, listed = (_DEFAULT, _DEFAULT.listed) if scenario is None else read_scenario(
            Path(scenario))
        self.particles = len(listed.ids) if particles is None else particles
        """Number of particles in each world."""
        self._listed = listed if particles is None else None
        if foreign := [name for name in self.scenario.effects if name not in INJECTABLE]:
            raise InputError(self._source, "'effects': expected effects of the physics, not "
                                           f'{foreign[0]} of another package')
        if self.scenario.learned or self.scenario.walls_um:
            raise InputError(self._source, 'expected neither learned terms of a model nor '
                                           "'walls_um': worlds that learn have none")
        self._randomise = _checked(randomise or {})
        self._prepare_loop()
        self._camera = self.scenario.camera.camera()
        self.frames = math.floor(self.scenario.duration_s * self._camera.frame_rate) + 1
        """Number of frames of an episode."""
        shape = (count, self.particles)
        self.bodies = np.empty(shape, BODY)
        """All particles (M, N) of type BODY."""
        self.t, self.frame = np.zeros(count), np.zeros(count, int)
        """Time [s] and number of frames so far (M,) in each episode."""
        self.seen, self.goals = np.zeros((*shape, 2)), np.zeros((*shape, 2))
        """Last observed positions and goals (M, N, 2) [m]."""
        self.waiting = np.ones(shape, bool)
        """Whether each particle (M, N) still has to reach its goal."""
        self.commanded = np.zeros((count, 2))
        """Field (M, 2) [T] of the last command."""
        self.reasons = [''] * count
        """Why the field differs from the action, in each world."""
        self.gates = [Gate(self._gate_limits) for _ in range(count)]
        self.potential = np.zeros(count)
        """Potential of each world (M,): goals reached minus distances to the others."""
        self._speed_error, self._phi_error = np.ones(shape), np.zeros(shape)  # of what is told
        self._errors = np.zeros((count, self.frames, self.particles, 2))
        self._field = np.zeros((count, self.frames, 1, 2))
        self._distorts = False  # whether the camera shows particles elsewhere than they are
        self._begins = (np.arange(self.frames) + self._camera.exposure) / self._camera.frame_rate

    def _prepare_loop(self) -> None:
        wanted, rate = self.scenario.controller, self.scenario.camera.frame_rate_hz
        if wanted is None:
            raise InputError(self._source, "expected a 'controller', which the policy replaces")
        if len(wanted.goals_um) not in (0, self.particles):
            raise InputError(self._source, f"'controller.goals_um': expected {self.particles}, "
                             f'one for each particle; found {len(wanted.goals_um)}')
        self.goals_um = wanted.goals_um
        """Goals of the scenario (N), or none."""
        self._values = values = ControllerParameters(max_field_mT=wanted.max_field_mT)
        gate = GateParameters(full_field_mT=wanted.max_field_mT)
        self._coils, self._gate_limits = AllocationStage(gate).coils, limits(gate)
        self._allocator = Allocator(self._coils)
        slowest = 1 / self._gate_limits.command_timeout_s
        if not rate > slowest:
            raise InputError(self._source, "'camera.frame_rate_hz': expected more than "
                                           f'{slowest:.3g}, as commands expire after one '
                                           'period of that rate')
        self.limits = Limits(
            wanted.max_field_mT * 1e-3, values.slew_mT_per_s * 1e-3, values.max_frequency_hz)
        low, high = np.reshape(values.workspace_um, (2, 2)) * 1e-6
        self.workspace = Workspace(low, high)

    def begin(self, m: int, rng: np.random.Generator, goals_um: Any,
              effects: EffectSettings) -> None:
        """Begin an episode in world `m`, drawn from `rng`; `goals_um` (N, 2) are drawn if empty.

        `effects`, as in a scenario, replace those that would be drawn. Raises ValueError for
        impossible goals or effects.

        Parameters
        ----------
        m : int
            Index of the world.
        rng : random.Generator
            Source of random numbers.
        goals_um : object
            Goals (N, 2) [µm]; None or empty for random ones.
        effects : EffectSettings
            Effects of the episode; empty for random ones.
        """
        self.bodies[m] = self._draw_bodies(rng, effects)
        self.goals[m] = self._draw_goals(rng, goals_um)
        self._speed_error[m] = 1 + KNOWN_TO * rng.standard_normal(self.particles)
        self._phi_error[m] = KNOWN_TO * rng.standard_normal(self.particles)
        self._errors[m] = detection_errors(self._camera, self.frames, self.particles, rng)
        self.frame[m] = 0
        self.waiting[m], self.commanded[m], self.reasons[m] = True, 0.0, ''
        self.seen[m] = np.stack((self.bodies[m]['x'], self.bodies[m]['y']), axis=-1)
        self.gates[m] = gate = Gate(self._gate_limits)
        gate.measured((0.0,) * 4, 0.0)
        gate.arm(0.0)
        self._distorts |= bool((self.bodies[m]['aspect'] != 1).any()
                               or np.isfinite(self.bodies[m]['jump_time']).any())
        self._take_frames(np.array([m]), np.array([m]), rng)

    def _draw_bodies(self, rng: np.random.Generator, effects: EffectSettings) -> np.ndarray:
        scenario, count = self.scenario, self.particles
        particles = self._listed or ParticleParameters(
            np.arange(count), rng.uniform(*SPEEDS, count), rng.uniform(-math.pi, math.pi, count))
        start = starting_places(scenario, count, rng, self._source, self._listed is None)
        made = make_bodies(scenario, particles, start, rng.uniform(-math.pi, math.pi, count))
        drawn = {effect: {name: rng.uniform(*ends) for name, ends in ranges.items()}
                 for effect, ranges in self._randomise.items()}
        for effect, parameters in (drawn | effects).items():
            inject_effect(made, effect, parameters, scenario.reference_field)
        return made

    def _draw_goals(self, rng: np.random.Generator, goals_um: Any) -> np.ndarray:
        if not len(goals_um):
            return scatter(rng, self.particles, self.scenario.spread_um * 1e-6, _APART)
        goals = np.array(goals_um, dtype=float) * 1e-6
        if goals.shape != (self.particles, 2) or not self.workspace.holds(goals).all():
            raise ValueError(f'expected {self.particles} goals_um within the workspace; received '
                             f'{np.array(goals_um).tolist()}')
        return goals

    def step(self, which: np.ndarray, actions: np.ndarray, rng: np.random.Generator) -> None:
        """Advance one frame in the worlds `which` (K,) with `actions` (K, 2).

        `rng` is the source of all randomness. An action that is NaN makes no field.

        Parameters
        ----------
        which : ndarray, shape (K,)
            Indices of the worlds.
        actions : ndarray, shape (K, 2)
            Field over the largest allowed.
        rng : random.Generator
            Source of random numbers.
        """
        # A view of all worlds is much faster than a copy of some.
        rows = slice(None) if len(which) == len(self.t) else which
        self._command(which, rows, actions)
        wanted = self._allocator.currents(self.commanded[rows])
        affirmed = np.empty_like(wanted)
        for k, (m, t, currents) in enumerate(zip(
                which.tolist(), self.t[rows].tolist(), wanted.tolist(), strict=True)):
            gate = self.gates[m]
            affirmed[k] = gate.measured(gate.command(currents, t), t)
            if gate.fault:
                self.reasons[m] = f'{gate.fault.reason.value}: {gate.fault.detail}'
        self._field[which, self.frame[rows], 0] = (
            self._coils.effective(affirmed) @ self._allocator.matrix.T + self._coils.background)
        self.frame[rows] += 1
        if self._camera.exposure < 1:
            self._advance(which, (1 - self._camera.exposure) / self._camera.frame_rate, rng)
        self._take_frames(which, rows, rng)

    def observation(self) -> np.ndarray:
        """Return the observation of each world (M, 2 + 7 N).

        Returns
        -------
        ndarray, shape (M, 2 + 7 N)
            Observations.
        """
        speed, phi = self._told(slice(None))
        return observation(self.seen, speed * np.exp(1j * phi), self.goals, self.waiting,
                           self.commanded / self.limits.field, self.workspace)

    def cut(self) -> np.ndarray:
        """Return where (M,) time is over, a particle left the workspace or the gate cut off.

        Returns
        -------
        ndarray, shape (M,)
            Whether the episode is cut.
        """
        lost = ~self.workspace.holds(self.seen).all(axis=1)
        fault = np.array([gate.fault is not None for gate in self.gates])
        return np.asarray(lost | fault | (self.frame + 1 >= self.frames))

    def _command(self, which: np.ndarray, rows: Rows, actions: np.ndarray) -> None:
        """Apply limits, border and slew to the actions, as the controller manager does."""
        wanted = wanted_field(actions, self.limits.field)
        for m in which.tolist():
            self.reasons[m] = ''
        seen, reach = self.seen[rows], self._values.border_s * self._told(rows)[0][..., None]
        near = (seen > self.workspace.high - reach) | (seen < self.workspace.low + reach)
        for row in np.flatnonzero(np.isnan(wanted).any(axis=1) | near.any(axis=(1, 2))).tolist():
            self._correct(int(which[row]), wanted[row], actions[row])
        step = wanted - self.commanded[rows]
        length = np.hypot(step[:, 0], step[:, 1])
        longest = self.limits.slew * min(1 / self._camera.frame_rate, LONGEST_STEP)
        if (length > longest).any():
            step *= np.minimum(longest / np.maximum(length, longest), 1.0)[:, None]
        self.commanded[rows] += step

    def _correct(self, m: int, wanted: np.ndarray, action: np.ndarray) -> None:
        """Correct `wanted` where it is NaN or a particle may leave the workspace."""
        if np.isnan(wanted).any():
            wanted[:], self.reasons[m] = 0.0, (
                f'the policy returned {action.tolist()}, not a finite field')
            return
        command = kept_in_view(self.inputs(m), FieldCommand(wanted.copy()), self._values.border_s)
        wanted[:], self.reasons[m] = command.field, command.progress.message

    def inputs(self, m: int) -> ControllerInput:
        """Return a controller's input of world `m`, with the goals of the episode.

        Parameters
        ----------
        m : int
            Index of the world.

        Returns
        -------
        ControllerInput
            The input.
        """
        speed, phi = (told[0] for told in self._told(slice(m, m + 1)))
        known = np.full(self.particles, KNOWN_TO)
        return ControllerInput(
            t=float(self.t[m]), dt=1 / self._camera.frame_rate, age=0.0,
            ids=np.arange(self.particles), position=self.seen[m].copy(),
            sigma=np.full(self.particles, self._camera.noise),
            theta=np.full(self.particles, np.nan), speed=speed, phi=phi, speed_std=known * speed,
            phi_std=known, limits=self.limits, workspace=self.workspace,
            goals=Goals(self.goals[m].copy()), field=self.commanded[m].copy(),
            expected=self.seen[m].copy())

    def _told(self, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
        """Return v [m/s] and φ [rad] (K, N) as the loop's model would have learned them."""
        body = self.bodies
        speed = body['speed'][rows] * body['fuel'][rows] * self._speed_error[rows]
        return speed, body['phi'][rows] + self._phi_error[rows]

    def _advance(self, which: np.ndarray, duration: float, rng: np.random.Generator) -> np.ndarray:
        """Let time pass; return the mean positions (M, N, 2) [m] meanwhile."""
        mean = np.zeros_like(self.seen)
        advance_worlds(
            self.bodies, which, self.t, duration, math.ceil(duration / STEP - 1e-9),
            self._begins, self._field, self.frame, coil_gradients(), rng, mean)
        return mean

    def _take_frames(self, which: np.ndarray, rows: Rows, rng: np.random.Generator) -> None:
        rate, exposure, bodies = self._camera.frame_rate, self._camera.exposure, self.bodies
        self.t[rows] = self.frame[rows] / rate
        place = self._advance(which, exposure / rate, rng)[rows] if exposure else np.stack(
            (bodies['x'][rows], bodies['y'][rows]), axis=-1)
        self.t[rows] += exposure / rate
        if self._distorts:
            place = picture(bodies[rows], place, self.t[rows, None] - exposure / rate / 2)
        seen = place + self._errors[which, self.frame[rows]]
        self.seen[rows] = np.where(np.isnan(seen), self.seen[rows], seen)
        left = distances(self.seen[rows], self.goals[rows])
        self.waiting[rows] &= left > ARRIVAL
        self.potential[rows] = np.where(self.waiting[rows], -left / WORTH_ONE, 1.0).sum(axis=1)


def _checked(randomise: Ranges) -> Ranges:
    """Return `randomise`; ValueError for an effect, parameter or range that is impossible."""
    for effect, ranges in randomise.items():
        for end in (0, 1):
            check(effect, {name: ends[end] for name, ends in ranges.items()})
    return randomise
