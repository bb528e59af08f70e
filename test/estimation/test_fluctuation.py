"""Speeds that fluctuate and rollers that swing are noise of their own, not an effect."""

from dataclasses import replace

import numpy as np
import pytest

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.hypotheses import consider, fit_first_order
from microbot_ros.discovery.verdict import judge
from microbot_ros.estimation.likelihood.fluctuation import fit_fluctuation
from microbot_ros.estimation.likelihood.model_fit import unsteady

RATE, SECONDS = 25.0, 80.0


def rolled(seed, strength, swing, correlation=0.5, diffusion=0.3e-12, reading=0.1e-6,
           late=0.0):
    """Return a session of one roller at 11.3 Hz whose direction turns in steps.

    Its speed has an Ornstein–Uhlenbeck deviation of `strength` with that `correlation` time [s],
    and it swings by `swing` [m] (RMS) along its way at each frame. Commands act earlier or later
    by `late` [s] (standard deviation).
    """
    rng = np.random.default_rng(seed)
    t = np.arange(int(SECONDS * RATE)) / RATE
    begins = np.arange(0.0, SECONDS, 2.0)
    turned = rng.uniform(-np.pi, np.pi, len(begins))
    acts = begins + late * np.append(0, np.random.default_rng(seed).normal(size=len(begins) - 1))
    within = t[:, None] + (np.arange(100) + 0.5) / 100 / RATE
    direction = np.exp(1j * turned[np.searchsorted(acts, within, 'right') - 1]).mean(axis=1)
    kept = np.exp(-1 / (RATE * correlation))
    deviation = np.empty(len(t))
    deviation[0] = rng.normal()
    for k in range(1, len(t)):
        deviation[k] = kept * deviation[k - 1] + np.sqrt(1 - kept**2) * rng.normal()
    noise = rng.normal(size=(3, len(t), 2)) @ [1, 1j]
    steps = 40e-6 * (1 + strength * deviation) * direction / RATE + (
        np.sqrt(2 * diffusion / RATE) * noise[0])
    z = np.append(0, np.cumsum(steps)[:-1]) + reading * noise[1]
    z += swing * np.sqrt(2) * np.cos(2 * np.pi * 11.3 * t + 0.3) * np.append(
        direction[:1], direction[:-1])
    field = 1e-3 * np.stack([np.cos(turned), np.sin(turned)], axis=1)
    unknown = np.full(len(t), np.nan)
    return Session(
        Tracks(t, np.zeros(len(t), int), np.stack([z.real, z.imag], axis=1), unknown, unknown),
        Commands(begins, field, np.full(len(begins), 11.3)), Conditions('rolling'), 'rolled')


@pytest.fixture(scope='module')
def restless():
    return check_sessions([rolled(1, 0.25, 1e-6)])[0]


def test_strength_time_and_swing_are_found(restless):
    known = fit_first_order(restless)
    found = fit_fluctuation(known.session_fits[0], known.model)
    assert found.fluctuation == pytest.approx(0.25, rel=0.2)
    assert found.whitening.fluctuation == pytest.approx(0.5, rel=0.5)
    assert found.swing == pytest.approx(1e-6, rel=0.2)
    assert found.diffusion < 0.1 * known.session_fits[0].diffusion


@pytest.mark.soak
def test_a_restless_roller_misses_nothing(restless):
    known = consider(restless)
    assert all(p.session.speeds_fluctuate for p in known.fit.session_fits)
    assert known.names == ()
    assert judge(known).verdict == 'consistent'


def test_a_steady_roller_has_the_plain_noise():
    steady = check_sessions([rolled(2, 0.0, 0.0)])[0]
    known = fit_first_order(steady)
    assert unsteady(steady, known, known) is None
    assert known.session_fits[0].fluctuation == known.session_fits[0].swing == 0


def test_few_rows_that_stand_out_are_cut(restless):
    session = restless[0]
    rows = np.zeros_like(session.seen)
    rows[[300, 900]] = True
    assert session.cut_at(rows).jumps.sum() == session.jumps.sum() + 2
    rows[::5] = True
    assert replace(session).cut_at(rows) is session or (
        session.cut_at(rows).pieces == session.pieces).all()


def test_commands_that_act_early_or_late_are_found():
    session = check_sessions([rolled(3, 0.1, 0.5e-6, late=0.03)])[0]
    known = fit_first_order(session)
    restless, evidence = unsteady(session, known, known)
    assert restless[0].speeds_fluctuate
    assert evidence > 0
    found = fit_first_order(restless).session_fits[0]
    assert found.jitter == pytest.approx(0.03, rel=0.35)
    assert found.fluctuation == pytest.approx(0.1, rel=0.4)
    assert found.swing == pytest.approx(0.5e-6, rel=0.3)
