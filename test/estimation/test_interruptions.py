"""Stretches in which particles do not move as commanded are found and left out."""

import numpy as np
import pytest

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.estimation.likelihood.interruptions import RARE, interrupted

RATE, SECONDS, SPEED, DIFFUSION = 25.0, 40.0, 6e-6, 0.1e-12


def swum(seed, moves=lambda *_: 1.0, lost=()):
    """Return a session of three swimmers whose velocity is `moves(t, n)` times the usual one.

    The rows of the command log with a number in `lost` are missing.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(int(SECONDS * RATE)) / RATE
    began = np.arange(0.0, SECONDS, 2.5)
    turned = rng.uniform(-np.pi, np.pi, len(began))
    way = np.exp(1j * turned[np.searchsorted(began, t, 'right') - 1])
    noise = rng.normal(size=(2, len(t), 3, 2)) @ [1, 1j]
    rows = []
    for n in range(3):
        factor = np.array([moves(one, n) for one in t])
        steps = SPEED * way * factor / RATE + np.sqrt(2 * DIFFUSION / RATE) * noise[0, :, n]
        z = 30e-6 * n + np.append(0, np.cumsum(steps)[:-1]) + 0.05e-6 * noise[1, :, n]
        rows.append(np.stack([z.real, z.imag], axis=1))
    kept = np.setdiff1d(np.arange(len(began)), lost)
    field = 1e-3 * np.stack([np.cos(turned), np.sin(turned)], axis=1)
    unknown = np.full(3 * len(t), np.nan)
    return Session(
        Tracks(np.tile(t, 3), np.repeat(np.arange(3), len(t)), np.concatenate(rows), unknown,
               unknown),
        Commands(began[kept], field[kept]), Conditions(), 'swum')


def searched(session):
    """Return the prepared session and what `interrupted` finds in its first-order fit."""
    sessions = check_sessions([session])[0]
    return sessions[0], interrupted(sessions, fit_first_order(sessions))


@pytest.mark.parametrize('seed', range(3))
def test_an_undisturbed_session_has_no_interruption(seed):
    assert searched(swum(seed))[1] is None


def test_a_particle_that_sticks_is_left_out_for_that_time():
    whole, (rest, evidence) = searched(
        swum(1, lambda t, n: 0.0 if n == 1 and 10 < t < 12 else 1.0))
    assert evidence > 10
    (found,) = rest[0].interruptions
    assert found.particle == 1
    assert (found.begin, found.end) == pytest.approx((10, 12), abs=0.4)
    out = whole.seen & ~rest[0].seen
    assert not out[:, [0, 2]].any()
    assert 0.7 < out[:, 1].sum() / (2 * RATE) < 1.3


def test_commands_that_are_missing_in_the_log_interrupt_all_particles():
    whole, (rest, _) = searched(swum(2, lost=(6,)))
    assert {one.particle for one in rest[0].interruptions} == {None}
    assert min(one.begin for one in rest[0].interruptions) == pytest.approx(15.0, abs=0.3)
    assert max(one.end for one in rest[0].interruptions) == pytest.approx(17.5, abs=0.3)
    assert (rest[0].seen.all(axis=1) | ~rest[0].seen.any(axis=1)).all()
    assert whole.seen.all()


def test_what_happens_for_much_of_the_time_is_no_interruption():
    part = 1.5 * RARE
    assert searched(swum(3, lambda t, _: 0.0 if t % 10 < 10 * part else 1.0))[1] is None


def test_a_gap_in_the_log_of_commands_is_a_remark_and_nothing_is_missing():
    found = discover([swum(2, lost=(6,))])
    assert found.verdict == 'consistent'
    assert any('all particles from 15.' in remark and 'left out' in remark
               for remark in found.remarks)
