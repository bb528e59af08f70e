"""An effect is offered only where the commands excite it and within the bounds of physics."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.evidence import FitEvidence
from microbot_ros.discovery.hypotheses import _possible, fit_first_order, log_bayes_factor
from microbot_ros.discovery.search import CandidateFit, fit_candidate
from microbot_ros.discovery.verdict import enough
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model


def fitted(session):
    """The first-order model on a `session`."""
    return fit_first_order(check_sessions([session])[0])


def test_pixels_are_no_candidate_under_commands_along_one_line(film):
    """There v absorbs them, and how much the speed fluctuates would stand in for their shape."""
    session, _ = film(30, duration=15.0)
    line = 5e-3 * np.sign(session.commands.field[:, 1:]) * np.array([[0.0, 1.0]])
    assert fit_candidate(fitted(session), 'pixel_anisotropy')
    alone = replace(session, commands=replace(session.commands, field=line))
    assert not fit_candidate(fitted(alone), 'pixel_anisotropy')


def test_pixels_are_no_candidate_where_coils_bend_paths_alike(film):
    """Within 8° of a line what pixels do to speeds is small beside what both do to directions."""
    session, _ = film(30, duration=15.0)
    angle = np.pi / 2 + np.radians(8) * np.sign(session.commands.field[:, 0])
    near = 5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    narrow = replace(session, commands=replace(session.commands, field=near))
    assert not fit_candidate(fitted(narrow), 'pixel_anisotropy')
    assert fit_candidate(fitted(narrow), 'coil_gain_mismatch')


@pytest.mark.parametrize(('name', 'parameters', 'seen'), [
    *(('pixel_anisotropy', {'aspect': x}, ok) for x, ok in (
        (1 / 1.5, False), (0.68, True), (1.0, True), (1.49, True), (1.5, False),
        (np.nan, False))),
    ('coil_gain_mismatch', {'gain_ratio': 2.5}, False),
    ('coil_misalignment', {'skew': -1.0}, False), ('coil_misalignment', {'skew': 0.2}, True),
    ('speed_decay', {'tau': np.inf}, True), ('speed_decay', {'tau': 1.0}, False),
    ('command_delay', {'delay': 0.0}, True),
    ('periodic_drift', {'amplitude': -1e-4, 'frequency': 1.0}, False),
    ('drive_response', {'cut_in': 0.0, 'slip': 1.0, 'step_out': 10.0}, True)])
def test_a_strength_at_a_bound_is_not_seen(name, parameters, seen):
    """No camera and no coil goes beyond; a slip of all the gain is a limit of the curve."""
    assert EFFECTS[name](**parameters).shape_seen(SimpleNamespace()) == seen


@pytest.mark.parametrize(('effect', 'shape_seen', 'possible'), [
    (EFFECTS['hot_spot'](0.0, 0.0, -99e-6, 1e-5), False, True),
    (EFFECTS['hot_spot'](0.0, 0.0, -100e-6, 1e-5), False, False),
    (EFFECTS['drive_response'](0.0, 1.0, 10.0), True, True),
    (EFFECTS['pixel_anisotropy'](1.5), False, False)])
def test_a_strength_at_a_bound_is_impossible_also_beside_a_shape(effect, shape_seen, possible):
    """A spot that is not seen whole may be there, but none pushes that hard."""
    fit = ModelFit(Model(5e-3).with_effect(effect), ())
    assert _possible(CandidateFit(fit, effect.id, 100.0, 4, 1.0, shape_seen)) == possible


def test_rollers_burn_no_fuel(film):
    rolling, _ = film(31, duration=15.0, rolling=True)
    assert not fit_candidate(fitted(rolling), 'speed_decay')
    assert EFFECTS['speed_decay'].applies(FitEvidence(fitted(film(31, duration=15.0)[0])))


@pytest.mark.parametrize('rest', [0, 900])
@pytest.mark.parametrize(('width', 'seen'), [(19e-6, False), (21e-6, True), (np.nan, False)])
def test_a_spot_that_is_passed_within_four_frames_is_a_step(width, seen, rest):
    """However sure its place and its width are, and however long the particle rests there."""
    row = np.cumsum(np.full((60, 1, 2), [8e-6, 6e-6]), axis=0) - [240e-6, 180e-6]
    row[5] = np.nan
    still = np.random.default_rng(0).normal(0, 1e-7, (rest, 1, 2))
    positions = np.concatenate([row, row[::-1], row, row[::-1][:30], still])
    evidence = SimpleNamespace(
        recordings=[SimpleNamespace(positions=positions)],
        deviations=lambda _: dict.fromkeys(('x', 'y', 'speed', 'width'), 0.0))
    assert EFFECTS['hot_spot'](0.0, 0.0, 1e-6, width).shape_seen(evidence) == seen


@pytest.mark.parametrize(('passes', 'seen'), [(1, False), (2, False), (3, True)])
def test_a_spot_that_was_passed_but_once_or_twice_is_an_event(passes, seen):
    row = np.linspace(-500e-6, 500e-6, 400)[:, None, None] * np.array([1.0, 0.0])
    evidence = SimpleNamespace(
        recordings=[SimpleNamespace(positions=np.concatenate([row, row[::-1], row][:passes]))],
        deviations=lambda _: dict.fromkeys(('x', 'y', 'speed', 'width'), 0.0))
    assert EFFECTS['hot_spot'](0.0, 0.0, 1e-6, 10e-6).shape_seen(evidence) == seen


@pytest.mark.parametrize('broad', [False, True])
@pytest.mark.parametrize('seed', [32, 33])
def test_the_highest_part_of_a_broad_sway_is_no_oscillation(film, seed, broad):
    """A filtered noise that moves all particles alike has its evidence at many frequencies."""
    hidden = {'amplitude_um_s': 1.0, 'frequency_hz': 0.4, 'direction_rad': 0.5, 'phase_rad': 1.0}
    session, _ = film(seed, {} if broad else {'periodic_drift': hidden})
    if broad:
        tracks, rng = session.tracks, np.random.default_rng(seed)
        frequency = rng.uniform(0.05, 1.5, 60)
        turned = np.exp(2j * np.pi * (np.multiply.outer(tracks.t, frequency) + rng.random(60)))
        moved = 0.3e-6 * (turned / (2 * np.pi * frequency)).sum(axis=1)
        moved = np.stack([np.zeros_like(moved.real), moved.real], axis=1)
        session = replace(session, tracks=replace(tracks, position=tracks.position + moved))
    found = fit_candidate(fitted(session), 'periodic_drift')
    assert log_bayes_factor(found) > enough()
    assert found.shape_seen != broad
