"""Terms learned where no effect of the library has a name, on a hundred worlds that have one.

Twenty kinds, five of each; eight kinds are of the grammar, twelve are not (`_unlisted_worlds`).
Five more were written when nothing was to be changed any more.
Beside them sessions with nothing hidden, and with effects of the library, in which nothing may be
learned. `out/learned.jsonl` has every session.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

from bench._closed_loop import FIELD, Loop
from bench._hidden_suite import blind
from bench._kept import in_turns, run_kept
from bench._learned_gap import Foretold, gaps, only_session
from bench._unlisted_worlds import KINDS, NEW, Filmed, HiddenWorld, Law, film
from bench.discovery import interval
from bench.figure import Figure, sized
from microbot_ros.control.plugins.predictive import Predictive
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.discovery.learned.candidates import accumulated, steps
from microbot_ros.discovery.learned.learn import learn_term, learn_terms, relearn, told
from microbot_ros.discovery.result import Discovery
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.model import Model

ENOUGH = 1 / 3
"""Part of the gap that may be left."""


@dataclass(frozen=True)
class Outcome:
    """What became of one session: of a `kind` of world, 'null', or an effect of the library."""

    kind: str
    seed: int
    verdict: str = ''
    learned: str = ''
    right: bool = False
    formula: str | None = None
    formula_right: bool | None = None
    before: float = np.nan
    after: float = np.nan
    told: float = np.nan
    covered: float = np.nan
    seconds: float = np.nan
    error: str = ''


def figures() -> Iterator[Figure]:
    """All of them."""
    outcomes = run_kept(Path('out/learned.jsonl'), cases(), judge, lambda told: Outcome(**told))
    yield from score(outcomes)
    yield from wheel()
    yield from beside(outcomes)


def cases(worlds: int = sized(5, 1), nulls: int = sized(200, 20),
          named: int = sized(100, 20)) -> list[tuple[str, int]]:
    """(what is hidden, seed) of every session."""
    from bench._hidden_effects import LISTED

    listed = list(LISTED)
    return in_turns([
        [(kind, seed) for seed in range(1, worlds + 1) for kind in KINDS | NEW],
        [('null', 300_000 + k) for k in range(nulls)],
        [(listed[k % len(listed)], 310_000 + k) for k in range(named)]])


def judge(case: tuple[str, int]) -> Outcome:
    """Look at one session."""
    kind, seed = case
    outcome = Outcome(kind, seed)
    try:
        if kind in KINDS | NEW:
            return _of_world(outcome, film(kind, seed))
        hidden = () if kind == 'null' else (kind,)
        commands = ('paper', 'fast')[seed % 2]
        found, spent = _timed(blind(seed, commands, hidden, 100.0 if hidden else 0.0).session)
        return replace(outcome, verdict=found.verdict, seconds=spent, learned=_what(found))
    except Exception:  # one that fails must not lose the rest
        return replace(outcome, error=traceback.format_exc())


def _timed(session: object) -> tuple[Discovery, float]:
    began = time.process_time()
    found = discover([session])  # type: ignore[list-item]
    return found, time.process_time() - began


def _what(found: Discovery) -> str:
    if not found.learned:
        return ''
    term = found.learned[0].term
    return f'{term.against}, {term.frame}, {term.acts_on}'


def _of_world(outcome: Outcome, filmed: Filmed) -> Outcome:
    found, spent = _timed(filmed.session)
    outcome = replace(outcome, verdict=found.verdict, seconds=spent, learned=_what(found),
                      told=found.gap.learned)
    if not found.learned:
        return outcome
    before, after = _gaps(filmed)
    term, kind = found.learned[0].term, filmed.kind
    right = term.against in kind.against and (term.frame, term.acts_on) == (
        kind.frame, kind.acts_on)
    return replace(
        outcome, right=right, formula=term.formula, before=before, after=after,
        formula_right=None if kind.formula is None else right and kind.formula in (
            term.formula or ''),
        covered=_covered(term, filmed) if right else np.nan)


def _gaps(filmed: Filmed) -> tuple[float, float]:
    """Held-out gap [m] without and with what is learned."""
    session = only_session(filmed)
    fit = fit_first_order([session])
    findings = learn_terms(fit, learn_term(fit))

    def base(shown: np.ndarray) -> Foretold:
        return fit_first_order([session.only(shown)]), 0.0

    def learned(shown: np.ndarray) -> Foretold:
        return relearn(findings, base(shown)[0]), 0.0

    before, after = gaps(filmed, session, [base, learned])
    return before, after


# Peers ------------------------------------------------------------------------------------------

COMPARED = ('channel', 'vortex', 'facing', 'settling', 'lamp', 'cells', 'jet', 'recovery')
"""Kinds of world that peers are given, once each."""

SEED = sized(3, 1)


def beside(outcomes: Sequence[Outcome]) -> list[Figure]:
    """The gap that peers leave, beside ours of the same worlds among the `outcomes`."""
    from bench._foreign_worlds import installed
    from bench._learned_peers import PEERS, Judged
    from bench._learned_peers import judge as judge_peer

    peers = [peer for peer in PEERS if peer != 'ADCD' or installed('adcd')]
    judged = run_kept(
        Path('out/learned_peers.jsonl'), [(kind, SEED, peer) for kind in COMPARED
                                          for peer in peers],
        judge_peer, lambda told: Judged(**told))
    ours = {o.kind: _left(o.before, o.after) for o in outcomes
            if o.kind in COMPARED and o.seed == SEED}
    result = []
    for peer in peers:
        theirs = [one for one in judged if one.peer == peer and one.kind in ours]
        if not theirs:
            continue
        own = median(ours[one.kind] for one in theirs)
        left = median(_left(one.before, one.after) for one in theirs)
        spent = median(one.seconds for one in theirs)
        result.append(Figure(
            17, f'part of the gap left on {len(theirs)} worlds, over that of {peer}',
            own / left, '×', '< 1', f'{own:.2f} and {left:.2f}, {spent:.0f} s', own < left))
    return result


def _left(before: float, after: float) -> float:
    """Part of a gap that is left; all where nothing was learned."""
    return after / before if np.isfinite(after) else 1.0


# At the wheel -----------------------------------------------------------------------------------

STEERED = ('channel', 'vortex', 'cells', 'jet', 'pair')
STRONGER = 4.0
"""Times the strength at which it was learned: of a flow that feedback alone can't undo."""

