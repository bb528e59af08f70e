"""The e-detector: silent on white innovations for hours, quick when they lean on something."""

from types import SimpleNamespace

import numpy as np
import pytest

from microbot_ros.estimation.online.monitor import BOUND, DETECTORS, TICK, Monitor

RATE = 20.0
IDS = np.arange(3)


def watch(seconds, lean=None, seed=0):
    """Run innovations of three particles through a monitor; (seconds, sentence) of each alarm.

    `lean` makes innovations that are not white of the moment's quantities.
    """
    rng = np.random.default_rng(seed)
    monitor, alarms = Monitor(), []
    place = 8e-5 * np.array([1 + 1j, -1 + 0.5j, 0.5 - 1j])
    heading, swims, before = np.ones(1, complex), np.exp(1j * rng.uniform(-3, 3, 3)), np.zeros(3)
    for k in range(int(seconds * RATE)):
        if k % 40 == 0:
            heading = np.exp(1j * rng.uniform(-np.pi, np.pi, 1))
        place = place + 4e-6 / RATE * swims * heading
        place = np.clip(place.real, -1e-4, 1e-4) + 1j * np.clip(place.imag, -1e-4, 1e-4)
        z = rng.normal(size=(3, 2)) @ [1, 1j]
        if lean:
            z = lean(SimpleNamespace(
                k=k, z=z, place=place, heading=heading, swims=swims * heading, before=before))
        monitor.add(k / RATE, IDS, z, place, heading, swims * heading)
        before = z
        if monitor.sentences:
            alarms.append((k / RATE, monitor.sentences))
            if len(alarms) > 1:
                break
    return alarms


def test_white_innovations_raise_no_alarm():
    assert watch(400) == []


def test_the_stakes_grow_by_no_more_than_what_is_laid():
    """The guarantee itself: the mean of all stakes after n ticks is at most n."""
    totals = []
    rng = np.random.default_rng(1)
    for _ in range(25):
        monitor = Monitor()
        for k in range(400):
            z = rng.normal(size=(3, 2)) @ [1, 1j]
            heading = np.exp(1j * np.array([k // 40]))
            monitor.add(k / RATE, IDS, z, np.zeros(3, complex), heading, heading * np.ones(3))
        totals.append(monitor._leans.sum() + monitor._spreads.sum())
    ticks = 400 / RATE / TICK
    assert np.mean(totals) < 1.5 * ticks
    assert ticks / BOUND < 1e-3


LEANS = {
    'drift': lambda now: now.z + 0.5,
    'place': lambda now: now.z + 0.8 * now.place.imag / 1e-4,
    'command': lambda now: now.z + 0.6 * now.swims * now.heading.real,
    'turn': lambda now: now.z - 2 * now.swims * (now.k % 40 < 6),
    'size': lambda now: 1.8 * now.z,
    'memory': lambda now: now.z + 0.6 * now.before,
}


@pytest.mark.parametrize('name', LEANS)
def test_every_lean_is_met_within_seconds_by_name(name):
    alarms = watch(30, LEANS[name])
    assert alarms
    at, said = alarms[0]
    assert at < 15
    assert DETECTORS[name].sentence in said[0]


def test_every_sentence_names_the_command_to_run_next():
    for suspicion in DETECTORS.values():
        assert 'microbot ' in suspicion.sentence


def test_a_change_late_in_the_day_is_met_as_quickly():
    lean = LEANS['drift']
    alarms = watch(110, lambda now: lean(now) if now.k > 90 * RATE else now.z)
    assert 90 < alarms[0][0] < 98


def test_alarms_fade_when_the_cause_is_gone():
    monitor = Monitor()
    rng = np.random.default_rng(0)
    heading = np.ones(1, complex)
    for k in range(int(60 * RATE)):
        z = rng.normal(size=(3, 2)) @ [1, 1j] + (1.0 if k < 5 * RATE else 0.0)
        monitor.add(k / RATE, IDS, z, np.zeros(3, complex), heading, np.zeros(3, complex))
        if k == 5 * RATE:
            assert monitor.sentences
    assert not monitor.sentences
