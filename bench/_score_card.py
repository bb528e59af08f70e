"""Judging discovery on blind sessions: which name, whether right, whether its intervals hold."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from importlib import import_module
from typing import TypeVar

import numpy as np

from bench._hidden_effects import LISTED, UNLISTED
from bench._hidden_suite import COMMANDS, FIELD, Blind, blind
from microbot_ros.common.units import to_si
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.result import Discovery, Estimate
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model


@dataclass(frozen=True)
class Case:
    """One blind session to draw: which card it is for, and the arguments of `blind`."""

    card: str
    seed: int
    commands: str
    effects: tuple[str, ...] = ()
    evidence: float = 0.0
    rolling: bool = False
    rivals: tuple[str, ...] = ()

    def draw(self) -> Blind:
        """The session."""
        return blind(
            self.seed, self.commands, self.effects, self.evidence, rolling=self.rolling)


@dataclass(frozen=True)
class Outcome:
    """What discovery said of a case.

    `names` (id, status), plainest first; `rivals`: what those names can't be told from, all
    together; `covered`: per parameter of a right name, whether its 95 % interval holds the truth;
    `excess`: held-out gap before, after, of the true model, and floor [m]; `unknowns` and `rows`:
    k and n of the theoretical limit k ln n; `seconds` of CPU time; `rivals_said`: what effects
    each rival kept.
    """

    case: Case
    particles: int
    verdict: str
    names: tuple[tuple[str, str], ...]
    rivals: tuple[str, ...]
    unexplained: tuple[str, ...]
    covered: tuple[bool, ...]
    excess: tuple[float, float, float, float]
    unknowns: int
    rows: int
    seconds: float
    rivals_said: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    near_floor: bool = False

    @property
    def established(self) -> set[str]:
        """The names that it vouches for."""
        return {name for name, status in self.names if status == 'established'}

    @property
    def first(self) -> bool:
        """Whether the plainest name is that of something hidden."""
        return bool(self.names) and self.names[0][0] in self.case.effects

    @property
    def exact(self) -> bool:
        """Whether it vouches for all that was hidden and for nothing else, and is content."""
        return self.established == set(self.case.effects) and self.verdict == 'named'

    @property
    def told(self) -> bool:
        """Whether it says that something is there without a name: of a jump of the stage, when."""
        return self.verdict == 'unnamed' or (
            self.case.effects == ('stage_jump',) and 'single steps' in self.unexplained)

    @property
    def suspected(self) -> bool:
        """Whether all that was hidden is named or among what a name can't be told from."""
        return set(self.case.effects) <= {name for name, _ in self.names} | set(self.rivals)


def judge(case: Case) -> Outcome:
    """Draw a case, search it, compare with the truth."""
    session = case.draw()
    known = all(effect in EFFECTS and effect != 'drive_response' for effect in case.effects)
    began = time.process_time()
    found = discover([session.session], truth=true_model(session) if known else None)
    seconds = time.process_time() - began
    gap = found.gap
    rows = len(session.session.tracks.t) - len(session.session.tracks.particles)
    return Outcome(
        case, len(session.session.tracks.particles), found.verdict,
        tuple((effect.id, effect.status) for effect in found.effects),
        tuple(r for effect in found.effects for r in effect.indistinguishable_from),
        tuple(residual.against for residual in found.unexplained),
        tuple(covered(session, found)), (gap.before, gap.after, gap.truth, gap.floor),
        sum(len(EFFECTS[e].parameters()) for e in case.effects if e in EFFECTS), 2 * rows,
        seconds, {name: tuple(sorted(import_module(_RIVALS[name]).named(session.session)))
                  for name in case.rivals},
        session.near_floor)


PYSINDY, SFI = 'PySINDy', 'StochasticForceInference'
_RIVALS = {PYSINDY: 'bench._pysindy_rival', SFI: 'bench._sfi_rival'}
"""Modules, imported where they run: both take long to load, and one does not survive a fork."""


def true_model(session: Blind) -> Model:
    """The model with what was hidden."""
    effects = tuple(
        EFFECTS[name](**{
            p.field: to_si(p.name, parameters[p.name]) for p in EFFECTS[name].parameters()})
        for name, parameters in session.hidden.items()
    )
    rolling = session.session.conditions.propulsion == 'rolling'
    return Model(FIELD, 'rolling' if rolling else 'catalytic', effects)


