"""Contract between a controller and the code that runs it.

A controller is a class with a no-argument constructor, found by its entry point in the group
`microbot_ros.controllers`. Its life cycle: `configure` (any time, also while it runs), then
`activate`, `compute` once per tick and `deactivate`, repeatedly; `reset` forgets what was learned.
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
"""Raised when a controller written for the previous contract would no longer work."""


class Result(enum.Enum):
    """Result of a tick or a switch, for messages and diagnostics."""

    OK = 'ok'
    BAD_GOAL = 'bad goal'
    PARTICLE_LOST = 'particle lost'
    NOT_KNOWN_YET = 'not known yet'
    MODEL_LACKS = 'model lacks something'
    NO_SOLUTION = 'no solution'
    STALE = 'stale poses'
    FAULT = 'fault'


class Input(enum.Enum):
    """Kind of input besides the particles; the value is its name in messages.

    `GOALS` is a list without particles, `PARTICLE_GOALS` assigns each goal to a particle.
    """

    GOALS = 'goals'
    PARTICLE_GOALS = 'goals of particles'
    PATH = 'path'
    PLAN = 'plan'
    JOYSTICK = 'joystick'


ANY_GOALS = frozenset({Input.GOALS, Input.PARTICLE_GOALS})


class ControllerError(Exception):
    """The controller cannot act now and says why: the field is zero until the next call.

    Any other exception of a controller is a fault, after which it is not called again.
    """

    result: ClassVar[Result] = Result.NO_SOLUTION


class GoalError(ControllerError):
    """A goal or path cannot be followed: not finite, outside the workspace, too many."""

    result = Result.BAD_GOAL


class ParticleLostError(ControllerError):
    """The particle to be driven is not tracked."""

    result = Result.PARTICLE_LOST


class NotLearnedError(ControllerError):
    """Speed or offset angle of a particle have not been learned yet."""

    result = Result.NOT_KNOWN_YET


class ModelError(ControllerError):
    """The model lacks something that this controller needs."""

    result = Result.MODEL_LACKS


class NoSolutionError(ControllerError):
    """No command fulfils the request."""

    result = Result.NO_SOLUTION


@dataclass(frozen=True)
class Limits:
    """Limits of a command: `field` [T], its `slew` [T/s], `frequency` [Hz].

    Raises ValueError for a limit that is not finite or negative, since it would limit nothing.
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
    """Rectangle in which particles are tracked: corners `low` and `high` (2,) [m]."""

    low: np.ndarray
    high: np.ndarray

    def holds(self, position: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Return whether each `position` (..., 2) [m] lies inside, `margin` [m] from the edge.

        NaN does not.

        Parameters
        ----------
        position : ndarray, shape (..., 2)
            Positions [m].
        margin : float
            Distance from the edge [m].

        Returns
        -------
        ndarray, shape (...)
            Whether each lies inside.
        """
        inside = (self.low + margin <= position) & (position <= self.high - margin)
        return np.asarray(inside.all(-1))


NO_IDS, NO_PLACES = np.empty(0, int), np.empty((0, 2))
"""Empty arrays of ids and of places (0, 2) [m]."""


@dataclass(frozen=True)
class Goals:
    """Goals at `position` (G, 2) [m], of the particles with `ids` (G,).

    Without ids they are a list: waypoints in order for one particle, or goals of the particles in
    ascending order of their ids. `stamp` [s] tells apart equal goals that were sent one after the
    other.
    """

    position: np.ndarray = dataclasses.field(default_factory=NO_PLACES.copy)
    ids: np.ndarray | None = None
    stamp: float = 0.0

    def __len__(self) -> int:
        return len(self.position)

PER_PARTICLE = (
    'ids', 'position', 'sigma', 'theta', 'speed', 'phi', 'speed_std', 'phi_std')


@dataclass(frozen=True)
class ControllerInput:
    """All inputs of a controller at one tick.

    Attributes
    ----------
    t, dt, age : float [s]
        Present time, time since the last tick, time since the exposure of the poses.
    ids : (N,) int array
    position : (N, 2) array [m]
        Measured, with standard deviation `sigma`.
    sigma : (N,) array [m]
    theta : (N,) array [rad]
        Heading, NaN if unknown.
    speed, speed_std : (N,) array [m/s], or [m/s/Hz] for rollers
        Estimate; a standard deviation of inf means unknown.
    phi, phi_std : (N,) array [rad]
        Estimated offset angle.
    limits : Limits
    workspace : Workspace
    delay : float
        Time until a command given now takes effect [s].
    goals : Goals
    path : (P, 2) array [m]
    field, frequency : (2,) array [T], float [Hz]
        The previous command.
    joystick : (2,) array
        Deflection within the unit circle.
    model : Model or None
    expected : (N, 2) array [m]
        Predicted positions at `t` + `delay`, as far as they are known.
    record : FieldRecord
        Commands of the last seconds.
    plan : Commands or None
        Fields to be played, on a clock that starts with them; the last row is the end.
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
        """Return the row of a `particle`; ParticleLostError if it is not tracked.

        Parameters
        ----------
        particle : int
            Identity of the particle.

        Returns
        -------
        int
            Its row.
        """
        rows = np.flatnonzero(self.ids == particle)
        if not rows.size:
            raise ParticleLostError(f'particle {particle} is not tracked')
        return int(rows[0])

    def require_particles(self) -> None:
        """Raise ParticleLostError if no particle is tracked."""
        if not len(self.ids):
            raise ParticleLostError('no particle is tracked')

    def require_rollers(self) -> None:
        """Raise ModelError without a model of rollers."""
        if self.model is None or self.model.propulsion != 'rolling':
            raise ModelError('drives rollers: set model_file to a model with propulsion: rolling')

    def refuse_rollers(self) -> None:
        """Raise ModelError for a model of rollers."""
        if self.model is not None and self.model.propulsion == 'rolling':
            raise ModelError('drives self-propelled particles; the model is of rollers')

    def learned(self, phi_std: float) -> np.ndarray:
        """Return which particles (N,) have a known φ, to a standard deviation `phi_std` [rad].

        Parameters
        ----------
        phi_std : float
            Largest standard deviation [rad].

        Returns
        -------
        ndarray, shape (N,)
            Whether each is known.
        """
        return np.isfinite(self.phi) & (self.phi_std <= phi_std)


@dataclass(frozen=True)
class Progress:
    """Progress of a controller, for people and for waiting programs.

    Attributes
    ----------
    message : str
        What the controller is doing.
    done : bool
        Whether the request is fulfilled.
    distance : float
        Remaining distance to the goal [m], NaN if undefined.
    goal : int or None
        Index of the present goal, None if goals are not taken one after the other.
    """

    message: str = ''
    done: bool = False
    distance: float = float('nan')
    goal: int | None = None


@dataclass(frozen=True)
class FieldCommand:
    """Command of one tick.

    A rotating field rolls particles along its in-plane part, or rotates about `axis`,
    right-handed. The manager keeps no particles in view for commands with an axis or a part along
    z.

    Attributes
    ----------
    field : (2,) or (3,) array [T]
    frequency : float
        Rotation frequency for rollers [Hz].
    progress : Progress
    particles : (K,) int array or None
        Ids of the driven particles, which are kept in view; None: all.
    axis : (3,) array or None
        Unit vector.
    """

    field: np.ndarray
    frequency: float = 0.0
    progress: Progress = dataclasses.field(default_factory=Progress)
    particles: np.ndarray | None = None
    axis: np.ndarray | None = None

    @property
    def angular_velocity(self) -> np.ndarray:
        """ω (3,) [rad/s] of the field, rollers move along ω̂ × ẑ; zero for a static field."""
        axis = self.axis
        if axis is None:
            x, y = self.field[:2] / (math.hypot(*self.field[:2]) or 1.0)
            axis = np.array([-y, x, 0.0])
        return math.tau * self.frequency * axis

    @property
    def drive(self) -> np.ndarray:
        """In-plane vector (2,) [T] along which particles swim or roll."""
        if self.axis is None:
            return self.field[:2]
        x, y = float(np.linalg.norm(self.field)) * self.axis[:2]
        return np.array([y, -x])

    @property
    def in_plane(self) -> bool:
        """Whether the command drives particles along the plane only."""
        return self.axis is None and len(self.field) == 2


def no_field(message: str, done: bool = False) -> FieldCommand:
    """Return a command of zero field with a `message` and `done` as its progress.

    Parameters
    ----------
    message : str
        Text for people.
    done : bool
        Whether the goals are reached.

    Returns
    -------
    FieldCommand
        The command.
    """
    return FieldCommand(np.zeros(2), progress=Progress(message, done))


@dataclass(frozen=True)
class NoParameters:
    """Parameters of controllers that have none."""


class Controller(ABC):
    """Base of all controllers.

    A subclass states the `interface_version` it was written for, a one-line `summary`, the inputs
    it `takes`, and as `Parameters` a frozen dataclass of `settings.setting` fields whose names end
    in their units.
    """

    interface_version: ClassVar[int]
    summary: ClassVar[str]
    Parameters: ClassVar[type] = NoParameters
    repeatable: ClassVar[bool] = True
    """Whether commands depend on the inputs only, not on the speed of the computer."""
    takes: ClassVar[frozenset[Input] | None] = None
    """Inputs that it uses besides the particles; other goals, paths and plans are refused.

    None, for controllers that do not declare it, means all inputs.
    """

    @classmethod
    def accepts(cls, what: Input) -> bool:
        """Return whether it uses the input `what`.

        Parameters
        ----------
        what : Input
            The input.

        Returns
        -------
        bool
            Whether it does.
        """
        return cls.takes is None or what in cls.takes

    def __init__(self) -> None:
        self.parameters: Any = self.Parameters()

    def configure(self, parameters: Any) -> None:
        """Take `parameters`, each already within its range; ValueError refuses all of them.

        Heavy imports and file reading belong here: ticks have no time for them.

        Parameters
        ----------
        parameters : object
            The parameters.
        """
        self.parameters = parameters

    def activate(self, inputs: ControllerInput) -> None:  # noqa: B027
        """Prepare to take over from the command in `inputs.field`.

        Raise a ControllerError if something indispensable is missing: the switch is refused.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        """

    @abstractmethod
    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return the command of this tick, within `inputs.limits`.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        FieldCommand
            The command.
        """

    def deactivate(self) -> None:  # noqa: B027
        """Stop driving: another controller takes over. State may be kept until the next time."""

    def reset(self) -> None:  # noqa: B027
        """Forget everything but the parameters."""
