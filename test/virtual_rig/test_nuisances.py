"""The imperfections of the benchmark: each changes what it states and nothing else."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from bench import _nuisances as nuisances
from bench._hidden_suite import FLUID, blind
from bench._judge_cases import with_nuisance
from bench._nuisances import NUISANCES
from microbot_ros.common.records import Session

COLUMNS = ('t', 'particle', 'position')
CHANGES = {
    'outliers': {'position'}, 'software stamps': {'t'}, 'changing focus': {'position'},
    'exchanged identities': {'particle'}, 'half pixels': {'position'},
    'stage drift': {'position'}, 'command gaps': set[str](),
}
"""What changes in the tracks, row by row, of kinds that keep the rows."""


@functools.cache
def clean() -> Session:
    return blind(3, 'paper', duration=40.0, count=3).session


def laid(name: str, seed: int = 5) -> Session:
    return NUISANCES[name].overlay(np.random.default_rng(seed), clean())


@pytest.mark.parametrize('name', CHANGES)
def test_an_imperfection_changes_its_column_only(name: str) -> None:
    before, after = clean().tracks, laid(name).tracks
    changed = {c for c in COLUMNS if not np.array_equal(getattr(before, c), getattr(after, c))}
    assert changed == CHANGES[name]
    assert (laid(name).commands is clean().commands) == (name != 'command gaps')


@pytest.mark.parametrize('name', NUISANCES)
def test_an_imperfection_is_seeded(name: str) -> None:
    first, second, other = (
        with_nuisance(blind(3, 'paper', duration=5.0, count=3), name, seed).tracks.position
        for seed in (1, 1, 2))
    assert np.array_equal(first, second)
    if name in ('outliers', 'changing focus', 'stage drift', 'differing sizes'):
        assert not np.array_equal(first, other)


def test_one_detection_in_a_hundred_is_off_by_micrometres() -> None:
    off = np.hypot(*(laid('outliers').tracks.position - clean().tracks.position).T)
    assert 0.004 < (off > 0).mean() < 0.02
    assert nuisances.OUTLIER_M[0] * 0.999 < off[off > 0].min() < off.max() < 5.001e-6


def test_software_stamps_are_late_by_milliseconds_and_keep_their_order() -> None:
    stamps, times = np.unique(laid('software stamps').tracks.t), np.unique(clean().tracks.t)
    assert len(stamps) == len(times)
    assert 2e-3 < np.std(stamps - times) < 4e-3
    assert abs(np.mean(stamps - times)) < 0.5e-3
    assert np.diff(stamps).min() > 0.99e-4


def test_defocus_differs_between_particles_and_over_time() -> None:
    tracks = clean().tracks
    error = laid('changing focus').tracks.position - tracks.position
    sizes = np.array([
        [error[(tracks.particle == p) & (tracks.t // 5 == part)].std() for part in range(8)]
        for p in tracks.particles])
    assert (sizes.max(axis=1) > 2 * sizes.min(axis=1)).all()
    assert (sizes.max(axis=0) > 2 * sizes.min(axis=0)).any()


def test_no_track_is_longer_than_ten_seconds() -> None:
    after, before = laid('broken tracks').tracks, clean().tracks
    lengths = [np.ptp(after.of(p).t) for p in after.particles]
    assert 6 < max(lengths) <= nuisances.BROKEN_S
    assert len(after.particles) > 3 * len(before.particles)
    rows = {(t, *p) for t, p in zip(before.t, before.position, strict=True)}
    assert {(t, *p) for t, p in zip(after.t, after.position, strict=True)} < rows


def test_identities_are_exchanged_pairwise() -> None:
    before, after = clean().tracks.particle, laid('exchanged identities').tracks.particle
    assert set(after) == set(before)
    alone = blind(3, 'paper', duration=5.0, count=1).session
    assert nuisances.exchanged_identities(np.random.default_rng(0), alone) is alone


def test_bursts_lose_whole_frames() -> None:
    after, before = laid('lost bursts').tracks, clean().tracks
    lost = np.setdiff1d(before.t, after.t)
    assert len(lost)
    assert len(after.t) == (~np.isin(before.t, lost)).sum()


def test_the_log_of_commands_has_gaps_but_keeps_its_first_row() -> None:
    after, before = laid('command gaps').commands, clean().commands
    assert after.t[0] == before.t[0]
    assert 1 <= len(before.t) - len(after.t) <= 4
    assert np.array_equal(after.field, before.field[np.isin(before.t, after.t)])


def test_positions_lie_on_half_pixels() -> None:
    step = nuisances.PIXEL_M / 2
    position = laid('half pixels').tracks.position
    assert np.abs(position / step - np.round(position / step)).max() < 1e-6
    assert np.abs(position - clean().tracks.position).max() <= step / 2 * 1.001


def test_all_particles_of_a_frame_move_with_the_stage() -> None:
    tracks = clean().tracks
    moved = laid('stage drift').tracks.position - tracks.position
    for t in np.unique(tracks.t)[::100]:
        assert np.ptp(moved[tracks.t == t], axis=0).max() < 1e-15
    assert 0.1e-6 < moved.std() < 1e-6


def test_radii_differ_and_drag_diffusion_and_moment_with_them() -> None:
    swarm = blind(3, 'paper', duration=5.0, count=3).experiment.swarm
    made = nuisances.differing_sizes(np.random.default_rng(1), swarm, FLUID)
    ratio = made['radius'] / swarm['radius']
    assert np.ptp(ratio) > 0.05
    np.testing.assert_allclose(made['drag'] * made['diffusion'],
                               swarm['drag'] * swarm['diffusion'])
    np.testing.assert_allclose(made['turn_drag'] / made['moment'],
                               swarm['turn_drag'] / swarm['moment'])
    same = set(swarm.dtype.names) - {
        'radius', 'drag', 'diffusion', 'turn_drag', 'rotational_diffusion', 'moment'}
    for name in same:
        np.testing.assert_array_equal(made[name], swarm[name])


def test_held_particles_rest_and_knocked_ones_do_not() -> None:
    experiment = blind(3, 'paper', duration=40.0, count=3).experiment
    worlds: list[nuisances.Encounters] = []

    def make(bodies: np.ndarray, rng: np.random.Generator) -> nuisances.Encounters:
        worlds.append(nuisances.Encounters(bodies, rng))
        return worlds[-1]

    _, path = experiment.film({}, world=make)
    moved = [
        np.hypot(*np.ptp(path.position[rows, particle], axis=0))
        for begin, end, particle in worlds[0].touched_at
        for rows in [(path.t > begin) & (path.t < end)] if rows.sum() > 3]
    assert min(moved) == 0.0
    assert max(moved) > 0.5e-6


def test_speeds_wander_about_their_mean() -> None:
    experiment = blind(3, 'paper', duration=40.0, count=3).experiment
    swarm = experiment.swarm.copy()
    swarm['diffusion'] = swarm['rotational_diffusion'] = 0.0
    still = type(experiment)(swarm, experiment.control, experiment.camera, 40.0,
                             experiment.conditions, experiment.chance)
    _, path = still.film({}, world=nuisances.WanderingSpeeds)
    steps = np.hypot(*np.moveaxis(np.diff(path.position, axis=0), -1, 0))
    speed = steps / np.diff(path.t)[:, None] / swarm['speed']
    assert 0.07 < speed.std() < 0.25
    assert 0.85 < speed.mean() < 1.15
