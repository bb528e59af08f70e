"""Effects of other packages in the simulated world, which knows them by their hooks alone.

The built-in effects have physics of their own (`dynamics`), which tests the equations that are
fitted. For effects of other packages, the hooks are called before each millisecond and their
results are written where the physics reads them. This runs in Python and is slower.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext, Places
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.io.effect_table import read_effects
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.model import Model
from microbot_ros.model.physics.langevin import step_grid
from microbot_ros.model.timeline import last_change
from microbot_ros.virtual_rig.dynamics import feel
from microbot_ros.virtual_rig.injected_effects import INJECTABLE, check
from microbot_ros.virtual_rig.world import FieldHistory, World

Given = Mapping[str, Mapping[str, float | Sequence[float]]]
"""Effect → parameter → value as people write it."""

_DISTURBED = ('drift_x', 'drift_y', 'speed', 'gain', 'moment')


def check_effect(effect: str, parameters: Mapping[str, float | Sequence[float]]) -> None:
    """Raise ValueError for an unknown `effect` or parameter, a missing or an impossible value.

    Unlike `injected_effects.check` it also knows effects of other packages, with one number for
    each of their `parameters`.

    Parameters
    ----------
    effect : str
        Id of the effect.
    parameters : mapping of str to float or sequence of float
        Values by name.
    """
    if effect in INJECTABLE:
        check(effect, parameters)
        missing = [name for name in INJECTABLE[effect] if name not in parameters]
        if missing and effect != 'drive_response':  # a cut-in or a step-out may be alone
            raise ValueError(f'{effect} expects also: {", ".join(missing)}')
    elif effect in EFFECTS:
        foreign_effects({effect: parameters})
    else:
        known = ', '.join(dict.fromkeys((*INJECTABLE, *EFFECTS)))
        raise ValueError(f"unknown effect '{effect}'; expected one of: {known}")


def foreign_effects(effects: Given) -> tuple[Effect, ...]:
    """Return those `effects` that the physics does not know; ValueError if impossible.

    Parameters
    ----------
    effects : Given
        Parameters by effect.

    Returns
    -------
    tuple of Effect
        The effects.
    """
    return read_effects(
        {name: values for name, values in effects.items() if name not in INJECTABLE})


def make_world(
    bodies: np.ndarray, rng: np.random.Generator, effects: Given, reference_field: float,
    learned: Sequence[LearnedTerm] = (), half_extent: tuple[float, float] = (np.inf, np.inf),
    walls: ArrayLike = (), ids: np.ndarray | None = None,
) -> World:
    """Return a `World` that also feels effects of other packages and learned terms.

    `bodies`, `rng`, `half_extent` and `walls` as in `World`. `effects` that the physics knows are
    in the bodies already (`inject_effect`); the others and terms that were `learned` are added.
    Alignment is stated at `reference_field` [T]. Raises ValueError as `check_effect`.

    Parameters
    ----------
    bodies : ndarray, shape (N,)
        BODY of each particle.
    rng : random.Generator
        Source of random numbers.
    effects : Given
        Parameters by effect.
    reference_field : float
        Field [T] at which alignment is stated.
    learned : sequence of LearnedTerm
        Learned terms.
    half_extent : tuple[float, float]
        Half of the sides of the workspace [m].
    walls : ArrayLike
        Ends of the walls [m].
    ids : ndarray of int, shape (N,), or None
        Ids of the particles, for terms of single particles; None for 0 to N − 1.

    Returns
    -------
    World
        The world.
    """
    foreign = foreign_effects(effects)
    if not (foreign or learned):
        return World(bodies, rng, half_extent, walls)
    model = Model(reference_field, effects=foreign, learned=tuple(learned))
    return ForeignWorld(bodies, rng, half_extent, model, walls, ids)


class ForeignWorld(World):
    """World under the effects of a `model`.

    `bodies`, `rng`, `half_extent` and `walls` as in `World`. Effects of stage 1 act on the
    command, before the amplifier and the coils of the bodies; the others see the field at each
    body. `drift` adds to the flow, `speed_factor` multiplies speed and gain, `heading_offset` adds
    to φ, `alignment_rate` replaces that of the moment; `observe` follows the camera's own.

    Parameters
    ----------
    bodies : ndarray, shape (N,)
        BODY of each particle.
    rng : random.Generator
        Source of random numbers.
    half_extent : tuple[float, float]
        Half of the sides of the workspace [m].
    model : Model
        The model.
    walls : ArrayLike
        Ends of the walls [m].
    ids : ndarray of int, shape (N,), or None
        Ids of the particles; None for 0 to N − 1.
    """

    def __init__(self, bodies: np.ndarray, rng: np.random.Generator,
                 half_extent: tuple[float, float], model: Model, walls: ArrayLike = (),
                 ids: np.ndarray | None = None) -> None:
        super().__init__(bodies, rng, half_extent, walls)
        self._model = model
        self._ids = np.arange(len(bodies)) if ids is None else ids

    def advance(self, until: float, history: FieldHistory) -> np.ndarray:
        if until <= self.t:
            return self.position
        felt = replace(
            history, t=history.t + self._model.delay, field=self._model.field(history.field))
        changed = felt.t[last_change(felt.field, felt.frequency)]
        middle, length = step_grid(self.t, until)
        mean = np.zeros((len(self.bodies), 2))
        for k, t in enumerate(middle):
            undisturbed = {name: self.bodies[name].copy() for name in _DISTURBED}
            offset = self._disturb(self._context(t, length, felt, changed))
            end = until if k == len(middle) - 1 else t + length / 2
            mean += super().advance(end, felt)
            self.bodies['phi'] -= offset
            for name, values in undisturbed.items():
                self.bodies[name] = values
        return mean / len(middle)

    def observe(self, position: np.ndarray) -> np.ndarray:
        return self._model.observe(position)

    def _disturb(self, context: EffectContext) -> np.ndarray | float:
        """Write the hooks' results of a step into the bodies; return what was added to φ [rad]."""
        bodies, model = self.bodies, self._model
        bodies['speed'] *= model.speed_factor(context)
        bodies['gain'] *= model.speed_factor(context)
        drift = model.drift(context)
        if drift is not None:
            bodies['drift_x'] += drift[..., 0]
            bodies['drift_y'] += drift[..., 1]
        rate = model.alignment_rate(context)
        if rate is not None:
            driven = np.where(context.strength > 0, context.strength, 1.0)
            bodies['moment'] = rate * bodies['turn_drag'] / driven
        offset = model.heading_offset(context)
        bodies['phi'] += offset
        return offset

    def _context(self, t: float, length: float, history: FieldHistory,
                 changed: np.ndarray) -> EffectContext:
        """Return what hooks see in a step about `t`; the fields of the rows began at `changed`."""
        rows = history.t.searchsorted(t - self.bodies['delay'], side='right') - 1
        which = np.minimum(np.arange(len(rows)), history.field.shape[1] - 1)
        field = np.zeros((len(rows), 2))
        frequency = np.zeros(len(rows))
        on = rows >= 0
        field[on] = history.field[rows[on], which[on]]
        if history.frequency is not None:
            turns = history.turns
            frequency[on] = turns[rows[on], np.minimum(which[on], turns.shape[1] - 1)]
        since = np.where(on, t - self.bodies['delay'] - changed[rows], 0.0)
        feel(self.bodies, field)
        return EffectContext(
            np.array([t]), np.array([length]), field, frequency, self._model.reference_field,
            Places(self.position, self._ids, self.bodies['phi'].copy()), since)
