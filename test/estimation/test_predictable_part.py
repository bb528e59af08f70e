"""What a model without chance in its headings is asked to explain."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.estimation.likelihood.prepared_session import (
    FORGOTTEN,
    predictable_part,
    prepare,
)
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.model import Model

FIELD, LAG, STEP = 5e-3, 0.2, 0.05


def _prepared(levels, holds, seconds=60.0, step=STEP):
    """A particle that drifts along, hardly turned by heat; every level [T] is held so long [s]."""
    t = np.arange(0.0, seconds, step)
    position = np.column_stack([2e-6 * t, 0.3e-6 * t])
    tracks = Tracks(t, np.zeros(len(t), int), position, np.full(len(t), np.nan),
                    np.full(len(t), np.nan))
    levels = np.asarray(levels, float)
    begin = np.concatenate([[0.0], np.cumsum(holds)[:-1]])
    commands = Commands(begin, np.column_stack([levels, np.zeros(len(levels))]))
    conditions = Conditions(radius=2.3e-6, viscosity=1.0, reference_field=FIELD)
    return prepare(Session(tracks, commands, conditions, 'made'))


@settings(max_examples=40)  # the first compiles
@given(st.lists(st.tuples(st.sampled_from([0.0, 0.2, 0.5, 1.0]), st.floats(0.3, 3.0)),
                min_size=1, max_size=6))
def test_what_comes_before_the_field_has_aligned_headings_is_left_out(rows):
    """A weak field takes longer: tan(χ/2) of a heading χ off the field decays as
    exp(−∫B dt/(B_ref τ))."""
    levels, holds = zip(*rows, (1.0, 60.0), strict=True)
    session = _prepared(FIELD * np.array(levels), holds)
    kept = predictable_part(session, Model(FIELD, effects=(AlignmentLag(tau=LAG),)))
    began = float(kept.times[kept.seen.any(axis=1)][0])
    t = np.arange(0.0, 60.0, 1e-3)
    decay = np.cumsum(session.commands.field_at(t)[:, 0]) * 1e-3 / (FIELD * LAG)
    assert began == pytest.approx(t[np.argmax(decay >= FORGOTTEN)], abs=1.1 * STEP)


def test_a_field_that_never_aligns_them_leaves_half():
    session = _prepared([1e-3 * FIELD], [60.0])
    kept = predictable_part(session, Model(FIELD, effects=(AlignmentLag(tau=LAG),)))
    assert kept.times[0] == pytest.approx(30.0, abs=1.1 * STEP)


def test_headings_that_align_at_once_leave_everything():
    session = _prepared([0.2 * FIELD, FIELD], [1.0, 60.0])
    kept = predictable_part(session, Model(FIELD))
    assert np.array_equal(kept.times, session.times)


@pytest.mark.parametrize('step', [1 / 30, 0.033])
@pytest.mark.parametrize('dark', [0.1, 0.3, 1.1, 4.9 / 3])
def test_times_that_no_binary_fraction_holds_lose_no_frame(step, dark):
    """(time − first field) + first field may round above the time."""
    session = _prepared([0.0, FIELD], [dark, 60.0], 20.0, step)
    for tau in np.linspace(0.05, 0.8, 40):
        model = Model(FIELD, effects=(AlignmentLag(tau=tau),))
        kept = predictable_part(session, model)
        assert kept.seen[0].all()
        np.testing.assert_array_equal(kept.times, session.times[-len(kept.times):])
