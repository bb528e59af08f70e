"""What robots of a kind have in common, in real recordings: effects that are fitted to the other
robots of a kind predict the held-out blocks of one (docs/explanation/real_sessions.md).

Speeds are taken as steady. Gain, φ and noise are always the robot's own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from bench.figure import Figure
from microbot_ros.discovery.check.held_out import BLOCKS, _errors, _turns
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.check.score_tests import squared_floor
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.discovery.result import HORIZON
from microbot_ros.estimation.likelihood.model_fit import ModelFit, evaluate, fit_noise, maximise
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.model.effects.field.amplifier_deadband import AmplifierDeadband
from microbot_ros.model.effects.field.coil_gain_mismatch import CoilGainMismatch
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.effects.velocity.drive_response import DriveResponse
from microbot_ros.model.model import Model
from microbot_ros.session.spreadsheets.assemble import import_session
from microbot_ros.session.spreadsheets.sheets import Answers
from microbot_ros.session.tables.folder import NOMINAL_FIELD

_DATA = Path(__file__).parents[1].parent / 'shared' / 'data' / 'speed_vs_frequency'
_TABLES = {
    'spheres': ('spheres_20um/goodsheet2',),
    'dimers': tuple(f'dimers_20um/20um{name}' for name in (
        'Dimer4', 'Dimer5', 'Dimer6', 'dimerbigmess')),
    'cellbots': tuple(f'cellbots/{name}' for name in (
        '1botcellbot', '1botcellbot3', '1botcellbotbad', '2botcellbot1', '3botcellbot')),
}
_RIG = ('command_delay', 'coil_gain_mismatch', 'amplifier_deadband')
_SHAPE = ('cut_in', 'slip', 'cut_in_steepness', 'step_out_steepness')
_STARTS = [(corner, slip) for corner in (2.0, 8.0, 15.0) for slip in (0.4, 0.9)]
"""Step-out [Hz] and slip of the drive responses from which a fit starts."""
_ROUNDS = 3
"""Most rounds in which effects and noise are fitted in turn."""


def figures() -> Iterator[Figure]:
    """Three of each kind, where its recordings are."""
    for kind in _TABLES if _DATA.is_dir() else ():
        yield from _of_kind(kind)


def _of_kind(kind: str) -> Iterator[Figure]:
    robots = [*_robots(kind)]
    own = [_fitted_alone(one) for one in robots]
    gaps = np.sum([_gaps(k, robots, own) for k in range(len(robots))], axis=0)
    for name, gap, target in zip(
            ('all effects', 'all but the step-out', 'all but the drive response'), gaps[1:-1],
            ('≤ 1.3', '', '≤ 1.3'), strict=True):
        ratio = float(np.sqrt(gap / gaps[-1]))
        yield Figure(
            35, f'{kind}, {len(robots)} parts: {name} from the others, gap over that of its own '
            f'effects; share closed {(gaps[0] - gap) / (gaps[0] - gaps[-1]):.1%}', ratio, '×',
            target, 'own effects', not target or ratio <= 1.3)


def _robots(kind: str) -> Iterator[PreparedSession]:
    """Yield the recordings of a kind; a single one is parted into two halves of its robots."""
    for table in _TABLES[kind]:
        (one,), _ = check_sessions([import_session(_DATA / f'{table}.xlsx', Answers())[0]])
        if len(_TABLES[kind]) > 1:
            yield one
            continue
        for half in (slice(0, None, 2), slice(1, None, 2)):
            yield replace(
                one, ids=one.ids[half], z=one.z[:, half], phi=None,
                pieces=np.ascontiguousarray(one.pieces[:, half]),
                causal_positions=one.causal_positions[:, half])


def _fitted_alone(robot: PreparedSession) -> ModelFit:
    """Return the likeliest fit of all effects to one robot."""
    first = fit_first_order([robot])
    model = first.model
    for effect in (CommandDelay(0.11), CoilGainMismatch(1.5),
                   AmplifierDeadband(0.13 * NOMINAL_FIELD)):
        model = model.with_effect(effect)
    return _best([_fit(first.under(model.with_effect(DriveResponse(0.3, slip, corner))))
                  for corner, slip in _STARTS])


def _best(fits: Sequence[ModelFit]) -> ModelFit:
    return min(fits, key=lambda one: one.cost)


def _fit(fit: ModelFit, fixed: Collection[str] = ()) -> ModelFit:
    """Maximise the likelihood, but for the effects or parameters `fixed`."""
    held = [k for k, (name, parameter) in enumerate(fit.model.parameters)
            if name in fixed or parameter.field in fixed]
    for _ in range(_ROUNDS):
        # An array of indices holds all of them.
        better = fit_noise(maximise(fit, held=cast(int, held) if held else None), near=True)
        if fit.cost - better.cost < 0.1:
            return better
        fit = better
    return fit


def _predictors(rest: PreparedSession, others: Model, own: Model) -> list[ModelFit]:
    """Return first order, three of `others`, and all effects of the robot, fitted to `rest`."""
    first = fit_first_order([rest])
    theirs, response = others.effect('drive_response'), own.effect('drive_response')
    assert isinstance(theirs, DriveResponse)
    assert isinstance(response, DriveResponse)
    plain = others.without('drive_response')

    def fitted(starts: Sequence[DriveResponse], fixed: Collection[str]) -> ModelFit:
        return _best([_fit(first.under(plain.with_effect(one)), fixed) for one in starts])

    return [first, fit_noise(first.under(others)),
            fitted((theirs, replace(theirs, step_out=response.step_out)), (*_RIG, *_SHAPE)),
            fitted((theirs, response), _RIG), _fit(first.under(own))]


def _gaps(k: int, robots: Sequence[PreparedSession], own: Sequence[ModelFit]) -> np.ndarray:
    """Return squared errors beyond the floor (5,), in units of it, of the `k`-th robot."""
    others = [one for n, one in enumerate(robots) if n != k]
    noise = [one.session_fits[0].whitening for n, one in enumerate(own) if n != k]
    theirs = _best([_fit(evaluate(one.model, others, noise))
                    for n, one in enumerate(own) if n != k]).model
    robot, turns = robots[k], _turns(robots[k], HORIZON)
    rows = np.concatenate([
        _errors(_predictors(robot.only(turns != block), theirs, own[k].model), 0, robot,
                turns == block, HORIZON) for block in range(BLOCKS)])
    floor = squared_floor(own[k].session_fits[0], HORIZON)
    return np.maximum(rows[:, 1:].mean(axis=0) - floor, 0.0) / floor
