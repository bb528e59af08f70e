"""Which effects the data ask for: added one by one, dropped again, exchanged for better ones.

Forward at a family-wise 1 % over the library, backward at 0.1 %, as in pharmacometrics' covariate
models (Jonsson and Karlsson 1998), with exchanges because stand-ins enter first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import compress

import numpy as np

from microbot_ros.discovery.processes import Run, serially
from microbot_ros.discovery.result import Candidate, SelectionStep
from microbot_ros.discovery.search import CandidateFit, compare, look_at, polish
from microbot_ros.estimation.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood import SessionFit, eliminate, inner
from microbot_ros.estimation.model_fit import ModelFit, fit_sessions, fit_with_noise
from microbot_ros.estimation.prepared_session import PreparedSession
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model

FORWARD, BACKWARD = 0.01, 0.001
MOST = 4
"""Effects in a model: a recording that seems to need more needs another library."""

CLEARLY = 3.0
"""Gain in log p for which one effect is preferred to another: a factor of 20."""

REACH = 20.0
"""How far a candidate's log p may lie behind the best at first sight and still be polished."""

Search = Callable[[ModelFit, Iterable[str]], list[CandidateFit]]


def search(fit: ModelFit, names: Iterable[str], run: Run = serially) -> list[CandidateFit]:
    """Every candidate among `names` that the data can show beside a `fit`, best first.

    The least likely by chance. What at first sight lies far behind the best stays as it is then,
    unless it makes headings remember, since then it shows with noise of its own. `run` as
    `serially` or `in_processes`.
    """
    kept = [one for p in fit.session_fits for one in (p.session, p.whitening)]
    seen = [one for one in run(partial(look_at, fit), list(names), kept) if one is not None]
    best = min((one.log_p for one in seen), default=0.0)
    near = [one.log_p < best + REACH or one.fit.model.lags != fit.model.lags for one in seen]
    polished = iter(run(partial(polish, fit=fit), list(compress(seen, near)), kept))
    found = [next(polished) if is_near else one for one, is_near in zip(seen, near, strict=True)]
    return sorted(found, key=lambda one: one.log_p)