_SECONDS, _JUDGED = 30.0, 15.0


class _Steered(Loop):
    """A loop in a world where a law acts, at places given by `about` [m]."""

    def hide(self, law: Law, strength: float) -> None:
        """Let the law act from now on."""
        self.world = HiddenWorld(
            self.world.bodies, np.random.default_rng(self.seed + 1000), law, strength)


def wheel() -> list[Figure]:
    """Distance from a goal by the predictive controller, with the learned term over without."""
    return [_wheel(name) for name in STEERED]


def _wheel(name: str) -> Figure:
    filmed = film(name, 1, STRONGER**2 * 100.0)
    found = discover([filmed.session])
    before, after = (_distance(model, filmed) * 1e6 for model in (Model(FIELD), found.model))
    return Figure(
        17, f'hidden {name}, at a goal: first-order {before:.2f} µm, learned {after:.2f} µm',
        after / before, '×', '< 1', 'the first-order model', after < before)


def _distance(model: Model, filmed: Filmed) -> float:
    """Mean distance [m] from a goal 25 µm away, once there was time to reach it."""
    start = np.array([[filmed.swarm['x'][0], filmed.swarm['y'][0]]])
    goal = start * (1 - 25e-6 / np.hypot(*start[0]))
    loop = _Steered(start, filmed.swarm['speed'][:1], filmed.swarm['phi'][:1], period=1 / 30,
                    model=model)
    loop.hide(filmed.law, filmed.strength)
    return loop.distance(Predictive(), goal, _SECONDS, _JUDGED)


