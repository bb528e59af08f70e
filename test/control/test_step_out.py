"""A single turn of the field: who follows it, and what sums of such turns can do."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from microbot_ros.control.contract import NoSolutionError
from microbot_ros.control.planning.step_out import STEP, THRESHOLD, SingleTurns

TICK = 1 / 60


def kinds():
    return SingleTurns(4.5, 40.0, TICK, 2)


def seen(gain, step_out):
    """Kinds that have been surveyed by rollers which do as the theory says."""
    made = kinds()
    edge = made.frequency / made.share * THRESHOLD
    follows = step_out[:, None] > edge
    moved = [gain * follows[:, leg.kind] * leg.way for leg in made.survey()]
    made.see(np.array(moved))
    return made


def drawn(seed=0, count=6):
    rng = np.random.default_rng(seed)
    gain = rng.uniform(2e-6, 4e-6, count) * np.exp(1j * rng.uniform(-0.5, 0.5, count))
    return rng, gain, np.geomspace(6, 36, count)


def test_the_threshold_is_where_a_turn_leaves_half_a_turn_of_lag():
    exact = brentq(lambda r: (math.pi + 2 * math.asin(r)) / math.sqrt(1 - r**2) - math.tau, 0, 0.9)
    assert pytest.approx(exact, abs=1e-5) == THRESHOLD


@pytest.mark.parametrize(('ratio', 'turns'), [(0.9, 1), (1.02, 1), (0.98, 0), (0.3, 0)])
def test_a_roller_goes_one_turn_or_none_by_the_adler_equation(ratio, turns):
    f, step_out = 10.0, 10.0 * THRESHOLD * ratio if ratio != 0.9 else 9.0

    def lag_rate(t, lag):
        return math.tau * ((f if t < 1 / f else 0.0) - step_out * np.sin(lag))

    lag = solve_ivp(lag_rate, (0, 1.0), [0.0], max_step=1e-3, rtol=1e-8).y[0, -1]
    assert 1 - lag / math.tau == pytest.approx(turns, abs=1e-3)


def test_kinds_turn_whole_turns_in_whole_ticks_and_ask_for_no_more_than_the_field():
    made = kinds()
    assert made.frequency * made.ticks * TICK == pytest.approx(1)
    assert (made.share <= 1 + 1e-9).all()
    assert made.frequency.max() <= 40
    edge = made.frequency / made.share * THRESHOLD
    assert edge[1:] / edge[:-1] == pytest.approx(STEP)
    assert edge[0] == pytest.approx(4.5)


def test_turns_displace_each_as_asked():
    rng, gain, step_out = drawn()
    made = seen(gain, step_out)
    wanted = 1e-5 * (rng.normal(size=6) + 1j * rng.normal(size=6))
    assert made.answer @ made.turns(wanted) == pytest.approx(wanted, abs=1e-7)
    # Whole turns add up to it but for what is not worth one, and nobody strays from his way.
    legs = made.legs(wanted)
    moves = made.moves(legs)
    left_out = 0.15 * np.abs(made.answer[:, np.abs(made.turns(wanted)) > 0.01]).sum(1)
    assert (np.abs(moves.sum(1) - wanted) < left_out).all()
    assert np.abs([leg.way for leg in legs]) == pytest.approx(1)
    part = np.arange(1, len(legs) + 1) / len(legs)
    assert np.abs(np.cumsum(moves, 1) - wanted[:, None] * part).max() < 12e-6


def test_the_order_of_turns_spares_room_that_lacks():
    rng, gain, step_out = drawn()
    made = seen(gain, step_out)
    wanted = 1e-5 * (rng.normal(size=6) + 1j * rng.normal(size=6))

    def slack(moved):
        return 1e-6 - moved[2].imag  # the third must not go up

    def highest(legs):
        return made.moves(legs)[2].cumsum().imag.max()

    wanted[2] = 0
    plain, sparing = made.legs(wanted), made.legs(wanted, slack)
    assert highest(sparing) < 1.2e-6 < highest(plain)
    assert made.moves(sparing).sum(1) == pytest.approx(made.moves(plain).sum(1))


def test_the_time_is_the_least_of_a_linear_programme_that_goes_one_way():
    """Along one line the least time is a linear programme, which scipy solves."""
    from scipy.optimize import linprog
    rng, gain, step_out = drawn(3)
    made = seen(np.abs(gain) + 0j, step_out)
    wanted = 1e-5 * rng.normal(size=6)
    answer = made.answer.real
    best = linprog(np.tile(made.seconds, 2), A_eq=np.hstack([answer, -answer]) * 1e6,
                   b_eq=wanted * 1e6).fun
    assert best <= made.time(wanted + 0j) * (1 + 1e-3)
    assert made.time(wanted + 0j) < 1.1 * best


def test_what_is_seen_corrects_what_was_thought():
    _, gain, step_out = drawn()
    made = seen(gain, step_out)
    leg = made.survey()[0]
    for _ in range(30):
        made.learn(leg, 0.5 * gain * leg.way)
    assert made.answer[:, leg.kind] == pytest.approx(0.5 * gain, rel=1e-3)


def test_rollers_that_are_alike_and_beads_are_refused_by_number():
    _, gain, step_out = drawn()
    with pytest.raises(NoSolutionError, match='number 2 and 3'):
        seen(gain, np.where(np.arange(6) == 3, step_out[2], step_out))
    with pytest.raises(NoSolutionError, match=r'number 4 has no rolling speed'):
        seen(np.where(np.arange(6) == 4, 0, gain), step_out)
