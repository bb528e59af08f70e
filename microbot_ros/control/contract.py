"""What a controller is: the whole contract between a controller and whatever runs it.

A controller is a class with a no-argument constructor, found by its entry point in the group
`microbot_ros.controllers`. Its life: `configure` (any time, also while it runs), then `activate`,
`compute` once per tick and `deactivate`, again and again; `reset` forgets what was learned.
All quantities are SI.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.control.field_record import FieldRecord
from microbot_ros.model.model import Model

INTERFACE_VERSION = 1
"""Raised when a controller written for the contract before would no longer work."""


class Result(enum.Enum):
    """How a tick or a switch ended, for messages and diagnostics."""

    OK = 'ok'
    BAD_GOAL = 'bad goal'
    PARTICLE_LOST = 'particle lost'
    NOT_KNOWN_YET = 'not known yet'
    MODEL_LACKS = 'model lacks something'
    NO_SOLUTION = 'no solution'
    STALE = 'stale poses'
    FAULT = 'fault'


class Input(enum.Enum):
    """What a person or a program may give a controller beside the particles; the value is its
    name for people. `GOALS` are a list without particles, `PARTICLE_GOALS` name whose each is."""

    GOALS = 'goals'
    PARTICLE_GOALS = 'goals of particles'
    PATH = 'path'
    PLAN = 'plan'
    JOYSTICK = 'joystick'


ANY_GOALS = frozenset({Input.GOALS, Input.PARTICLE_GOALS})


class ControllerError(Exception):
    """The controller can't act now, and says why: zero field, and it is asked again next tick.

    Anything else that leaves a controller is a fault, after which it is not asked again.
    """

    result: ClassVar[Result] = Result.NO_SOLUTION


class GoalError(ControllerError):
    """A goal or path that can't be followed: not finite, outside the workspace, too many."""

    result = Result.BAD_GOAL


class ParticleLostError(ControllerError):
    """The particle to be driven is not among those seen."""

    result = Result.PARTICLE_LOST


class NotLearnedError(ControllerError):
    """Speed or angle of a particle are still to be learned."""

    result = Result.NOT_KNOWN_YET


class ModelError(ControllerError):
    """The model has not what this controller works with."""

    result = Result.MODEL_LACKS


class NoSolutionError(ControllerError):
    """No command does what was asked."""

    result = Result.NO_SOLUTION


@dataclass(frozen=True)
class Limits:
    """What a command must keep: `field` [T], its `slew` [T/s], `frequency` [Hz].

    ValueError for one that is not finite or below 0: it would limit nothing.
    """

    field: float = 5e-3
    slew: float = 1.0
    frequency: float = 100.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value < math.inf:
                raise ValueError(f'{name} must be finite and 0 or more; received {value}')


