"""An effect is offered only where the commands excite it and within the bounds of physics."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from microbot_ros.discovery.evidence import FitEvidence
from microbot_ros.discovery.input_checks import check_sessions
from microbot_ros.discovery.search import fit_candidate
from microbot_ros.estimation.model_fit import fit_sessions
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model


def fitted(session):
    """The first-order model on a `session`."""
    prepared, _ = check_sessions([session])
    return fit_sessions(Model.baseline(session.conditions, session.commands), prepared)


def test_pixels_are_no_candidate_under_commands_along_one_line(film):
    """There v absorbs them, and how much the speed fluctuates would stand in for their shape."""
    session, _ = film(30, duration=15.0)
    line = 5e-3 * np.sign(session.commands.field[:, 1:]) * np.array([[0.0, 1.0]])
    assert fit_candidate(fitted(session), 'pixel_anisotropy')
    alone = replace(session, commands=replace(session.commands, field=line))
    assert not fit_candidate(fitted(alone), 'pixel_anisotropy')


@pytest.mark.parametrize(('aspect', 'seen'), [
    (0.5, False), (0.51, True), (1.99, True), (2.0, False), (np.nan, False)])
def test_pixels_beyond_those_of_any_camera_are_not_seen(aspect, seen):
    assert EFFECTS['pixel_anisotropy'](aspect).shape_seen(SimpleNamespace()) == seen


def test_rollers_burn_no_fuel(film):
    rolling, _ = film(31, duration=15.0, rolling=True)
    assert not fit_candidate(fitted(rolling), 'speed_decay')
    assert EFFECTS['speed_decay'].applies(FitEvidence(fitted(film(31, duration=15.0)[0])))


@pytest.mark.parametrize(('width', 'seen'), [(19e-6, False), (21e-6, True), (np.nan, False)])
def test_a_spot_that_is_passed_within_four_frames_is_a_step(width, seen):
    """However sure its place and its width are."""
    positions = np.cumsum(np.full((60, 1, 2), [8e-6, 6e-6]), axis=0)
    positions[30] = np.nan
    evidence = SimpleNamespace(
        recordings=[SimpleNamespace(positions=positions)],
        deviations=lambda _: dict.fromkeys(('x', 'y', 'speed', 'width'), 0.0))
    assert EFFECTS['hot_spot'](0.0, 0.0, 1e-6, width).shape_seen(evidence) == seen
