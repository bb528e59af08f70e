"""The environment, for one world and for many at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from microbot_ros.control.policy_task import LARGEST, PARTICLE_NUMBERS, SHARED_NUMBERS
from microbot_ros.gym.worlds import Ranges, SteeredWorlds
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings


class SteeringEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """All particles, driven by one field, are each to reach their own goal once.

    Observations and actions are defined in `control.policy_task`; a step is one frame. An action
    takes the path of any controller's command: limits, border, slew, allocation, gate. The field
    of the resulting currents moves the particles of the virtual rig. The loop's model counts as
    trained: v and φ are given with errors of `worlds.KNOWN_TO` drawn for each episode. An action
    that is NaN makes no current.

    The reward is 1 per goal reached and per 100 µm that a particle comes nearer to a pending goal
    (potential-based shaping changes no optimal policy: Ng, Harada and Russell, ICML 1999), minus 1
    spread over the duration. An episode terminates when all goals have been reached. It is
    truncated when its time is over, when a particle leaves the workspace, and when the gate cuts
    the currents. `info` has `is_success`, `reached` (number of goals), `t_s` and `reason`: why the
    field differs from the action.

    Parameters
    ----------
    scenario : str or Path, optional
        File as for `microbot simulate`, of catalytic particles and langevin physics, whose
        `controller` is replaced by the actions; None: 60 s at 30 frames/s. Its effects act in
        every episode. Its `goals_um`, one per particle, are the goals; without them goals are
        drawn.
    particles : int or None
        Number of particles drawn for each episode; None: those of the scenario.
    randomise : mapping, optional
        Effects with ranges of their parameters, drawn for each episode:
        `{'uniform_drift': {'wx_um_s': (-1, 1)}}`.
    render_mode : str, optional
        With 'rgb_array', `render` returns the microscope's picture.

    Raises
    ------
    InputError
        For an unusable scenario.
    ValueError
        For impossible ranges.
    """

    metadata = {'render_modes': ['rgb_array'], 'render_fps': 30}  # noqa: RUF012

    def __init__(
        self, scenario: str | Path | None = None, particles: int | None = 2,
        randomise: Ranges | None = None, render_mode: str | None = None,
    ) -> None:
        self.worlds = SteeredWorlds(1, scenario, particles, randomise)
        """The simulated world."""
        self.observation_space, self.action_space = _spaces(self.worlds)
        rate = self.worlds.scenario.camera.frame_rate_hz
        self.metadata = self.metadata | {'render_fps': rate}
        self.render_mode = render_mode
        self._microscope: Microscope | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; equal `seed` gives equal episodes.

        `options` may hold `goals_um`, (x, y) for each particle, and `effects` as in a scenario;
        ValueError if they are impossible.

        Parameters
        ----------
        seed : int or None
            Seed of the episode; None continues the sequence of random numbers.
        options : dict of str to object or None
            `goals_um` and `effects`; None for random ones.

        Returns
        -------
        tuple[ndarray, dict of str to object]
            Observation (2 + 7 N,), and information on the episode.
        """
        super().reset(seed=seed)
        self.worlds.begin(0, self.np_random, **_options(options, self.worlds))
        self._microscope = None
        return self.worlds.observation()[0], self._info()

    def step(
        self, action: np.ndarray,
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance one frame with an `action` (2,). ValueError for another shape.

        Parameters
        ----------
        action : ndarray, shape (2,)
            Field over the largest allowed.

        Returns
        -------
        tuple[ndarray, float, bool, bool, dict of str to object]
            Observation, reward, whether all goals are reached, whether the episode is cut,
            information.
        """
        if np.shape(action) != (2,):
            raise ValueError(f'expected an action (2,); received {np.shape(action)}')
        rewards, successes, cut = _step(
            self.worlds, np.zeros(1, int), np.reshape(action, (1, 2)), self.np_random)
        return (self.worlds.observation()[0], float(rewards[0]), bool(successes[0]), bool(cut[0]),
                self._info())

    def render(self) -> np.ndarray | None:
        """Return the microscope's picture (H, W, 3) uint8; None unless the mode is 'rgb_array'.

        Returns
        -------
        ndarray, shape (H, W, 3), or None
            Uint8, or None.
        """
        if self.render_mode != 'rgb_array':
            return None
        scenario, bodies = self.worlds.scenario, self.worlds.bodies[0]
        if self._microscope is None:
            view = MicroscopeSettings(radius_um=scenario.radius_um)
            self._microscope = Microscope(view, scenario.seed)
        place = np.stack((bodies['x'], bodies['y']), axis=-1)
        grey = self._microscope.render(place, bodies['heading'], float(self.worlds.t[0]))
        return np.repeat(grey[:, :, None], 3, axis=2)

    def _info(self) -> dict[str, Any]:
        return {name: values[0] for name, values in _info(self.worlds).items()}


class SteeringVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` = M environments like `SteeringEnv`, many times faster than one by one.

    `scenario`, `particles` and `randomise` as there. A finished episode restarts at the next step,
    which ignores its action.

    Parameters
    ----------
    num_envs : int
        Number M of environments.
    scenario : str or Path or None
        As in `SteeringEnv`.
    particles : int or None
        As in `SteeringEnv`.
    randomise : Ranges or None
        As in `SteeringEnv`.
    """

    metadata = {'render_modes': [], 'autoreset_mode': AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self, num_envs: int = 1, scenario: str | Path | None = None, particles: int | None = 2,
        randomise: Ranges | None = None,
    ) -> None:
        self.num_envs = num_envs
        self.worlds = SteeredWorlds(num_envs, scenario, particles, randomise)
        """The simulated worlds."""
        self.single_observation_space, self.single_action_space = _spaces(self.worlds)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in each world, with `seed` and `options` as in `SteeringEnv`.

        Parameters
        ----------
        seed : int or None
            Seed of the episodes; None continues the sequence of random numbers.
        options : dict of str to object or None
            `goals_um` and `effects`; None for random ones.

        Returns
        -------
        tuple[ndarray, dict of str to object]
            Observations (M, 2 + 7 N), and information on the episodes.
        """
        super().reset(seed=seed)
        given = _options(options, self.worlds)
        for m in range(self.num_envs):
            self.worlds.begin(m, self.np_random, **given)
        self._over[:] = False
        return self.worlds.observation(), self._info()

    def step(
        self, actions: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance one frame in each world with `actions` (M, 2). ValueError for another shape.

        Parameters
        ----------
        actions : ndarray, shape (M, 2)
            Field over the largest allowed.

        Returns
        -------
        tuple[ndarray, ndarray, ndarray, ndarray, dict of str to object]
            As `SteeringEnv.step`, an entry for each world.
        """
        if np.shape(actions) != (self.num_envs, 2):
            raise ValueError(f'expected actions {(self.num_envs, 2)}; received '
                             f'{np.shape(actions)}')
        which = np.flatnonzero(~self._over)
        for m in np.flatnonzero(self._over).tolist():
            self.worlds.begin(m, self.np_random, **_options(None, self.worlds))
        rewards, successes, cut = _step(
            self.worlds, which, np.asarray(actions)[which], self.np_random)
        self._over = successes | cut
        return self.worlds.observation(), rewards, successes, cut, self._info()

    def _info(self) -> dict[str, Any]:
        found = {name: np.array(values) for name, values in _info(self.worlds).items()}
        return found | {f'_{name}': np.ones(self.num_envs, bool) for name in found}


def _spaces(worlds: SteeredWorlds) -> tuple[Box, Box]:
    size = SHARED_NUMBERS + PARTICLE_NUMBERS * worlds.particles
    return (Box(-LARGEST, LARGEST, (size,), np.float32), Box(-1.0, 1.0, (2,), np.float32))


def _options(options: dict[str, Any] | None, worlds: SteeredWorlds) -> dict[str, Any]:
    given = {'goals_um': worlds.goals_um, 'effects': {}} | (options or {})
    if unknown := given.keys() - {'goals_um', 'effects'}:
        raise ValueError(f'unknown option {min(unknown)!r}; expected goals_um or effects')
    return given


def _step(
    worlds: SteeredWorlds, which: np.ndarray, actions: np.ndarray, rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rewards, worlds whose goals are all reached, and other ended worlds (M,)."""
    before = worlds.potential.copy()
    worlds.step(which, actions, rng)
    stepped = np.zeros(len(before), bool)
    stepped[which] = True
    rewards = np.where(stepped, worlds.potential - before - 1 / (worlds.frames - 1), 0.0)
    successes = stepped & ~worlds.waiting.any(axis=1)
    return rewards, successes, stepped & ~successes & worlds.cut()


def _info(worlds: SteeredWorlds) -> dict[str, list[Any]]:
    reached = (~worlds.waiting).sum(axis=1).tolist()
    return {'is_success': [count == worlds.particles for count in reached], 'reached': reached,
            't_s': worlds.t.tolist(), 'reason': list(worlds.reasons)}
