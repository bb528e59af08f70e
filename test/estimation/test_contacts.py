"""What no model knows, where spheres touch, decides nothing about those who don't."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench._asks_worlds import hidden_world
from microbot_ros.discovery.driven.design import random_steps
from microbot_ros.discovery.driven.joined import join
from microbot_ros.estimation.likelihood import prepared_session
from microbot_ros.estimation.likelihood.model_fit import fit_sessions
from microbot_ros.estimation.likelihood.prepared_session import nearest, prepare
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model


def dipoles(seed):
    """What was seen of spheres that meet and part, prepared, and their true strength."""
    rig, hidden = hidden_world(seed, ('dipole_interaction',))
    rng = np.random.default_rng(seed)
    played = [rig.play(random_steps(rng, 30.0, rig.limits)).session for _ in range(3)]
    return prepare(join(played)), hidden['dipole_interaction']['strength_um5_s'] * 1e-30


@pytest.mark.parametrize('seed', [2, 6, 9])
def test_dipoles_that_meet_and_part_are_measured(seed):
    """Within 15 %: between frames they come so near that the pull is no constant.

    Where they were believed to go on through a contact as the model has it, they were flung
    past all others, and no dipole was seen.
    """
    session, true = dipoles(seed)
    base = Model.baseline(session.conditions, session.commands)
    usual = EFFECTS['dipole_interaction'](strength=1e-26)
    found = fit_sessions(base.with_effect(usual), [session])
    assert found.model.effects[0].strength == pytest.approx(true, rel=0.15)
    assert found.log_likelihood - fit_sessions(base, [session]).log_likelihood > 100


def test_outside_a_piece_nobody_is_where_a_model_has_them():
    session, _ = dipoles(2)
    kept = np.isfinite(session.causal_positions[..., 0]) & ~session.seen
    assert kept.sum() > 500
    flung = np.cumsum(np.where(session.seen, 0.0, 1e-3), axis=0) + 0j
    filtered = session.with_filtered_positions(flung, 0.1).causal_positions
    np.testing.assert_array_equal(filtered[kept], session.causal_positions[kept])


def test_within_a_piece_one_who_is_missed_is_where_a_model_has_them():
    session, _ = dipoles(2)
    row, n = np.argwhere(session.joined(2) & session.joined()[1:])[100] + (1, 0)
    missed = np.zeros_like(session.seen)
    missed[row, n] = True
    hidden = replace(
        session, pieces=np.where(missed, 0, session.pieces), causal_positions=np.where(
            missed[..., None], np.nan, session.causal_positions))
    filtered = hidden.with_filtered_positions(np.zeros(missed.shape, complex), 0.1)
    assert np.hypot(*(filtered.causal_positions - session.causal_positions)[row, n]) < 2e-6


def test_nearest_is_of_the_frame_however_few_frames_are_held_at_once(monkeypatch):
    rng = np.random.default_rng(0)
    z = rng.normal(size=(50, 6)) + 1j * rng.normal(size=(50, 6))
    z[rng.random(z.shape) < 0.5] = np.nan
    z[:3], z[3, 1:] = np.nan, np.inf
    expected = np.full(z.shape, np.inf)
    for t, n in np.argwhere(np.isfinite(z)):
        others = np.delete(z[t], n)
        expected[t, n] = np.abs(others[np.isfinite(others)] - z[t, n]).min(initial=np.inf)
    for pairs in (1, 100, 2**22):
        monkeypatch.setattr(prepared_session, 'PAIRS', pairs)
        np.testing.assert_array_equal(nearest(z), expected)
    assert nearest(z[:, :0]).shape == (50, 0)
