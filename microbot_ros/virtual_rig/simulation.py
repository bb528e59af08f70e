"""Run a scenario by the selected physics."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from microbot_ros.common.checked import SettingsError
from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Session
from microbot_ros.model.first_order import simulate
from microbot_ros.model.increments import beyond_learned
from microbot_ros.model.io.effect_table import read_effects
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.newton_stokes import newton_stokes
from microbot_ros.model.physics.particle import Particle, rotational_drag, sphere_mass, stokes_drag
from microbot_ros.model.timeline import Timeline
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.closed_loop import LoopFeedback, film, make_feedback, tell_fault
from microbot_ros.virtual_rig.foreign_effects import make_world
from microbot_ros.virtual_rig.injected_effects import INJECTABLE, inject_effect
from microbot_ros.virtual_rig.record_session import (
    Feedback,
    as_tracks,
    detection_errors,
    record_session,
    scatter,
)
from microbot_ros.virtual_rig.scenario import Scenario

POLYSTYRENE = 984.0
"""Density [kg/m³] from the paper's mass and radius, for inertia in `newton_stokes`."""


def run(scenario: Scenario, particles: ParticleParameters, source: str) -> Session:
    """Simulate a `scenario` with `particles`; InputError naming `source` if impossible.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    particles : ParticleParameters
        The particles.
    source : str
        Name of the scenario, for messages.

    Returns
    -------
    Session
        The session.
    """
    session = _simulated(scenario, particles, source)
    if not len(session.tracks.t):
        raise InputError(source, 'expected particles that the camera sees and the tracker finds, '
                         'found none: is the recording long enough, are frames left out?')
    return session


def _simulated(scenario: Scenario, particles: ParticleParameters, source: str) -> Session:
    rng = np.random.default_rng(scenario.seed)
    count = len(particles.ids)
    start = starting_places(scenario, count, rng, source)
    control = (make_feedback(scenario, source) if scenario.commands is None else
               scenario.commands.control(scenario.duration_s, particles.phi, rng))
    heading = rng.uniform(-math.pi, math.pi, count)
    if scenario.physics == 'langevin':
        world = make_world(make_bodies(scenario, particles, start, heading), rng,
                           scenario.effects, scenario.reference_field, scenario.learned,
                           walls=1e-6 * np.array(scenario.walls_um), ids=particles.ids)
        if scenario.controller and scenario.controller.pictures:
            # Particles have the ids of the tracker.
            return film(scenario, world, source)
        session, _ = record_session(
            world, control, scenario.camera.camera(), scenario.duration_s, rng,
            scenario.conditions)
        if isinstance(control, LoopFeedback):
            tell_fault(control.loop, source)
    else:
        session = _without_noise(scenario, particles, control, start, heading, rng, source)
    # Particles keep the ids of the scenario or its model.
    named = replace(session.tracks, particle=particles.ids[session.tracks.particle])
    return replace(session, tracks=named)


def strays(scenario: Scenario, particles: ParticleParameters, session: Session) -> list[str]:
    """Return sentences on how much of a `session` was outside the range of learned terms.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    particles : ParticleParameters
        The particles.
    session : Session
        The session.

    Returns
    -------
    list of str
        The sentences.
    """
    if not scenario.learned:
        return []
    model = Model(scenario.reference_field, scenario.propulsion, learned=scenario.learned)
    times, positions = session.tracks.grid()
    known = dict(zip(particles.ids.tolist(), particles.phi.tolist(), strict=True))
    ids = session.tracks.particles
    phi = np.array([known.get(name, math.nan) for name in ids.tolist()])
    beyond = beyond_learned(model, Timeline(session.commands, times, positions, ids, phi))
    return [f'{100 * out.mean():.0f} % of the time particles were outside the '
            f'range where a term was learned against {against}: the term fades '
            'there' for against, out in beyond.items() if out.any()]


