"""Filmed sessions: stamps, blur, noise and gaps are what the camera was said to make."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from microbot_ros.common.records import Commands, Conditions
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.virtual_rig.commands import Herding, rotating, steps
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session, scatter
from microbot_ros.virtual_rig.world import World

FLUID = Fluid(1.245e-3)
FIELD = 5e-3
EAST = Commands(np.zeros(1), np.array([[FIELD, 0.0]]))


def film(camera, duration, count=4, seed=0, control=EAST, change=None):
    rng = np.random.default_rng(seed)
    made = draw_swarm(rng, count, FLUID, FIELD, half_extent=300e-6)
    if change:
        change(made)
    return record_session(World(made, rng), control, camera, duration, rng)


def test_frames_are_stamped_with_the_middle_of_the_exposure():
    session, path = film(Camera(frame_rate=25, exposure=0.8), 2.0)
    assert path.t == pytest.approx(0.016 + np.arange(50) / 25)
    times, positions = session.tracks.grid()
    assert np.array_equal(times, path.t)
    assert positions.shape == (50, 4, 2)
    assert session.conditions == Conditions(frame_rate=25)
    strobe, _ = film(Camera(frame_rate=25), 2.0)
    assert np.unique(strobe.tracks.t) == pytest.approx(np.arange(51) / 25)


def test_straight_runs_are_seen_where_they_are_at_the_stamp():
    """Blur moves nothing that moves steadily: an exposure is no delay."""
    def silence(made):
        made['diffusion'] = made['rotational_diffusion'] = 0.0
        made['heading'] = made['phi']

    session, path = film(Camera(frame_rate=20, exposure=1.0), 3.0, change=silence)
    _, seen = session.tracks.grid()
    assert seen == pytest.approx(path.position, abs=1e-12)


@pytest.mark.parametrize(('exposure', 'blur'), [(0.0, 0.0), (1.0, 1 / 6)])
def test_noise_and_motion_blur_correlate_the_increments_as_theory_says(exposure, blur):
    """Var = 2Dh + 2σ² − 4RDh, Cov of neighbours = −σ² + 2RDh (Berglund, 2010)."""
    noise, rate = 0.05e-6, 30.0

    def still(made):
        made['speed'] = 0.0

    session, _ = film(
        Camera(rate, exposure, noise), 200.0, count=2, change=still, seed=3)
    _, seen = session.tracks.grid()
    made = draw_swarm(np.random.default_rng(0), 1, FLUID, FIELD)
    diffused = made['diffusion'][0] / rate
    d = np.diff(seen, axis=0).reshape(len(seen) - 1, -1)
    variance = 2 * diffused + 2 * noise**2 - 4 * blur * diffused
    covariance = -(noise**2) + 2 * blur * diffused
    scale = 4 * variance * math.sqrt(3 / d.size)
    assert abs(np.mean(d**2) - variance) < scale
    assert abs(np.mean(d[1:] * d[:-1]) - covariance) < scale
    assert abs(variance - 2 * diffused) > 2 * scale


def test_missed_detections_come_in_runs():
    session, _ = film(Camera(50, missed=0.1, run=4.0), 60.0, count=4, seed=1)
    _, seen = session.tracks.grid()
    gone = np.isnan(seen[..., 0])
    begins = (gone[1:] & ~gone[:-1]).sum()
    assert gone.mean() == pytest.approx(0.1, abs=0.02)
    assert gone.sum() / begins == pytest.approx(4.0, rel=0.15)
    # Misses of different particles have nothing to do with each other.
    assert abs(np.corrcoef(gone[:, 0], gone[:, 1])[0, 1]) < 0.1


def test_dropped_frames_lose_everything_at_once():
    session, path = film(Camera(50, dropped=0.2), 20.0)
    times, seen = session.tracks.grid()
    assert np.isfinite(seen).all()
    low, high = stats.binom(len(path.t), 0.8).interval(0.999)
    assert low <= len(times) <= high


def test_feedback_decides_on_what_was_seen_and_is_recorded():
    asked = []

    def control(t, seen):
        asked.append((t, seen.copy()))
        return np.array([FIELD, 1e-4 * len(asked)])

    session, path = film(Camera(20, exposure=0.5, noise=0.2e-6), 2.0, control=control)
    _, seen = session.tracks.grid()
    assert session.commands.t == pytest.approx(path.t + 0.0125)
    assert session.commands.field[:, 1] == pytest.approx(1e-4 * np.arange(1, len(asked) + 1))
    assert np.array_equal(np.array([positions for _, positions in asked]), seen)


def test_herding_keeps_the_particles_together():
    rng = np.random.default_rng(5)
    made = draw_swarm(rng, 3, FLUID, FIELD, half_extent=40e-6)
    camera = Camera(20, noise=0.1e-6, missed=0.05)
    _, herded = record_session(
        World(made.copy(), rng), Herding(made['phi'].copy(), FIELD), camera, 120.0, rng)
    distance = np.hypot(*np.moveaxis(herded.position, -1, 0))
    assert distance.max() < 100e-6
    _, alone = record_session(World(made.copy(), rng), EAST, camera, 120.0, rng)
    assert np.hypot(*alone.position[-1].T).min() > 300e-6


def test_herding_without_a_sight_of_its_particle_commands_nothing():
    herding = Herding(np.zeros(2), FIELD)
    nobody = np.full((2, 2), np.nan)
    assert np.array_equal(herding(0.0, nobody), [0.0, 0.0])
    assert herding(0.1, np.array([[1e-5, 0.0], [3e-5, 0.0]])) == pytest.approx([-FIELD, 0.0])
    assert np.array_equal(herding(0.2, nobody), [0.0, 0.0])


def test_camera_effects_are_in_the_picture_and_not_in_the_truth():
    def camera(made):
        inject_effect(made, 'pixel_anisotropy', {'aspect': 1.2}, FIELD)
        inject_effect(made, 'stage_jump', {'time_s': 1.0, 'x_um': 7.0, 'y_um': -2.0}, FIELD)

    session, path = film(Camera(10), 2.0, change=camera)
    _, seen = session.tracks.grid()
    late = (path.t >= 1.0)[:, None]
    assert seen[..., 0] == pytest.approx(path.position[..., 0] + late * 7e-6, abs=1e-12)
    assert seen[..., 1] == pytest.approx(1.2 * path.position[..., 1] - late * 2e-6, abs=1e-12)


def test_the_same_seed_films_the_same_session():
    first, second = (
        film(Camera(30, 1.0, 1e-7, 0.05, 3.0, 0.01), 3.0, seed=8)[0] for _ in range(2))
    assert np.array_equal(first.tracks.position, second.tracks.position)
    assert np.array_equal(first.tracks.t, second.tracks.t)


def test_steps_are_held_as_long_and_point_as_far_as_asked():
    rng = np.random.default_rng(0)
    drawn = steps(rng, 400.0, (2e-3, 5e-3), (2.0, 6.0), centre=1.0, spread=0.35)
    held = np.diff(drawn.t)
    assert drawn.t[0] == 0.0
    assert held.min() >= 2.0
    assert held.max() <= 6.0
    angle = np.arctan2(drawn.field[:, 1], drawn.field[:, 0]) - 1.0
    assert 0.3 < np.abs(angle).max() <= 0.35
    strength = np.hypot(*drawn.field.T)
    assert {round(s * 1e3, 6) for s in strength} == {2.0, 5.0}
    assert drawn.frequency is None
    rolled = steps(rng, 60.0, FIELD, (1.0, 2.0), frequency=(1.0, 4.0))
    assert set(rolled.frequency) == {1.0, 4.0}


def test_rotating_field_turns_once_a_period():
    turning = rotating(10.0, FIELD, period=4.0)
    angle = np.unwrap(np.arctan2(turning.field[:, 1], turning.field[:, 0]))
    assert angle[80] - angle[0] == pytest.approx(2 * math.pi)
    assert np.hypot(*turning.field.T) == pytest.approx(np.full(200, FIELD))


def test_scatter_keeps_its_distances_or_says_that_it_cannot():
    places = scatter(np.random.default_rng(0), 30, 100e-6, 15e-6)
    gaps = np.hypot(*np.moveaxis(places[:, None] - places, -1, 0))
    assert gaps[~np.eye(30, dtype=bool)].min() >= 15e-6
    assert np.abs(places).max() <= 100e-6
    with pytest.raises(ValueError, match='do not fit'):
        scatter(np.random.default_rng(0), 30, 20e-6, 15e-6)


def test_conditions_are_kept_with_the_frame_rate_filled_in():
    rng = np.random.default_rng(0)
    known = Conditions(radius=4.6e-6, reference_field=FIELD)
    made = draw_swarm(rng, 1, FLUID, FIELD)
    session, _ = record_session(World(made, rng), EAST, Camera(12.5), 1.0, rng, known)
    assert session.conditions == replace(known, frame_rate=12.5)
