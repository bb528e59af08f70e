"""Which effects the data ask for: added one by one, dropped again, exchanged for better ones.

Forward at a family-wise 1 % over the library, backward at 0.1 %, as in pharmacometrics' covariate
models (Jonsson and Karlsson 1998), with exchanges because stand-ins enter first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial

from microbot_ros.discovery.evidence import TURNING, Evidence, explainable
from microbot_ros.discovery.likelihood import Fit, Whitening, evaluate, settle
from microbot_ros.discovery.result import Candidate, Rung
from microbot_ros.discovery.search import Found, found_in, look
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model

FORWARD, BACKWARD = 0.01, 0.001
MOST = 4
"""Effects in a model: a recording that seems to need more needs another library."""

CLEARLY = 3.0
"""Gain in log p for which one effect is preferred to another: a factor of 20."""

Search = Callable[[Fit, Iterable[str]], list[Found]]


def search(fit: Fit, names: Iterable[str],
           run: Callable[..., Iterable[Found | None]] = map) -> list[Found]:
    """Every candidate that the data can show, the least likely by chance first.

    `run` is `map`, or that of an executor.
    """
    found = [one for one in run(partial(look, fit), names) if one is not None]
    return sorted(found, key=lambda one: one.log_p)


@dataclass
class Ladder:
    """A climb from the baseline: `fit` is where it stands, `rungs` how it came there."""

    originals: Sequence[Evidence]
    search: Search = search
    fit: Fit = field(init=False)
    rungs: list[Rung] = field(default_factory=list)
    open: list[Found] = field(default_factory=list)
    """What the last search found, beside the model."""
    _rivals: dict[str, list[Found]] = field(init=False, default_factory=dict)
    _rivals_of: Fit | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        first = self.originals[0]
        self.fit = self.stand(Model.baseline(first.conditions, first.commands))

    def stand(self, model: Model) -> Fit:
        """A model on what of the sessions it can explain, with places as it believes them."""
        fit = self._stand(model, [TURNING] * len(self.originals))
        if not fit.model.effect('alignment_lag'):
            return fit
        # What a lag can explain depends on how long it is, and on how headings jitter.
        return self._stand(fit.model, [p.whitening.turning * p.diffusion for p in fit.parts])

    def _stand(self, model: Model, turning: Sequence[float]) -> Fit:
        evidences = [explainable(e, model, jitter)
                     for e, jitter in zip(self.originals, turning, strict=True)]
        fit = settle(evaluate(model, evidences, [Whitening(e.interval) for e in evidences]))
        located = [
            p.evidence.located(p.levels.moved(p.swim), p.whitening.excess) for p in fit.parts]
        return settle(evaluate(fit.model, located, [p.whitening for p in fit.parts]))

    def climb(self, report: Callable[[str], None]) -> None:
        """Add, drop and exchange until nothing is left to do."""
        for _ in range(3):
            while len(self.fit.model.effects) < MOST and self._step(report):
                pass
            if not self._exchange(report):
                return

    def _step(self, report: Callable[[str], None]) -> bool:
        """Add the best candidate if chance can't explain it, then drop what it made needless."""
        here = tuple(e.id for e in self.fit.model.effects)
        report(f'looking beside {", ".join(here) or "the first-order model"}')
        self.open = self.search(self.fit, [name for name in EFFECTS if name not in here])
        table = tuple(
            Candidate(c.id, c.likelihood_ratio, c.dof, c.delta_bic, c.p_value) for c in self.open
        )
        best = next((c for c in self.open if c.whole), None)
        if best is None or best.p_value * len(self.open) >= FORWARD:
            self.rungs.append(Rung(here, table, None))
            return False
        report(f'adding {best.id} (p = {best.p_value:.2g})')
        self.fit = self.stand(best.fit.model)
        removed = self._drop(best.id)
        self.rungs.append(Rung(here, table, best.id, removed))
        return best.id not in removed

    def _drop(self, new: str) -> tuple[str, ...]:
        """Take out, worst first, what is no longer needed."""
        removed: list[str] = []
        while len(self.fit.model.effects) > 1:
            worst = max((contribution(self.fit, e.id) for e in self.fit.model.effects),
                        key=lambda c: c.log_p)
            if worst.p_value < BACKWARD:
                break
            removed.append(worst.id)
            self.fit = self.stand(self.fit.model.without(worst.id))
        return tuple(removed)

    def _exchange(self, report: Callable[[str], None]) -> bool:
        """Exchange one effect for one that explains clearly more in its place."""
        for effect in self.fit.model.effects:
            own = contribution(self.fit, effect.id)
            best = next((rival for rival in self.rivals(effect.id) if rival.whole), None)
            if best is not None and clearly(best, own):
                report(f'{best.id} instead of {effect.id}')
                self.fit = self.stand(best.fit.model)
                return True
        return False

    def rivals(self, name: str) -> list[Found]:
        """What could stand in place of an effect, best first; found once for every fit."""
        if self._rivals_of is not self.fit:
            self._rivals, self._rivals_of = {}, self.fit
        if name not in self._rivals:
            present = [e.id for e in self.fit.model.effects]
            self._rivals[name] = self.search(
                without(self.fit, name), [other for other in EFFECTS if other not in present])
        return self._rivals[name]


def clearly(one: Found, other: Found) -> bool:
    """Whether one explains clearly more than another."""
    return one.log_p < other.log_p - CLEARLY


def without(fit: Fit, name: str) -> Fit:
    """The fit with one effect less, all else at its maximum again."""
    evidences = [p.evidence for p in fit.parts]
    rest = evaluate(fit.model.without(name), evidences, [p.whitening for p in fit.parts])
    return settle(rest)


def contribution(fit: Fit, name: str) -> Found:
    """What one effect of a fit brings beside the others."""
    return found_in(fit, without(fit, name), name)

