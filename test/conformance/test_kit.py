"""The kit refuses effects that break the contract, each by what it breaks."""

from dataclasses import dataclass

import numpy as np
import pytest

from microbot_ros import conformance
from microbot_ros.model.effect import Effect
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class Wind(Effect):
    """dp/dt += s."""

    id = 'wind'
    stage = 'velocity'
    summary = 'It blows.'
    required_excitation = 'any'
    confounded_with = ('uniform_drift',)
    s: float = parameter('s', 'part of 1 µm/s', -5.0, 5.0, 1.0)

    def drift(self, context):
        return np.full((1, 2), self.s * 1e-6)


class Blows(Wind):
    def drift(self, context):
        return np.full((1, 2), (self.s + 1) * 1e-6)


class Breaks(Wind):
    def drift(self, context):
        return np.full((1, 2), self.s * 1e-6 if abs(self.s) < 5 else np.nan)


class Jumps(Wind):
    def drift(self, context):
        return np.full((1, 2), (self.s + 1e-3 * np.sin(5e3 * self.s)) * 1e-6)


class Silent(Wind):
    def drift(self, context):
        return None


class Mixes(Wind):
    def drift(self, context):
        return np.full((1, 2), self.s * 1e-6) * np.mean(context.strength) * 1e3


class Counts(Wind):
    def drift(self, context):
        return self.s * 1e-6 * np.cos(context.t)[..., None] * np.ones(2)


class Looks(Wind):
    def drift(self, context):
        return self.s * 0.01 * context.position


class Herds(Wind):
    needs_position = True

    def drift(self, context):
        return self.s * 0.01 * context.position.mean(axis=-2, keepdims=True)


class NeedsNothing(Wind):
    needs_position = True


class Bends(Wind):
    proportional = True

    def drift(self, context):
        return np.full((1, 2), np.sin(self.s) * 1e-6)


class Mumbles(Wind):
    summary = 'It blows'


@pytest.mark.parametrize(('kind', 'complaint'), [
    (Blows, 'moves particles at zero strength'),
    (Breaks, 'is not finite at s = -5'),
    (Jumps, 'its derivative depends on the step'),
    (Silent, 's changes nothing'),
    (Mixes, 'drift mixes times'),
    (Counts, "'time_invariant' is True; 50 s later it does something else"),
    (Looks, "'needs_position' must be True"),
    (Herds, 'a particle that is missing moves the others'),
    (NeedsNothing, 'no hook reads positions'),
    (Bends, "'proportional' must be False"),
    (Mumbles, "'summary' must be a sentence"),
])
def test_what_is_wrong_is_said(monkeypatch, kind, complaint):
    monkeypatch.setattr(conformance, 'EFFECTS', {'wind': kind})
    monkeypatch.setattr(kind, '__doc__', Wind.__doc__)
    with pytest.raises(AssertionError, match=complaint):
        conformance.exercise(kind)


def test_it_has_to_be_installed():
    with pytest.raises(AssertionError, match='wind is not installed: name it in the entry points'):
        conformance.exercise(Wind)


def test_an_effect_that_does_not_show_is_not_found():
    with pytest.raises(AssertionError, match='uniform_drift is hidden; established are: none'):
        conformance.exercise_discovery(EFFECTS['uniform_drift'](1e-9, 0.0))