def starting_places(
    scenario: Scenario, count: int, rng: np.random.Generator, source: str,
    drawn: bool = False,
) -> np.ndarray:
    """Return initial positions (`count`, 2) [m] of a `scenario`: as listed, else drawn by `rng`.

    Raises InputError naming `source` if so many do not fit.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    count : int
        Number of particles N.
    rng : random.Generator
        Source of random numbers.
    source : str
        Name of the scenario, for messages.
    drawn : bool
        Whether to draw them even if some are listed.

    Returns
    -------
    ndarray, shape (N, 2)
        Positions [m].
    """
    if scenario.particles and not drawn:
        return np.array([(p.x_um, p.y_um) for p in scenario.particles]) * 1e-6
    try:
        return scatter(rng, count, scenario.spread_um * 1e-6, 3 * scenario.radius)
    except ValueError as error:
        raise InputError(source, f"'spread_um': {error}") from None


def make_bodies(
    scenario: Scenario, particles: ParticleParameters, start: np.ndarray, heading: np.ndarray,
) -> np.ndarray:
    """Return the `particles` (N) of a `scenario`, of type BODY, with its effects on bodies.

    They start at `start` (N, 2) [m] with the `heading` (N,) [rad].

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    particles : ParticleParameters
        The N particles.
    start : ndarray, shape (N, 2)
        Positions [m].
    heading : ndarray, shape (N,)
        Headings [rad].

    Returns
    -------
    ndarray, shape (N,)
        BODY of each particle.
    """
    radius = np.full(len(start), scenario.radius)
    made = bodies(
        scenario.medium, radius, _moment(scenario), particles.phi, start, heading=heading,
        **{'speed' if scenario.propulsion == 'catalytic' else 'gain': particles.speed})
    for effect, parameters in scenario.effects.items():
        if effect in INJECTABLE:
            inject_effect(made, effect, parameters, scenario.reference_field)
    return made


def _moment(scenario: Scenario) -> float:
    """Return the moment [A·m²] with the requested alignment time."""
    drag = rotational_drag(scenario.medium, scenario.radius)
    return drag / (scenario.alignment_ms * 1e-3 * scenario.reference_field)


def _without_noise(
    scenario: Scenario, particles: ParticleParameters, control: Commands | Feedback,
    start: np.ndarray, heading: np.ndarray, rng: np.random.Generator, source: str,
) -> Session:
    """Simulate by deterministic equations; only the camera's errors are random."""
    camera = scenario.camera.camera()
    if not isinstance(control, Commands) or camera.exposure > 0:
        raise InputError(
            source, "'physics': expected langevin with feedback or an exposure; received "
                    f"'{scenario.physics}'")
    frames = math.floor(scenario.duration_s * camera.frame_rate + 1e-9) + 1
    times = np.arange(frames) / camera.frame_rate
    if scenario.physics == 'first_order':
        model = _model(scenario, source)
        path = model.observe(simulate(model, particles, control, times, start))
    else:
        path = _newton_stokes(scenario, particles, control, times, start, heading, source)
    seen = path + detection_errors(camera, frames, len(start), rng)
    return Session(as_tracks(times, seen), control, scenario.conditions)


def _model(scenario: Scenario, source: str) -> Model:
    try:
        effects = read_effects(scenario.effects)
    except InputError:
        raise
    except ValueError as error:  # of the table, or of an effect of its own values
        problem = error.below('effects') if isinstance(error, SettingsError) else error
        raise InputError(source, f'for first_order physics: {problem}') from None
    return Model(scenario.reference_field, scenario.propulsion, effects, scenario.learned)


def _newton_stokes(
    scenario: Scenario, particles: ParticleParameters, commands: Commands, times: np.ndarray,
    start: np.ndarray, heading: np.ndarray, source: str,
) -> np.ndarray:
    if scenario.effects or scenario.learned or scenario.propulsion != 'catalytic':
        raise InputError(
            source, "'physics': newton_stokes expects catalytic particles without effects")
    radius = scenario.radius
    forces = particles.speed * stokes_drag(scenario.medium, radius)
    swimmers = [
        Particle(radius, sphere_mass(radius, POLYSTYRENE), float(force), float(phi),
                 _moment(scenario))
        for force, phi in zip(forces, particles.phi, strict=True)]
    return newton_stokes(scenario.medium, swimmers, commands, times, start, heading)[0]