@dataclass(frozen=True)
class Workspace:
    """The rectangle in which particles are seen: corners `low` and `high` (2,) [m]."""

    low: np.ndarray
    high: np.ndarray

    def holds(self, position: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Whether each `position` (..., 2) [m] lies inside, `margin` [m] off the edge; NaN does
        not.
        """
        inside = (self.low + margin <= position) & (position <= self.high - margin)
        return np.asarray(inside.all(-1))


NO_IDS = np.empty(0, int)
NO_PLACES = np.empty((0, 2))


@dataclass(frozen=True)
class Goals:
    """Where to go: `position` (G, 2) [m]; `ids` (G,) names whose goal each is.

    Without ids a list: waypoints in order for one particle, or goals of the particles in
    ascending order of their ids.
    """

    position: np.ndarray = dataclasses.field(default_factory=NO_PLACES.copy)
    ids: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.position)

PER_PARTICLE = (
    'ids', 'position', 'sigma', 'theta', 'speed', 'phi', 'speed_std', 'phi_std')


@dataclass(frozen=True)
class ControllerInput:
    """All that a controller may look at, at one tick.

    `t` [s] is now, `dt` since the tick before, `age` since the exposure of the poses. Particles:
    `ids` (N,), measured `position` (N, 2), its standard deviation `sigma` (N,), heading `theta`
    (N,) (NaN where unknown). Estimates: `speed` (N,) [m/s, or m/s/Hz of rollers] and `phi` (N,)
    with `speed_std` and `phi_std` (inf: nothing is known). `expected` (N, 2) is where the
    particles will be when a command given now takes effect, `delay` [s] later, as far as that is
    known.
    `field` (2,) and `frequency` are the command before, `record` those of the last seconds.
    `joystick` (2,), within the unit circle, is a person's hand. `path` (P, 2). `plan`: a row of
    fields that somebody wants played, on a clock that begins with it; its last row is its end.
    """

    t: float
    dt: float
    age: float
    ids: np.ndarray
    position: np.ndarray
    sigma: np.ndarray
    theta: np.ndarray
    speed: np.ndarray
    phi: np.ndarray
    speed_std: np.ndarray
    phi_std: np.ndarray
    limits: Limits
    workspace: Workspace
    delay: float = 0.0
    goals: Goals = dataclasses.field(default_factory=Goals)
    path: np.ndarray = dataclasses.field(default_factory=NO_PLACES.copy)
    field: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(2))
    frequency: float = 0.0
    joystick: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(2))
    model: Model | None = None
    expected: np.ndarray = dataclasses.field(default_factory=NO_PLACES.copy)
    record: FieldRecord = dataclasses.field(default_factory=FieldRecord)
    plan: Commands | None = None

    def index(self, particle: int) -> int:
        """The row of a particle; ParticleLostError where it is not seen."""
        rows = np.flatnonzero(self.ids == particle)
        if not rows.size:
            raise ParticleLostError(f'particle {particle} is not seen')
        return int(rows[0])

    def learned(self, phi_std: float) -> np.ndarray:
        """Of which particles (N,) φ is known to within a standard deviation `phi_std` [rad]."""
        return np.isfinite(self.phi) & (self.phi_std <= phi_std)


@dataclass(frozen=True)
class Progress:
    """How far a controller has come, for people and for whoever waits for it.

    `distance` [m] is what is left to its goal, NaN where that means nothing; `done` says that
    what was asked has been reached; `message` says in words what it does; `goal` is the number of
    the goal it goes to, from 0, None where goals are not taken one after the other.
    """

    message: str = ''
    done: bool = False
    distance: float = float('nan')
    goal: int | None = None


@dataclass(frozen=True)
class FieldCommand:
    """One tick's answer: the wanted `field` (2,) or (3,) [T] and, for rollers, its `frequency`
    [Hz].

    `particles` (K,) are the ids of those it is meant for, which are kept in view; None: all.
    A field that turns rolls along its part in the plane, or goes round the `axis` (3,), a unit
    vector, right-handed. What has an axis, or a part along z, is kept in view by nobody.
    """

    field: np.ndarray
    frequency: float = 0.0
    progress: Progress = dataclasses.field(default_factory=Progress)
    particles: np.ndarray | None = None
    axis: np.ndarray | None = None

    @property
    def angular_velocity(self) -> np.ndarray:
        """ω (3,) [rad/s] of the field: rollers go along ω̂ × ẑ; zero for one that stands."""
        axis = self.axis
        if axis is None:
            x, y = self.field[:2] / (math.hypot(*self.field[:2]) or 1.0)
            axis = np.array([-y, x, 0.0])
        return math.tau * self.frequency * axis

    @property
    def drive(self) -> np.ndarray:
        """The part (2,) [T] along which particles swim, or roll."""
        if self.axis is None:
            return self.field[:2]
        x, y = float(np.linalg.norm(self.field)) * self.axis[:2]
        return np.array([y, -x])

    @property
    def in_plane(self) -> bool:
        """Whether it is of the kind that drives what swims or rolls along the plane."""
        return self.axis is None and len(self.field) == 2


def no_field(message: str, done: bool = False) -> FieldCommand:
    """The command that lets go, with a `message`, and whether all is `done`, as its progress."""
    return FieldCommand(np.zeros(2), progress=Progress(message, done))


@dataclass(frozen=True)
class NoParameters:
    """For controllers that have none."""


class Controller(ABC):
    """Base of all controllers.

    A subclass states the `interface_version` it was written for, a one-line `summary`, what it
    `takes`, and as `Parameters` a frozen dataclass of `settings.setting` fields whose names end in
    their units.
    """

    interface_version: ClassVar[int]
    summary: ClassVar[str]
    Parameters: ClassVar[type] = NoParameters
    repeatable: ClassVar[bool] = True
    """Whether its commands follow from what it is given, and not from how fast the machine is."""
    takes: ClassVar[frozenset[Input] | None] = None
    """What it acts on beside the particles: goals, paths and plans that it does not take are
    refused. None, for controllers that do not say so, takes everything."""

    @classmethod
    def accepts(cls, what: Input) -> bool:
        """Whether it acts on `what`."""
        return cls.takes is None or what in cls.takes

    def __init__(self) -> None:
        self.parameters: Any = self.Parameters()

    def configure(self, parameters: Any) -> None:
        """Take `parameters`, each already within its range; ValueError refuses them whole.

        Heavy imports and reading files belong here: ticks have no time for them.
        """
        self.parameters = parameters

    def activate(self, inputs: ControllerInput) -> None:  # noqa: B027
        """Get ready to take over from the command in `inputs.field`.

        Raise a ControllerError if something indispensable is missing: the switch is refused.
        """

    @abstractmethod
    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """The command of this tick, within `inputs.limits`."""

    def deactivate(self) -> None:  # noqa: B027
        """Another controller takes over; state that should survive until the next time may."""

    def reset(self) -> None:  # noqa: B027
        """Forget everything but the parameters."""