def covered(session: Blind, found: Discovery) -> Iterator[bool]:
    """For every parameter of a right name whether its 95 % interval holds the truth."""
    for effect in found.effects:
        if effect.status == 'established' and effect.id in session.hidden:
            for estimate, true in truths(session, effect.id, effect.parameters, found.model):
                if np.isfinite(estimate.std):
                    yield estimate.low <= true <= estimate.high


def truths(session: Blind, effect: str, estimates: Mapping[str, Estimate],
           model: Model) -> Iterator[tuple[Estimate, float]]:
    """The estimates of a hidden effect's parameters under a `model`, each with the true value.

    A swing is the same a half turn on: of its four parameters size and frequency are compared.
    Curves fitted to a drive's response have no true values. An alignment time is one at the
    reference field, which is another where the session does not state it.
    """
    if effect == 'drive_response':
        return
    for name, hidden in session.hidden[effect].items():
        if name in ('direction_rad', 'phase_rad'):
            continue
        estimate, true = estimates[name], to_si(name, hidden)
        if effect == 'alignment_lag':
            true *= FIELD / model.reference_field
        if name == 'amplitude_um_s':
            true = math.copysign(true, estimate.value)
        yield estimate, true


Given, Judged = TypeVar('Given'), TypeVar('Judged')


def run(cases: Iterable[Given], judge: Callable[[Given], Judged], jobs: int = 2) -> list[Judged]:
    """What `judge` says of the cases, that many at a time on one core each.

    Tells on stderr how far it is.
    """
    from rich.console import Console
    from rich.progress import track

    cases = list(cases)
    with ProcessPoolExecutor(jobs, initializer=_one_core) as pool:
        return list(track(pool.map(judge, cases), 'blind sessions', len(cases),
                          console=Console(stderr=True)))


def _one_core() -> None:
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


# Which cases ------------------------------------------------------------------------------------

def null_cases(count: int) -> list[Case]:
    """Nothing hidden, all kinds of command in turn, rollers every eighth time.

    Sixty of them go to PySINDy too, and a dozen to StochasticForceInference, which takes longer.
    """
    return [
        Case('null', seed, COMMANDS[seed % 4], rolling=seed % 8 == 1,
             rivals=(PYSINDY, SFI)[:(seed < 60) + (seed < 12)])
        for seed in range(count)
    ]


def one_each(card: str, evidence: float, sets: int, first: int,
             effects: Iterable[str] = LISTED) -> list[Case]:
    """Each of the effects that many times, under commands that leave nothing undefined.

    The first of each that is strong goes to the rivals too.
    """
    return [
        Case(card, first + 1000 * k + turn, _wide(effect, k + turn), (effect,), evidence,
             rivals=(PYSINDY, SFI) if card == 'strong' and k == 0 else ())
        for k in range(sets) for turn, effect in enumerate(effects)
    ]


def under_narrow_commands(sets: int, evidence: float) -> list[Case]:
    """Each effect of the library under commands within ±20°, which leave much undefined."""
    return [
        Case('narrow', 50_000 + 1000 * k + seed, 'narrow', (effect,), evidence)
        for k in range(sets) for seed, effect in enumerate(LISTED)
    ]


def two_at_once(count: int, evidence: float) -> list[Case]:
    """Random pairs of effects of catalytic swimmers."""
    rng = np.random.default_rng(7)
    known = [effect for effect in LISTED if effect != 'drive_response']
    return [
        Case('two', 70_000 + k, COMMANDS[k % 3],
             tuple(str(e) for e in rng.choice(known, 2, replace=False)), evidence)
        for k in range(count)
    ]


def power_cases(sets: int) -> list[Case]:
    """A drift about the limit at which theory expects one half to be found."""
    limit = 2 * math.log(2 * 4 * 1800)
    return [
        Case('power', 90_000 + 100 * k + round(10 * part), COMMANDS[k % 2], ('uniform_drift',),
             part * limit)
        for k in range(sets) for part in (0.6, 1.0, 1.5)
    ]


def unlisted_cases(sets: int, evidence: float) -> list[Case]:
    """Each effect that no library has."""
    return one_each('unlisted', evidence, sets, 30_000, UNLISTED)


def _wide(effect: str, turn: int) -> str:
    """The kinds of command in turn, without the narrow ones; rollers are not herded."""
    return COMMANDS[turn % 2 if effect == 'drive_response' else turn % 3]
