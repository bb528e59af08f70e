"""A thousand switches in a loop at 100 Hz, among all controllers and some faulty on purpose.

A virtual machine stands still now and then, for longer than a tick. So that this is neither
counted as ours nor used as an excuse, a witness of real-time priority watches each processor.
"""

from __future__ import annotations

import gc
import json
import logging
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench._closed_loop import FIELD, VIEW
from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Goals,
    Limits,
    ParticleLostError,
    no_field,
)
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.predictive import PredictiveParameters
from microbot_ros.control.registry import controller_classes
from microbot_ros.control.testkit import controller_input
from microbot_ros.model.model import Model

PERIOD = 0.01
DEADLINE = 0.0035
"""[s] What is late in a switch and in the tick after it costs at most twice that: < a period."""
_WITNESS_PERIOD, _WITNESS_NOTICES = 1e-3, 2e-3

Stalls = list[list[tuple[float, float]]]
"""For each processor the times (begin, end) [s] in which it stood still."""


@dataclass(frozen=True)
class Switched:
    """`missed` ticks, those missed while the machine stood still (`stalled`), and the largest
    step over the slew and field over the limit."""

    missed: int
    stalled: int
    steepest: float
    strongest: float


class _Faulty(Controller):
    interface_version = 1
    summary = 'Faulty on purpose.'

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        return no_field('')


def _raise(*_: Any) -> FieldCommand:
    raise RuntimeError('on purpose')


def _refuse(*_: Any) -> FieldCommand:
    raise ParticleLostError('on purpose')


def _spin(*_: Any) -> FieldCommand:
    while True:
        pass


def _sleep(*_: Any) -> FieldCommand:
    time.sleep(0.05)
    return no_field('')


_FAULTS: dict[str, dict[str, Callable[..., FieldCommand]]] = {
    'raises': {'compute': _raise},
    'nan': {'compute': lambda *_: FieldCommand(np.full(2, np.nan))},
    'too_strong': {'compute': lambda *_: FieldCommand(np.array([1.0, 0.0]))},
    'sleeps': {'compute': _sleep},
    'spins': {'compute': _spin},
    'refuses': {'activate': _refuse},
    'spins_activating': {'activate': _spin},
    'sleeps_deactivating': {'deactivate': _sleep},
}


def switched(count: int = 1000) -> Switched:
    """Two ticks for each switch."""
    logging.getLogger('microbot_ros.control').setLevel(logging.CRITICAL)
    with _undisturbed() as stalls:
        ticks, fields = _loop(2 * count)
    late = _late(ticks, stalls)
    steps = np.hypot(*np.diff(fields, axis=0, prepend=0).T)
    return Switched(late, _late(ticks, []) - late, float(steps.max()) / (_LIMITS.slew * PERIOD),
                   float(np.hypot(*fields.T).max()) / _LIMITS.field)


_LIMITS = Limits(FIELD, 0.3, 50.0)
_GOALS = Goals(np.array([[30e-6, 0], [0, 30e-6], [-30e-6, 0]]))


def _board() -> tuple[ControllerManager, list[str]]:
    """A controller manager, configured, and the names of what it holds."""
    kinds = controller_classes() | {
        name: type(name, (_Faulty,), act) for name, act in _FAULTS.items()}
    manager = ControllerManager({name: kind() for name, kind in kinds.items()}, 'hold',
                        deadline=DEADLINE, patience=0.1)
    for name, kind in kinds.items():
        manager.configure(name, kind.Parameters())
    manager.configure('predictive', PredictiveParameters(budget_ms=2.0))
    gc.collect()
    gc.freeze()  # as the process of the nodes does: a full collection takes longer than a tick
    return manager, list(kinds)


def _loop(count: int) -> tuple[np.ndarray, np.ndarray]:
    """When each tick was due and done (count, 2) [s], and its field (count, 2) [T].

    A tick that is late makes the next ones due later, so that each miss counts once.
    """
    manager, names = _board()
    rng = np.random.default_rng(0)
    ticks, fields = np.empty((count, 2)), np.empty((count, 2))
    due = time.monotonic()
    for k in range(count):
        time.sleep(max(0.0, due - time.monotonic()))
        if k % 2 == 0:
            manager.switch_controller(names[rng.integers(len(names))])
        outcome = manager.tick(controller_input(
            t=k * PERIOD, dt=PERIOD, limits=_LIMITS, workspace=VIEW, goals=_GOALS,
            path=_GOALS.position, joystick=rng.uniform(-1, 1, 2), model=Model(FIELD)))
        fields[k] = math.nan if outcome.command is None else outcome.command.field
        ticks[k] = due, time.monotonic()
        due += PERIOD * max(1, math.ceil((ticks[k, 1] - due) / PERIOD))
    manager.close()
    gc.unfreeze()
    return ticks, fields


def _late(ticks: np.ndarray, stalls: Stalls) -> int:
    """How many periods were missed, apart from what stalls took."""
    missed = 0
    for due, done in ticks[np.diff(ticks)[:, 0] >= PERIOD].tolist():
        stood = max((sum(max(0.0, min(done, end) - max(due, begin)) for begin, end in processor)
                     for processor in stalls), default=0.0)
        missed += int((done - due - stood) / PERIOD)
    return missed


@contextmanager
def _undisturbed() -> Iterator[Stalls]:
    """Real-time priority, where that is allowed, and witnesses on every processor.

    The list is filled at the end.
    """
    stalls: Stalls = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        yield stalls
        return
    witnesses = [subprocess.Popen([sys.executable, '-m', 'bench._switches', str(processor)],
                                  text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
                 for processor in os.sched_getaffinity(0)]
    for witness in witnesses:
        assert witness.stdout is not None
        witness.stdout.readline()
    try:
        yield stalls
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        for witness in witnesses:
            stalls.append(json.loads(witness.communicate('stop\n')[0]))


def _witness(processor: int) -> None:
    """Sleep a millisecond at a time until told to stop; print when that took far longer."""
    import select

    os.sched_setaffinity(0, {processor})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(2))
    print('watching', flush=True)
    stalls, before = [], time.monotonic()
    while not select.select([sys.stdin], [], [], _WITNESS_PERIOD)[0]:
        now = time.monotonic()
        if now - before > _WITNESS_PERIOD + _WITNESS_NOTICES:
            stalls.append((before + _WITNESS_PERIOD, now))
        before = now
    print(json.dumps(stalls))


if __name__ == '__main__':
    _witness(int(sys.argv[1]))
