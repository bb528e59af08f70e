"""Clocks that disagree by less than a frame are the instrument's; more than that is not."""

from dataclasses import replace

import numpy as np
import pytest

from microbot_ros.common.records import Commands
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.check.score_tests import residual_maps
from microbot_ros.discovery.check.time_shift import time_shifts
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.estimation.likelihood.model_fit import evaluate
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model

FRAME = 0.05
"""Frame interval [s] of the films."""


def told_late(session, by):
    """The session with the commands stamped so much later [s] than they act."""
    told = session.commands
    return replace(session, commands=replace(told, t=told.t + by))


def fitted(*sessions):
    prepared, _ = check_sessions(list(sessions))
    return fit_first_order(prepared)


@pytest.fixture(scope='module')
def filmed(film):
    return film(31, duration=60.0)[0]


@pytest.mark.parametrize('by', [0.0, 8e-3, 0.02, -0.02])
def test_a_shift_is_found_within_its_error(filmed, by):
    found, = time_shifts(fitted(told_late(filmed, by)))
    assert found.interval == pytest.approx(FRAME)
    assert abs(found.shift + by) < max(4 * found.std, 0.2 * abs(by))
    assert found.std < 2e-3
    assert found.is_noted == bool(by)


def test_what_is_less_than_a_frame_fires_no_map_and_is_told(filmed):
    late = told_late(filmed, 0.02)
    assert not any(m.fires for m in residual_maps(fitted(late)))
    found = discover([late])
    assert (found.verdict, found.effects, found.unexplained) == ('consistent', (), ())
    remark, = (one for one in found.remarks if 'earlier than their times' in one)
    assert remark.startswith('film-31: commands act ')
    assert 'less than a frame (50 ms)' in remark


def test_what_is_more_than_a_frame_fires(filmed):
    fit = fitted(told_late(filmed, 3 * FRAME))
    found, = time_shifts(fit)
    assert not found.is_of_clock
    assert not found.is_noted
    assert any(m.against == 'time since switch' and m.decides for m in residual_maps(fit))


def test_each_session_has_its_own_clock(film):
    shifts = time_shifts(fitted(told_late(film(32)[0], 0.02), told_late(film(33)[0], -0.02)))
    assert [one.shift < 0 for one in shifts] == [True, False]
    assert all(one.is_noted for one in shifts)


def test_a_delay_in_the_model_leaves_nothing_to_shift(filmed):
    fit = fitted(filmed)
    delayed = fit.under(fit.model.with_effect(EFFECTS['command_delay'](0.02)))
    assert time_shifts(delayed) == [None]


@pytest.mark.parametrize('field', [[5e-3, 0.0], [0.0, 0.0]])
def test_commands_that_never_change_show_no_shift(filmed, field):
    """φ absorbs it, or nothing moves at all."""
    known = fitted(filmed).session_fits[0]
    still = replace(known.session, commands=Commands(np.array([-1.0]), np.array([field])))
    assert time_shifts(evaluate(Model(5e-3), [still], [known.whitening])) == [None]
