"""A simulated world that discovery drives: fine Langevin physics, a view with edges, a camera."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.control.contract import Workspace
from microbot_ros.discovery.driven.design import Range
from microbot_ros.discovery.driven.drive import Played
from microbot_ros.discovery.driven.plan import Plan, marking_time
from microbot_ros.virtual_rig.record_session import Camera, as_tracks, detection_errors, picture
from microbot_ros.virtual_rig.world import FieldHistory, World

VIEW = Workspace(np.array([-140e-6, -104e-6]), np.array([140e-6, 104e-6]))
PAUSE = 2.0
"""Seconds between experiments in which it is thought."""

_KEPT = 3.0
"""Seconds for which the world may look back for a field."""


class SimulatedRig:
    """A `world` filmed by a `camera`, under `conditions`: what leaves the `view` is not seen.

    `field` [T] and `frequency` [Hz] are the most that may be asked for.
    """

    def __init__(self, world: World, camera: Camera, conditions: Conditions, field: float,
                 rng: np.random.Generator, frequency: tuple[float, float] | None = None,
                 view: Workspace = VIEW) -> None:
        self.limits = Range(field, view, frequency)
        self.world, self._camera, self._rng = world, camera, rng
        self.conditions = conditions
        self._past = Commands(np.zeros(1), np.zeros((1, 2)),
                              None if frequency is None else np.zeros(1))

    @property
    def seconds(self) -> float:
        """Since the world began."""
        return self.world.t

    def play(self, plan: Plan) -> Played:
        """Play a `plan` after a pause for thought, in which the particles mark time."""
        begin = self.world.t
        whole = plan
        if begin > 0:
            most = None if self.limits.frequency is None else self.limits.frequency[1]
            y, x = self._past.field[-1, ::-1]
            whole = marking_time(math.atan2(y, x), self.limits.field, most).lasting(
                PAUSE).then(plan)
        told = whole.commands(begin)
        self._past = _after(self._past, told, begin - _KEPT)
        tracks = self._film(begin, whole.duration, FieldHistory.uniform(self._past))
        self.world.advance(begin + whole.duration, FieldHistory.uniform(self._past))
        return Played(Session(tracks, told, self.conditions, 'experiment'))

    def _film(self, begin: float, duration: float, history: FieldHistory) -> Tracks:
        camera, world = self._camera, self.world
        shutter = camera.exposure / camera.frame_rate
        opens = begin + np.arange(math.floor((duration - shutter) * camera.frame_rate)) / (
            camera.frame_rate)
        errors = detection_errors(camera, len(opens), len(world.bodies), self._rng)
        seen = np.empty_like(errors)
        for k, t in enumerate(opens.tolist()):
            world.advance(t, history)
            first = world.advance(t + shutter / 2, history)
            second = world.advance(t + shutter, history) if shutter else first
            seen[k] = world.observe(picture(world.bodies, (first + second) / 2, t))
        seen[~self.limits.workspace.holds(seen)] = np.nan
        return as_tracks(opens + shutter / 2, seen + errors)


def _after(past: Commands, told: Commands, since: float) -> Commands:
    """What may still be felt of the `past`, then what is `told`."""
    keep = slice(max(int(past.index_at(since)), 0), None)
    return Commands(
        np.concatenate([past.t[keep], told.t]), np.concatenate([past.field[keep], told.field]),
        None if told.frequency is None or past.frequency is None
        else np.concatenate([past.frequency[keep], told.frequency]))
