"""Frames and commands on one time axis, cut where either changes, prepared once for many fits."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.model.effect_context import EffectContext, Places
from microbot_ros.model.model import Model

Key = TypeVar('Key')
Value = TypeVar('Value')

LONGEST = 0.1
"""Spans of models that change in time, or with position, are at most this long [s]."""

PARTS = 8
"""Parts of models that are remembered: more than a model of a few effects has."""


@dataclass(frozen=True)
class Segments:
    """Spans during which the command stays, S of them, the last at the last frame.

    The first `lead` of them lie before the first frame: the history that the heading remembers.
    `frames` (T,) is where the frames lie among the edges of the spans after these.
    """

    t: np.ndarray
    """Middles (S, 1) [s]."""
    span: np.ndarray
    """Lengths (S, 1) [s]."""
    field: np.ndarray
    """Commanded field (S, 1, 2) [T], zero before the first command."""
    frequency: np.ndarray
    """Commanded rotation (S, 1) [Hz]."""
    since: np.ndarray | None
    """Time (S, 1) [s] since the command last became another, zero before the first.

    None where spans are whole: there nothing depends on it.
    """
    lead: int
    frames: np.ndarray

    @property
    def first(self) -> np.ndarray:
        """The span after the lead with which each frame interval begins (T−1,)."""
        return self.frames[:-1]

    def sum(self, spans: np.ndarray) -> np.ndarray:
        """Sum (S − lead, ...) over the spans of every frame interval: (T−1, ...)."""
        if len(spans) == len(self.first):
            return spans
        return np.add.reduceat(spans, self.first, axis=0)

    @property
    def interval(self) -> np.ndarray:
        """The frame interval (S − lead,) that each span after the lead belongs to."""
        return np.repeat(np.arange(len(self.first)), np.diff(self.frames))

    def context(self, model: Model) -> EffectContext:
        """The context in every span, the lead included, with the field after stage 1."""
        field = model.field(self.field)
        return EffectContext(self.t, self.span, field, self.frequency, model.reference_field,
                             since=self.since)


class Timeline:
    """The commands and the frames of one recording, ready to evaluate models on.

    `times` (T,) [s], ascending, T ≥ 2; `positions` (T, N, 2) [m] as the camera reports them, NaN
    for gaps: where terms that depend on position are evaluated, each over the interval that
    begins with it. For fits give filtered positions of earlier frames: raw ones bias such terms.
    `ids` and `phi` (N,) [rad] of the particles, for terms that differ between them.
    """

    def __init__(self, commands: Commands, times: np.ndarray,
                 positions: np.ndarray | None = None, ids: np.ndarray | None = None,
                 phi: np.ndarray | None = None) -> None:
        times = np.asarray(times, dtype=float)
        if len(times) < 2 or not (times[1:] > times[:-1]).all():
            raise ValueError('times must be at least two, ascending')
        self.commands = commands
        self.times = times
        self.positions = positions
        self._who = ids, phi
        self._segments: dict[tuple[float, bool], Segments] = {}
        self._places: dict[object, Places] = {}
        self._parts: dict[Hashable, object] = {}

    def segments(self, model: Model) -> Segments:
        """The spans under a model's delay, cut short where it changes within them."""
        key = self._key(model)
        return _remembered(self._segments, key, lambda: self._cut(*key))

    def places(self, model: Model) -> Places | None:
        """True positions in every span after the lead; None where none were given or needed."""
        positions = self.positions
        if positions is None or not model.needs_position:
            return None
        interval = self.segments(model).interval
        key = self._key(model), tuple(e for e in model.effects if e.stage == 'observation')
        return _remembered(
            self._places, key, lambda: Places(
                model.true_position(positions[:-1])[interval], *self._who))

    def part(self, key: Hashable, model: Model, make: Callable[[], Value]) -> Value:
        """What a `model` makes here of what the `key` names: made anew, or remembered.

        Besides the key it may depend on how the model cuts the recording and on its reference
        field. A fit asks for one parameter after the other, and most parts stay as they were.
        """
        found = _remembered(
            self._parts, (key, self._key(model), model.reference_field), make, PARTS)
        return cast('Value', found)

    def _key(self, model: Model) -> tuple[float, bool]:
        return model.delay, model.time_invariant and not model.needs_position

    def _cut(self, delay: float, whole: bool) -> Segments:
        commands, times = self.commands, self.times
        switches = commands.t + delay
        edges = np.concatenate([switches[switches < times[-1]], times])
        edges.sort(kind='stable')  # a merge: both were ascending
        edges = edges[np.append(True, edges[1:] > edges[:-1])]
        if not whole:
            edges = _subdivide(edges)
        start = edges[:-1, None]
        span = edges[1:, None] - start
        lead = int(edges.searchsorted(times[0]))
        row = switches.searchsorted(start, side='right') - 1
        frequency = np.zeros(len(commands.t)) if commands.frequency is None else commands.frequency
        # Row −1, before the first command, is the zero appended at the end.
        return Segments(
            t=start + span / 2,
            span=span,
            field=np.concatenate([commands.field, np.zeros((1, 2))]).take(row, axis=0),
            frequency=np.append(frequency, 0.0).take(row),
            since=None if whole else self._since(start + span / 2, switches, row),
            lead=lead,
            frames=edges[lead:].searchsorted(times),
        )


    def _since(self, middle: np.ndarray, switches: np.ndarray, row: np.ndarray) -> np.ndarray:
        began = switches[last_change(self.commands.field, self.commands.frequency)]
        return np.asarray(middle - np.append(began, np.inf).take(row).clip(max=middle))


def last_change(field: np.ndarray, frequency: np.ndarray | None = None) -> np.ndarray:
    """The row (K,) from which on each command has been what it is: repeats change nothing.

    Of commands of `field` (K, 2) [T], or (K, N, 2), and `frequency` (K,) or (K, N) [Hz] of the
    rotation.
    """
    changed = (np.diff(field, axis=0) != 0).any(axis=tuple(range(1, field.ndim)))
    if frequency is not None:
        turns = frequency.reshape(len(field), -1)
        changed |= (np.diff(turns, axis=0) != 0).any(axis=1)
    rows = np.arange(len(field))
    return np.maximum.accumulate(np.where(np.append(True, changed)[:len(rows)], rows, 0))


def _remembered(cache: dict[Key, Value], key: Key, make: Callable[[], Value],
                most: int = 4) -> Value:
    """The value under a key, made if need be; of `most`, the longest unused makes room."""
    value = cache.pop(key) if key in cache else make()
    while len(cache) >= most:
        del cache[next(iter(cache))]
    cache[key] = value
    return value


def _subdivide(edges: np.ndarray) -> np.ndarray:
    """The edges with more between them, so that spans are cut equally to LONGEST at most."""
    span = np.diff(edges)
    # Frames of just LONGEST stay whole; rounding may leave next to nothing between two edges.
    parts = np.maximum(np.ceil(span / LONGEST - 1e-9), 1).astype(int)
    if parts.max() <= 1:
        return edges
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = np.repeat(edges[:-1], parts) + number * np.repeat(span / parts, parts)
    return np.append(inner, edges[-1])
