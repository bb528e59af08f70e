"""What an effect may ask about a fit, on fits whose answers are known beforehand."""

from types import SimpleNamespace

import numpy as np
import pytest

from microbot_ros.discovery.evidence import NEGLIGIBLE, FitEvidence, _strength_unknown
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.estimation.likelihood.prepared_session import prepare
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.effects.velocity.periodic_drift import PeriodicDrift
from microbot_ros.session.tables.folder import NOMINAL_FIELD


@pytest.fixture(name='two')
def two_fixture(film):
    """Of 12 and of 20 s, in this order."""
    return FitEvidence(fit_first_order(
        [prepare(film(30, duration=seconds)[0]) for seconds in (12.0, 20.0)]))


def test_the_longest_recording_counts(two):
    assert two.duration == pytest.approx(20.0, abs=0.1)
    assert two.propulsion == 'catalytic'


@pytest.mark.parametrize(('prices', 'chosen'), [
    ({}, 'abc'), ({'a': 42.0}, 'bac'), ({'b': 49.0}, 'acd'), ({'b': 30, 'c': 30, 'd': 30}, 'a'),
    ({'a': 91.0, 'b': 52.0, 'c': 90.0, 'd': 90.0}, 'a'),
    (dict.fromkeys('abcde', 200.0), 'a')])
def test_starts_are_worth_trying_by_what_they_explain_less_their_price(
        monkeypatch, prices, chosen):
    """The best always, the next two where they explain half as much and more than nothing."""
    scores = {'a': 100.0, 'b': 60.0, 'c': 54.0, 'd': 53.0, 'e': NEGLIGIBLE}
    monkeypatch.setattr(FitEvidence, '_with_best_strength', lambda _, start: (
        scores[start], start))
    found = FitEvidence(None).promising('edcba', lambda start: prices.get(start, 0.0))
    assert ''.join(found) == chosen


@pytest.mark.parametrize(('gain', 'starts'), [(30.0, [1e-3, 2.0]), (-19.0, [1e-3, 2.0]),
                                              (-21.0, [1e-3])])
def test_a_larger_start_is_tried_unless_it_is_much_worse(gain, starts):
    """Of a delay, which has one parameter and no negative values."""
    unit = CommandDelay.parameters()[0].from_fit(1.0)
    costs = {round(size * unit, 12): 1e3 for size in (0.3, 10.0)} | {
        round(2.0 * unit, 12): 100.0 - gain}
    fit = SimpleNamespace(
        cost=100.0, model=SimpleNamespace(with_effect=lambda effect: effect),
        under=lambda effect: SimpleNamespace(cost=costs[round(effect.delay, 12)]))
    found = FitEvidence(fit).near_nothing(CommandDelay)
    assert [one.delay / unit for one in found] == pytest.approx(starts)


def test_an_effect_of_several_parameters_has_one_start_near_nothing(two):
    assert len(two.near_nothing(PeriodicDrift)) == 1


@pytest.mark.parametrize(('frequency', 'reference', 'field', 'unknown'), [
    (None, None, NOMINAL_FIELD, False), (5.0, NOMINAL_FIELD, NOMINAL_FIELD, False),
    (5.0, None, NOMINAL_FIELD, True), (5.0, None, 2 * NOMINAL_FIELD, False)])
def test_only_a_rolling_field_may_be_of_unknown_strength(frequency, reference, field, unknown):
    """Where it is off tells nothing."""
    session = SimpleNamespace(
        commands=SimpleNamespace(frequency=frequency, field=np.array([[0.0, 0.0], [0.0, field]])),
        conditions=SimpleNamespace(reference_field=reference))
    assert _strength_unknown(session) == unknown
