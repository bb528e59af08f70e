"""Scenarios of `microbot simulate`, as YAML with a unit in every name."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np

from microbot_ros.common.checked import Field, Settings, SettingsError
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import line_of, read_yaml
from microbot_ros.common.plausible import check_plausible
from microbot_ros.common.records import Commands, Conditions, height_problem
from microbot_ros.common.units import exact_si
from microbot_ros.model.io.effect_table import write_effects
from microbot_ros.model.io.model_file import read_model
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.model import Model, ParticleParameters, Propulsion
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.virtual_rig.commands import ROTATING_HZ, Herding, rotating, steps
from microbot_ros.virtual_rig.foreign_effects import check_effect
from microbot_ros.virtual_rig.record_session import Camera, Feedback

Positive = Annotated[float, Field(gt=0)]
Fraction = Annotated[float, Field(ge=0, lt=1)]
LevelSettings = Positive | Annotated[tuple[Positive, ...], Field(min_length=1)]
_MOST_ROWS = 1e7  # choice: frames of a simulation, an array of 160 MB per particle
EffectSettings = dict[str, dict[str, float | tuple[float, ...]]]


class FluidSettings(Settings):
    """Section `fluid`."""

    viscosity_mPa_s: Positive
    temperature_K: Positive = 298.15


class CameraSettings(Settings):
    """Section `camera`; see `record_session.Camera`."""

    frame_rate_hz: Positive
    exposure: Annotated[float, Field(ge=0, le=1)] = 0.0
    localisation_um: Annotated[float, Field(ge=0)] = 0.0
    missed: Fraction = 0.0
    run: Positive = 1.0
    dropped: Fraction = 0.0

    def __post_init__(self) -> None:
        self.camera()

    def camera(self) -> Camera:
        """Return the camera in SI.

        Returns
        -------
        Camera
            The camera.
        """
        noise = self.localisation_um * 1e-6
        return Camera(
            self.frame_rate_hz, self.exposure, noise, self.missed, self.run, self.dropped)


class SwimmerSettings(Settings):
    """One of `particles`: its start and its response to the field."""

    x_um: float
    y_um: float
    phi_rad: float
    v_um_s: float = 0.0
    gain_um_s_hz: float = 0.0


class StepSettings(Settings):
    """Random commands; see `commands.steps`."""

    field_mT: LevelSettings
    dwell_s: tuple[Positive, Positive]
    centre_deg: float = 0.0
    spread_deg: Annotated[float, Field(gt=0, le=180)] = 180.0
    frequency_hz: LevelSettings | None = None

    def __post_init__(self) -> None:
        if self.dwell_s[0] > self.dwell_s[1]:
            raise SettingsError('expected the shortest, then the longest', 'dwell_s')


class RotatingSettings(Settings):
    """Steadily rotating field; see `commands.rotating`."""

    field_mT: Positive
    period_s: Positive


class HerdingSettings(Settings):
    """Feedback; see `commands.Herding`."""

    field_mT: Positive
    patience_s: Positive = 2.0


class RowSettings(Settings):
    """One of a list of commands, held until the next."""

    t_s: float
    field_mT: Annotated[float, Field(ge=0)]
    direction_deg: float
    frequency_hz: float | None = None


class CommandSettings(Settings):
    """Section `commands`: exactly one kind of command."""

    steps: StepSettings | None = None
    rotating: RotatingSettings | None = None
    herding: HerdingSettings | None = None
    rows: Annotated[tuple[RowSettings, ...], Field(min_length=1)] | None = None

    def __post_init__(self) -> None:
        if any(after.t_s <= before.t_s for before, after in pairwise(self.rows or ())):
            raise SettingsError("expected 't_s' to ascend", 'rows')
        if len(self.given) != 1:
            raise ValueError('expected exactly one of: steps, rotating, herding, rows')

    def control(
        self, duration: float, phi: np.ndarray, rng: np.random.Generator,
    ) -> Commands | Feedback:
        """Return the commands for `duration` [s], or the feedback that decides them, in SI.

        `phi` (N,) [rad] are the offsets of the particles; `rng` draws random commands.

        Parameters
        ----------
        duration : float
            Duration [s].
        phi : ndarray, shape (N,)
            Offsets of the particles [rad].
        rng : random.Generator
            Source of random numbers.

        Returns
        -------
        Commands or Feedback
            Commands or feedback.
        """
        if self.steps:
            s = self.steps
            return steps(
                rng, duration, np.multiply(s.field_mT, 1e-3), s.dwell_s,
                math.radians(s.centre_deg), math.radians(s.spread_deg), s.frequency_hz)
        if self.rotating:
            return rotating(duration, self.rotating.field_mT * 1e-3, self.rotating.period_s)
        if self.herding:
            return Herding(phi, self.herding.field_mT * 1e-3, self.herding.patience_s)
        return self._listed()

    @property
    def rate_hz(self) -> float:
        """Largest number of commands per second."""
        return 1 / self.steps.dwell_s[0] if self.steps else ROTATING_HZ if self.rotating else 0.0

    @property
    def rolls(self) -> bool:
        """Whether the field rotates to roll particles."""
        ways = self.rows or (self.steps,)
        return any(getattr(way, 'frequency_hz', None) is not None for way in ways)

    def _listed(self) -> Commands:
        rows = self.rows or ()
        angle = np.radians([row.direction_deg for row in rows])
        strength = np.array([row.field_mT for row in rows]) * 1e-3
        field = np.column_stack((strength * np.cos(angle), strength * np.sin(angle)))
        rolled = np.array([row.frequency_hz or 0.0 for row in rows])
        return Commands(np.array([row.t_s for row in rows]), field, rolled if self.rolls else None)


Place = tuple[float, float]
Wall = tuple[float, float, float, float]


class ControllerSettings(Settings):
    """Section `controller`: the loop is closed by one of the installed controllers.

    The controller `name` gets `goals_um` and `path_um`, rows of x and y, may command up to
    `max_field_mT`, and has its own `parameters`. With `pictures` the tracker finds the particles
    in pictures of a microscope; otherwise the loop gets the positions that the camera reports.
    """

    name: str
    goals_um: tuple[Place, ...] = ()
    path_um: tuple[Place, ...] = ()
    max_field_mT: Positive = 5.0
    parameters: dict[str, Any] = Field(default_factory=dict)
    pictures: bool = False


class Scenario(Settings):
    """Whole scenario of a simulation.

    `particles` are listed, or `model` names a `model.yaml` (path from the scenario's folder): its
    particles start at random within ± `spread_um`, its effects are added to `effects`, and its
    learned terms act too. `alignment_ms` is the alignment time at the reference field, `height_um`
    the height of the centres above the floor (far from it if absent), `walls_um` x, y, x, y of the
    ends of straight walls. The field follows either `commands` or a `controller`.
    """

    physics: Literal['langevin', 'first_order', 'newton_stokes'] = 'langevin'
    propulsion: Propulsion = 'catalytic'
    duration_s: Positive
    seed: Annotated[int, Field(ge=0)] = 0
    radius_um: Positive
    height_um: Positive | None = None
    reference_field_mT: Positive
    alignment_ms: Positive = 0.5
    fluid: FluidSettings
    camera: CameraSettings
    particles: tuple[SwimmerSettings, ...] = ()
    model: str | None = None
    spread_um: Positive = 100.0
    walls_um: tuple[Wall, ...] = ()
    commands: CommandSettings | None = None
    controller: ControllerSettings | None = None
    effects: EffectSettings = Field(default_factory=dict)
    _learned: ClassVar[tuple[LearnedTerm, ...]] = ()

    @property
    def learned(self) -> tuple[LearnedTerm, ...]:
        """Learned terms of its `model`."""
        return self._learned

    def __post_init__(self) -> None:
        if problem := height_problem(self.height_um, self.radius_um):
            raise SettingsError(problem, 'height_um')
        self._check_particles()
        self._check_walls()
        self._check_commands()

    def _check_particles(self) -> None:
        if bool(self.particles) == bool(self.model):
            raise ValueError("expected either 'particles' or 'model'")
        for i, particle in enumerate(self.particles):
            if particle.given & {'v_um_s', 'gain_um_s_hz'} != {self.speed_key}:
                raise ValueError(f"expected '{self.speed_key}' of {self.propulsion} particle {i}")

    def _check_walls(self) -> None:
        if self.walls_um and self.physics != 'langevin':
            raise ValueError("expected langevin physics for 'walls_um'")
        if any(wall[:2] == wall[2:] for wall in self.walls_um):
            raise ValueError("expected two different ends of each of 'walls_um'")

    def _check_commands(self) -> None:
        if (self.commands is None) == (self.controller is None):
            raise ValueError("expected either 'commands' or 'controller'")
        rolls = self.commands is not None and self.commands.rolls
        if self.controller and (self.propulsion, self.physics) != ('catalytic', 'langevin'):
            raise ValueError('expected catalytic particles and langevin physics for a controller')
        if rolls != (self.propulsion == 'rolling'):
            raise ValueError("expected 'frequency_hz' in the commands of rolling particles only")
        if self.duration_s * self.camera.frame_rate_hz < 2:
            raise ValueError("expected 'duration_s' to hold at least two frames")
        rows = self.duration_s * max(
            self.camera.frame_rate_hz, self.commands.rate_hz if self.commands else 0.0)
        if rows > _MOST_ROWS:
            raise ValueError(f"expected 'duration_s' to hold at most {_MOST_ROWS:g} frames, and "
                             f'as many commands; it would hold {rows:.3g}')

    def replaced(self, **changes: Any) -> Self:
        """Return this scenario with `changes`, checked, and with the same learned terms.

        Parameters
        ----------
        **changes : object
            New values of fields.

        Returns
        -------
        Scenario
            The new scenario.
        """
        changed = super().replaced(**changes)
        object.__setattr__(changed, '_learned', self._learned)
        return changed

    @property
    def speed_key(self) -> str:
        """Name of the speed parameter of a particle."""
        return 'v_um_s' if self.propulsion == 'catalytic' else 'gain_um_s_hz'

    @property
    def listed(self) -> ParticleParameters:
        """The listed particles."""
        name = self.speed_key
        return ParticleParameters(
            np.arange(len(self.particles)),
            np.array([exact_si(name, getattr(p, name)) for p in self.particles]),
            np.array([p.phi_rad for p in self.particles]))

    @property
    def reference_field(self) -> float:
        """Reference field [T]."""
        return exact_si('reference_field_mT', self.reference_field_mT)

    @property
    def radius(self) -> float:
        """Radius [m]."""
        return exact_si('radius_um', self.radius_um)

    @property
    def height(self) -> float | None:
        """Height [m], or None."""
        return None if self.height_um is None else exact_si('height_um', self.height_um)

    @property
    def medium(self) -> Fluid:
        """The fluid in SI."""
        return Fluid(
            exact_si('viscosity_mPa_s', self.fluid.viscosity_mPa_s), self.fluid.temperature_K,
            self.height)

    @property
    def conditions(self) -> Conditions:
        """Conditions of the simulated session."""
        return Conditions(
            self.propulsion, self.radius, self.medium.viscosity,
            self.medium.temperature, self.camera.frame_rate_hz, None, self.reference_field,
            self.height)


def read_scenario(path: Path) -> tuple[Scenario, ParticleParameters]:
    """Read a scenario and its particles from `path`, with the effects of its `model` included.

    Raises InputError naming file, line, key and what was expected.

    Parameters
    ----------
    path : Path
        YAML file to read.

    Returns
    -------
    tuple[Scenario, ParticleParameters]
        The scenario and its particles.
    """
    scenario = read_yaml(path, Scenario)
    particles = scenario.listed
    if scenario.model is not None:
        model, particles = read_model(path.parent / scenario.model)
        if not len(particles.ids):
            raise InputError(path.parent / scenario.model,
                             'expected particles to simulate, found none')
        scenario = _with_model(path, scenario, model)
    for effect, parameters in scenario.effects.items():
        try:
            for name, value in parameters.items():
                check_plausible(name, value)
            check_effect(effect, parameters)
        except ValueError as error:
            raise InputError(path, str(error), line_of(path, 'effects', effect)) from None
        if any(np.size(v) not in (1, len(particles.ids)) for v in parameters.values()):
            raise InputError(
                path, f'{effect}: expected one value, or one for each particle',
                line_of(path, 'effects', effect))
    return scenario, particles


def _with_model(path: Path, scenario: Scenario, model: Model) -> Scenario:
    """Return the scenario with a model's effects; those in the scenario take precedence."""
    if model.propulsion != scenario.propulsion:
        raise InputError(
            path, f"'propulsion': expected {model.propulsion}, as in {scenario.model}",
            line_of(path, 'propulsion'))
    if not math.isclose(model.reference_field, scenario.reference_field):
        raise InputError(
            path, f"'reference_field_mT': expected {model.reference_field * 1e3:g}, as in "
            f'{scenario.model}', line_of(path, 'reference_field_mT'))
    found = write_effects(model.effects)
    try:
        changed = scenario.replaced(effects=found | scenario.effects)
    except SettingsError as error:
        raise InputError(path, f'{scenario.model}: {error}', line_of(path, 'model')) from None
    object.__setattr__(changed, '_learned', model.learned)
    return changed