def _covered(term: LearnedTerm, filmed: Filmed) -> float:
    """Which part of the band of a `term`, by what each knot moves, holds what was done.

    What was done is brought to the knots by least squares, without noise, at the true speeds.
    """
    fit = told(fit_first_order([only_session(filmed)]))
    session = fit.session_fits[0].session
    own = filmed.swarm['speed'] * np.exp(1j * filmed.swarm['phi'])
    p = replace(fit.session_fits[0], phasor=own[session.ids])
    times = session.times + filmed.session.tracks.t.min()
    done = filmed.velocities(times) * np.diff(times)[:, None]
    gram, right = 0.0, 0.0
    for n, column in enumerate(map(accumulated, steps(fit, p, term))):
        used = session.joined()[:, n]
        step, moved = np.diff(column, axis=0)[used], done[used, session.ids[n]]
        design = np.concatenate([step.real, step.imag])
        gram = gram + design.T @ design
        right = right + design.T @ np.concatenate([moved.real, moved.imag])
    gram = np.asarray(gram)
    weight = np.diagonal(gram)
    true = np.linalg.lstsq(gram + 1e-6 * weight.mean() * np.eye(len(gram)), right, rcond=None)[0]
    if term.acts_on != 'velocity' and term.frame != 'radial':
        mean = true @ weight / weight.sum()
        true = (1 + true) / (1 + mean) - 1 if term.acts_on == 'speed' else true - mean
    low, high = term.low.T.ravel(), term.high.T.ravel()
    shown = weight > 0.02 * weight.max()
    return float(np.average(((true >= low) & (true <= high))[shown], weights=weight[shown]))


def score(outcomes: Sequence[Outcome]) -> list[Figure]:
    """The figures of all outcomes."""
    worlds = [o for o in outcomes if o.kind in KINDS]
    nulls = [o for o in outcomes if o.kind == 'null']
    named = [o for o in outcomes if o.kind not in (*KINDS, *NEW, 'null')]
    new = [o for o in outcomes if o.kind in NEW]
    bands = [o.covered for o in worlds if np.isfinite(o.covered)]
    covered = float(np.mean(bands)) if bands else np.nan
    formulas = [bool(o.formula_right) for o in worlds if KINDS[o.kind].formula is not None]
    longest = max(o.seconds for o in worlds)
    found = [
        _share('held-out gap at most a third', _closed(worlds), 0.9),
        _share('right covariate and frame', [o.right for o in worlds], 0.9),
        _share('kinds never seen before: gap at most a third', _closed(new), 0.75),
        _share('kinds never seen before: right covariate and frame', [o.right for o in new], 0.9),
        _share('formula right, where the grammar has it', formulas, 0.8),
        Figure(17, 'bands cover', 100 * covered, '%', '90–98', '', 0.9 <= covered <= 0.98),
        _share('nothing missing: a term learned', [bool(o.learned) for o in nulls], 0.01,
               most=True),
        _share('effect of the library: a term learned in its place',
               [bool(o.learned) for o in named], 0.02, most=True),
        Figure(17, 'longest search with a term', longest, 's', '≤ 60', '', longest <= 60),
    ]
    return [figure for figure in found if np.isfinite(figure.value)]


def _closed(worlds: Sequence[Outcome]) -> list[bool]:
    return [bool(o.after <= ENOUGH * o.before) for o in worlds]


def _share(name: str, hits: Sequence[bool], target: float, *, most: bool = False) -> Figure:
    share = float(np.mean(hits)) if hits else np.nan
    low, high = interval(sum(hits), len(hits)) if hits else (0.0, 1.0)
    return Figure(17, name, 100 * share, '%', f'{"≤" if most else "≥"} {100 * target:g}',
                  f'{sum(hits)} of {len(hits)}, {100 * low:.0f}–{100 * high:.0f} %',
                  share <= target if most else share >= target)
