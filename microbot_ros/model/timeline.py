"""Frames and commands on one time axis, split where either changes, prepared for many fits."""

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
"""Longest span [s] of models that change in time or with position.

Choice: a particle moves by less than its size in it; time of a fit is inverse to it.
"""

REMEMBERED = 30.0
"""Time [s] before the first frame that is divided so; what was commanded earlier stays whole.

A longer pause between frames is divided into as many parts as this time. Choice: headings forget
within seconds; a command may be in force for a day, and a pause last for an hour.
"""

PARTS = 8
"""Number of cached parts of models. Choice: more than a model of a few effects has."""


@dataclass(frozen=True)
class Segments:
    """S spans of constant command; the last ends at the last frame.

    Attributes
    ----------
    lead : int
        Number of spans before the first frame: the history that the heading depends on.
    frames : ndarray of int, shape (T,)
        Indices of the frames among the edges of the spans after these.
    """

    t: np.ndarray
    """Middles (S, 1) [s]."""
    span: np.ndarray
    """Lengths (S, 1) [s]."""
    field: np.ndarray
    """Commanded field (S, 1, 2) [T]; zero before the first command."""
    frequency: np.ndarray
    """Commanded rotation (S, 1) [Hz]."""
    since: np.ndarray | None
    """Time (S, 1) [s] since the command last changed; zero before the first.

    None for undivided spans, where nothing depends on it.
    """
    lead: int
    frames: np.ndarray

    @property
    def first(self) -> np.ndarray:
        """First span after the lead of each frame interval (T − 1,)."""
        return self.frames[:-1]

    def sum(self, spans: np.ndarray) -> np.ndarray:
        """Sum values of spans over every frame interval.

        Parameters
        ----------
        spans : ndarray, shape (S − lead, ...)
            Values of the spans after the lead.

        Returns
        -------
        ndarray, shape (T − 1, ...)
            Sums.
        """
        if len(spans) == len(self.first):
            return spans
        return np.add.reduceat(spans, self.first, axis=0)

    @property
    def interval(self) -> np.ndarray:
        """Frame interval of each span after the lead (S − lead,)."""
        return np.repeat(np.arange(len(self.first)), np.diff(self.frames))

    def context(self, model: Model) -> EffectContext:
        """Return the context in every span, the lead included.

        Parameters
        ----------
        model : Model
            The model.

        Returns
        -------
        EffectContext
            With the field after stage 1, without places.
        """
        field = model.field(self.field)
        return EffectContext(self.t, self.span, field, self.frequency, model.reference_field,
                             since=self.since)


class Timeline:
    """Commands and frames of one recording, ready to evaluate models on.

    Parameters
    ----------
    commands : Commands
        Commands.
    times : ndarray, shape (T,)
        Times of the frames [s], ascending, T ≥ 2.
    positions : ndarray, shape (T, N, 2), optional
        Positions as the camera reports them [m], NaN in gaps. Effects that depend on position are
        evaluated there, each over the interval that begins with it. For fits they should be
        filtered from earlier frames: raw ones bias such effects.
    ids : ndarray of int, shape (N,), optional
        Particles, for terms that differ between them.
    phi : ndarray, shape (N,), optional
        φ of the particles [rad], for terms that depend on the heading.

    Raises
    ------
    ValueError
        For fewer than two times, or times that do not ascend.
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
        """Return the spans under a model's delay, divided if the model changes within them.

        Parameters
        ----------
        model : Model
            The model.

        Returns
        -------
        Segments
            Spans.
        """
        key = self._key(model)
        return _remembered(self._segments, key, lambda: self._cut(*key))

    def places(self, model: Model) -> Places | None:
        """Return true positions in every span after the lead.

        Parameters
        ----------
        model : Model
            The model.

        Returns
        -------
        Places or None
            None if none were given or needed.
        """
        positions = self.positions
        if positions is None or not model.needs_position:
            return None
        interval = self.segments(model).interval
        key = self._key(model), tuple(e for e in model.effects if e.stage == 'observation')
        return _remembered(
            self._places, key, lambda: Places(
                model.true_position(positions[:-1])[interval], *self._who))

    def part(self, key: Hashable, model: Model, make: Callable[[], Value]) -> Value:
        """Return a part of a model's response, computed or from the cache.

        Fits vary one parameter at a time, and most parts stay as they were.

        Parameters
        ----------
        key : hashable
            What the part depends on, besides the model's delay, spans and reference field.
        model : Model
            The model.
        make : callable
            Computes the part.

        Returns
        -------
        object
            What `make` returns.
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
            begin = max(edges[0], times[0] - REMEMBERED)
            first = int(edges.searchsorted(begin))
            edges = np.concatenate([
                edges[:first], _subdivide(np.unique(np.append(begin, edges[first:])))])
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
    """Return the row from which on each command has been in force; repeats change nothing.

    Parameters
    ----------
    field : ndarray, shape (K, 2) or (K, N, 2)
        Fields of the commands [T].
    frequency : ndarray, shape (K,) or (K, N), optional
        Rotation frequencies [Hz].

    Returns
    -------
    ndarray of int, shape (K,)
        Row of the last change, for each row.
    """
    if not len(field):
        return np.empty(0, int)
    changed = (np.diff(field, axis=0) != 0).any(axis=tuple(range(1, field.ndim)))
    if frequency is not None:
        turns = frequency.reshape(len(field), -1)
        changed |= (np.diff(turns, axis=0) != 0).any(axis=1)
    rows = np.arange(len(field))
    return np.maximum.accumulate(np.where(np.append(True, changed)[:len(rows)], rows, 0))


def _remembered(cache: dict[Key, Value], key: Key, make: Callable[[], Value],
                most: int = 4) -> Value:
    """Return the cached value of a key, computed if need be.

    Of `most` values the least recently used one is dropped.
    """
    value = cache.pop(key) if key in cache else make()
    while len(cache) >= most:
        del cache[next(iter(cache))]
    cache[key] = value
    return value


def _subdivide(edges: np.ndarray) -> np.ndarray:
    """Return the edges with more between them, for equal spans of at most LONGEST.

    Spans longer than REMEMBERED get no more parts than that.
    """
    span = np.diff(edges)
    # Frames of just LONGEST stay whole; rounding may leave next to nothing between two edges.
    parts = np.ceil(span.clip(max=REMEMBERED) / LONGEST - 1e-9).clip(min=1).astype(int)
    if parts.max() <= 1:
        return edges
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = np.repeat(edges[:-1], parts) + number * np.repeat(span / parts, parts)
    return np.append(inner, edges[-1])
