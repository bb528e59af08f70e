"""Cases of the three families by which discovery is judged, and what became of each."""

from __future__ import annotations

import json
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench._hidden_effects import LISTED
from bench._hidden_suite import ABOVE_FLOOR, COMMANDS, FLUID, Blind, blind
from bench._nuisances import NUISANCES, differing_sizes
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import write_text
from microbot_ros.common.records import Session
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.report.page import write_report
from microbot_ros.model.io.model_file import write_model

EVIDENCE = 100.0
"""λ of an effect in the session without the nuisance: at 40 one in ten would be missed anyway.

It is more where an effect would be near the floor of the instrument, since it must not be named
there."""
_FIRST_SEEDS = {'tuning': 200_000, 'checking': 300_000}


@dataclass(frozen=True)
class Case:
    """One session to judge.

    `family` 'tuning', 'checking' or 'judging'; `kind` is the nuisance or the foreign world, ''
    for a clean session; `seed` with `effects` and `commands` draws the session again. `accepted`
    are names that are right; `film` returns the session.
    """

    family: str
    kind: str
    seed: int
    effects: tuple[str, ...]
    accepted: frozenset[str]
    film: Callable[[Case], Session]
    commands: str = ''

    def __str__(self) -> str:
        hidden = ' + '.join(self.effects) or 'nothing missing'
        return ', '.join(filter(None, (
            f'{self.family} {self.kind}'.strip(), f'seed {self.seed}', self.commands, hidden)))


@dataclass(frozen=True)
class Judged:
    """Result of a case.

    `verdict` of discovery, 'crash' where an exception ended the search or its report, or
    'refused' where the session was not accepted; `established` names; what was `unexplained`;
    `seconds` of CPU of the search; `problem` is the end of a traceback or the refusal.
    """

    case: Case
    verdict: str
    established: frozenset[str] = frozenset()
    unexplained: tuple[str, ...] = ()
    seconds: float = 0.0
    problem: str = ''

    @property
    def false(self) -> bool:
        """Whether a name is established that is not right."""
        return bool(self.established - self.case.accepted)

    @property
    def right(self) -> bool:
        """Whether the effect is established, or with nothing missing the verdict `consistent`."""
        if self.case.effects:
            return bool(self.established & self.case.accepted)
        return self.verdict == 'consistent'

    @property
    def honest(self) -> bool:
        """Whether discovery ended, and nothing that it established is wrong."""
        return self.verdict not in ('crash', 'refused') and not self.false


def judge(case: Case) -> Judged:
    """Film a case, search it, write all that `microbot discover` writes."""
    session = case.film(case)
    began = time.process_time()
    try:
        found = discover([session])
        seconds = time.process_time() - began
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            write_text(folder / 'result.json', json.dumps(found.as_json()))
            write_model(folder / 'model.yaml', found.model, found.particles)
            write_report(folder, found, [session], [])
    except InputError as error:
        return Judged(case, 'refused', problem=str(error), seconds=time.process_time() - began)
    except Exception:  # the figure counts whatever ends a search
        last = traceback.format_exc().strip().splitlines()
        return Judged(case, 'crash', problem=' | '.join(line.strip() for line in last[-3:]),
                      seconds=time.process_time() - began)
    return Judged(
        case, found.verdict,
        frozenset(e.id for e in found.effects if e.status == 'established'),
        tuple(residual.against for residual in found.unexplained), seconds)


def with_nuisance(drawn: Blind, name: str, seed: int) -> Session:
    """Return the session of a `drawn` case with the nuisance called `name`.

    `seed` draws the nuisance.
    """
    nuisance = NUISANCES[name]
    rng = np.random.default_rng([seed, *name.encode()])
    experiment = drawn.experiment
    if nuisance.sizes:
        experiment = replace(experiment, swarm=differing_sizes(rng, experiment.swarm, FLUID))
    session, _ = experiment.film(drawn.hidden, world=nuisance.world)
    return nuisance.overlay(rng, replace(session, name=f'{drawn.session.name}-{name}'))


def tuning_cases(count: int) -> list[Case]:
    """Clean sessions of the known worlds: `count` with nothing missing, as many with an effect."""
    return [_case('tuning', '', effect, turn)
            for turn in range(count) for effect in ('', _effect(5 * turn))]


def checking_cases(count: int) -> list[Case]:
    """Each nuisance `count` times with nothing missing, and as often beside one effect."""
    return [
        _case('checking', name, effect, 100 * k + turn)
        for turn in range(count) for k, name in enumerate(NUISANCES)
        for effect in ('', _effect(k + 7 * turn))]


def _effect(turn: int) -> str:
    names = sorted(LISTED)
    return names[turn % len(names)]


def _case(family: str, kind: str, effect: str, turn: int) -> Case:
    seed = _FIRST_SEEDS[family] + turn + (50_000 if effect else 0)
    commands = COMMANDS[turn % (2 if effect == 'drive_response' else 3)]
    effects = (effect,) if effect else ()
    return Case(family, kind, seed, effects, frozenset(effects), _film, commands)


def _film(case: Case) -> Session:
    evidence = EVIDENCE if case.effects else 0.0
    while True:
        drawn = blind(case.seed, case.commands, case.effects, evidence, count=_count(case))
        if not drawn.near_floor:
            break
        evidence *= ABOVE_FLOOR**2
    return with_nuisance(drawn, case.kind, case.seed) if case.kind else drawn.session


def _count(case: Case) -> int | None:
    """Identities are exchanged between several particles."""
    return 4 if case.kind == 'exchanged identities' else None