@dataclass
class StepwiseSelection:
    """Selection of effects, from the first-order model on, for prepared `sessions`.

    `search` fits candidates. `start` is the fit of the
    first-order model, `current` that of the model so far, `steps` tell how it came
    about, `open` holds what the last search found beside it.
    """

    sessions: Sequence[PreparedSession]
    search: Search = search
    start: ModelFit = field(init=False)
    current: ModelFit = field(init=False)
    steps: list[SelectionStep] = field(default_factory=list)
    open: list[CandidateFit] = field(default_factory=list)
    _before: set[frozenset[str]] = field(init=False, default_factory=set)
    _rivals: dict[str, list[CandidateFit]] = field(init=False, default_factory=dict)
    _rivals_of: ModelFit | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        first = self.sessions[0]
        self.start = self.current = self.fit(Model.baseline(first.conditions, first.commands))

    def fit(self, model: Model) -> ModelFit:
        """A `model` fitted to what of the sessions it can explain."""
        self._before.add(frozenset(e.id for e in model.effects))
        return fit_sessions(model, self.sessions)

    def run(self, report: Callable[[str], None]) -> None:
        """Add, drop and exchange until nothing is left to do; `report` is told each step."""
        for _ in range(3):
            while len(self.current.model.effects) < MOST and self._step(report):
                pass
            if not self._exchange(report):
                return

    def _step(self, report: Callable[[str], None]) -> bool:
        """Add the best candidate if chance can't explain it, then drop what it made needless."""
        here = tuple(e.id for e in self.current.model.effects)
        report(f'looking beside {", ".join(here) or "the first-order model"}')
        self.open = self.search(self.current, [name for name in EFFECTS if name not in here])
        table = tuple(
            Candidate(c.id, c.likelihood_ratio, c.dof, c.delta_bic, c.p_value) for c in self.open
        )
        best = next((c for c in self.open if c.shape_seen), None)
        if best is None or best.p_value * len(self.open) >= FORWARD:
            self.steps.append(SelectionStep(here, table, None))
            return False
        report(f'adding {best.id} (p = {best.p_value:.2g})')
        self.current = self.fit(best.fit.model)
        removed = self._drop()
        self.steps.append(SelectionStep(here, table, best.id, removed))
        return best.id not in removed

    def _drop(self) -> tuple[str, ...]:
        """Take out, worst first, what is no longer needed."""
        removed: list[str] = []
        while len(self.current.model.effects) > 1:
            worst = max((contribution(self.current, e.id) for e in self.current.model.effects),
                        key=lambda c: c.log_p)
            if worst.p_value < BACKWARD:
                break
            removed.append(worst.id)
            self.current = self.fit(self.current.model.without(worst.id))
        return tuple(removed)

    def _exchange(self, report: Callable[[str], None]) -> bool:
        """Exchange one effect for one that explains clearly more in its place.

        Not for one that makes a model which was there before: where none suits, each model has
        something that one of the others explains better.
        """
        for effect in self.current.model.effects:
            own = contribution(self.current, effect.id)
            best = next((rival for rival in self.rivals(effect.id) if rival.shape_seen), None)
            if best is not None and clearly_better(best, own) and not self._had(best.fit.model):
                report(f'{best.id} instead of {effect.id}')
                self.current = self.fit(best.fit.model)
                return True
        return False

    def _had(self, model: Model) -> bool:
        """Whether a model of the same effects was the best before."""
        return frozenset(e.id for e in model.effects) in self._before

    def rivals(self, name: str) -> list[CandidateFit]:
        """What could stand in place of the effect `name`, best first; found once per fit."""
        if self._rivals_of is not self.current:
            self._rivals, self._rivals_of = {}, self.current
        if name not in self._rivals:
            present = [e.id for e in self.current.model.effects]
            self._rivals[name] = self.search(
                without(self.current, name), [other for other in EFFECTS if other not in present])
        return self._rivals[name]


def clearly_better(one: CandidateFit, other: CandidateFit) -> bool:
    """Whether `one` explains clearly more than the `other`."""
    return one.log_p < other.log_p - CLEARLY


def without(fit: ModelFit, name: str) -> ModelFit:
    """A `fit` with the effect `name` less, all else at its maximum again."""
    return fit_with_noise(fit.under(fit.model.without(name)))


def contribution(fit: ModelFit, name: str) -> CandidateFit:
    """What the effect `name` of a `fit` brings beside the others."""
    return compare(fit, without(fit, name), name)


CANCELLED = -np.sqrt(0.5)
"""Cosine below which at least half of what one effect does is undone by the other."""


def is_cancelled(fit: ModelFit, name: str) -> bool:
    """Whether another effect of place in a `fit` undoes most of what the one `name` does.

    A spot and a flow that nearly cancel are a series for some third field. What is compared are
    the white displacements that each causes, less what v, φ and offsets absorb.
    """
    fields = [effect.id for effect in fit.model.effects if effect.needs_position]
    if name not in fields or len(fields) < 2:
        return False
    overlap = sum(_overlap(p, fit.model, fields) for p in fit.session_fits)
    size = np.sqrt(np.maximum(np.diagonal(overlap), 1e-300))
    cosine = (overlap / np.outer(size, size))[fields.index(name)]
    return bool(cosine.min() < CANCELLED)


def _overlap(p: SessionFit, model: Model, names: list[str]) -> np.ndarray:
    """Inner products (E, E) of what these effects do in one session."""
    c = p.velocity_phasor
    moved = p.expected.at(c)
    columns = []
    for name in names:
        rest = ExpectedDisplacement.of(model.without(name), p.session.timeline)
        columns.append(np.broadcast_to(moved - rest.at(c), p.session.z.shape))
    white = p.whiten(np.stack(columns, axis=-1))
    both = np.concatenate([p.white / np.sqrt(p.diffusion), white], axis=-1)
    return eliminate(inner(both)).sum(axis=0)[1:, 1:]
