"""Model-predictive control: plan with the extended model, and replan while executing."""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.extras import require
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    ANY_GOALS,
    NO_IDS,
    ControllerInput,
    FieldCommand,
    ModelError,
    Progress,
    Workspace,
)
from microbot_ros.control.planning.manoeuvre import Task, search
from microbot_ros.control.planning.plan import Plan, Rollout, Swarm, roll_out, with_lags
from microbot_ros.control.planning.refine import cost, improve
from microbot_ros.control.planning.shared import as_complex
from microbot_ros.control.plugins.ensemble import Ensemble, SharedFieldParameters
from microbot_ros.model.model import Model

# Without its solver this controller is not available; the others are.
require('predictive')

WORTH = 0.7
"""Choice: another plan replaces the present one if it costs less than this part of it."""
SEARCH_EVERY = 6
"""Choice: ticks between searches for another plan while one is executed."""
SEARCHED_AT_ONCE = 2
"""Choice: particles for which one tick searches all plans; for more it searches a part."""
TRUST = 0.1
"""Choice: part of the difference to a measured heading that is adopted at each tick."""

NO_MODEL = 'needs a model: set model_file to a model.yaml of `microbot discover`'


@dataclass(frozen=True)
class PredictiveParameters(SharedFieldParameters):
    """Limits and weights of the task, and particle data that the model file lacks."""

    alignment_times_s: list[float] = setting(
        [0.0], 'Alignment time of particles 0, 1, 2, … at the reference field; 0 or missing: the '
               'value of the model.', lower=0.0, upper=30.0)
    obstacles_um: list[float] = setting(
        [0.0, 0.0, 0.0], 'x, y and radius of each obstacle, in sequence; particles keep margin_um '
                         'from them; radius 0: no obstacle.',
        lower=-10000.0, upper=10000.0)
    impatience_um_s: float = setting(
        0.1, 'Final error that counts as much as one second.', lower=0.0, upper=10.0)
    wander_per_s: float = setting(
        0.011, 'Rotational diffusion of the particles [rad²/s].', lower=0.0, upper=10.0)
    budget_ms: float = setting(
        4.0, 'Computing time per tick after which no further step is started.',
        lower=0.5, upper=100.0)


class Predictive(Ensemble):
    """Brings particles as near to all goals as the extended model allows, past obstacles.

    If lags differ between particles, plans turn them, let them coast apart without a field and
    bring them on together. Each tick improves the remaining plan by quadratic programmes, as many
    as time allows; from time to time, and at the end of the plan, others are searched for. In
    between, and if no plan is worth its time, it acts as `ensemble`. `clock` [s] measures the
    computing time.

    Parameters
    ----------
    clock : callable
        Function that returns the time [s].
    """

    interface_version = 1
    summary = 'Drive all particles to their goals by planning with the full model.'
    takes = ANY_GOALS
    Parameters = PredictiveParameters
    repeatable = False

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__()
        self._clock = clock

    def reset(self) -> None:
        """Forget goals, plan and headings."""
        super().reset()
        self._forget()

    def _forget(self) -> None:
        self._plan: Plan | None = None
        self._ids = NO_IDS
        self._heading = np.empty(0, complex)
        self._history: deque[tuple[float, np.ndarray]] = deque(maxlen=64)
        self._ticks = self._looks = 0
        self._step_time = 1e-3

    def configure(self, parameters: Any) -> None:
        """Take `parameters` and load solver and integrator, which takes longer than a tick."""
        import osqp  # noqa: F401
        from scipy import sparse  # noqa: F401

        if len(parameters.obstacles_um) % 3:
            raise ValueError('obstacles_um must be x, y, radius of each, received '
                             f'{len(parameters.obstacles_um)} numbers')
        super().configure(parameters)
        _warm_up()

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ModelError for `inputs` without a model."""
        super().activate(inputs)
        if inputs.model is None:
            raise ModelError(NO_MODEL)
        self._forget()

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return the first field of the plan for `inputs`."""
        begun = self._clock()
        model, p = inputs.model, self.parameters
        if model is None:
            raise ModelError(NO_MODEL)
        if self._assignment.update(inputs):
            self._plan = None
        rows, goals = self._assignment.pairs(inputs)
        known = inputs.learned(p.learn_phi_std_rad)[rows] & (inputs.speed[rows] > 0)
        if not len(rows) or not known.all():
            self._forget()
            return super().compute(inputs)
        lags = p.alignment_times_s
        # v and φ are present values, so changes over time start now. The phase of a periodic drift
        # belongs to the start of some recording.
        models = with_lags(model.without_swings(), [
            lags[k] if 0 <= k < len(lags) else 0.0 for k in inputs.ids[rows].tolist()])
        swarm = self._follow(inputs, rows, Swarm(
            inputs.ids[rows], as_complex(inputs.expected[rows]),
            inputs.speed[rows] * np.exp(1j * inputs.phi[rows]),
            self._heading, models, inputs.delay))
        task = self._task(inputs, goals)
        self._plan = plan = self._choose(inputs, swarm, task)
        if plan is None:
            return super().compute(inputs)
        return self._carry_out(swarm, task, plan, begun)

    def _carry_out(self, swarm: Swarm, task: Task, plan: Plan, begun: float) -> FieldCommand:
        """Improve the plan while there is time, and return its first field."""
        end = begun + units.to_si('budget_ms', self.parameters.budget_ms)
        plan, rollout = self._refine(swarm, task, plan, end)
        self._plan = plan
        error = float(np.sqrt(np.mean(np.abs(rollout.position[-1] - task.goal) ** 2)))
        distance = float(np.sqrt(np.mean(np.abs(swarm.position - task.goal) ** 2)))
        message = (f'{len(task.goal)} particles {distance * 1e6:.1f} µm from their goals, '
                   f'{error * 1e6:.1f} µm in {plan.length:.1f} s')
        return FieldCommand(plan.field[0], progress=Progress(message, False, distance),
                            particles=self._ids)

    def _refine(self, swarm: Swarm, task: Task, plan: Plan, end: float) -> tuple[Plan, Rollout]:
        """Improve step by step, while another step is expected to finish by `end` [s]."""
        rollout = roll_out(swarm, plan, task.limit)
        self._step_time *= 0.99  # so that a step that once took too long is tried again later
        now = self._clock()
        longest = 2 * (end - now)
        while now + self._step_time < end:
            better, rollout = improve(swarm, plan, task, rollout, (end - now) / 2)
            before, now = now, self._clock()
            self._step_time = max(min(now - before, longest), self._step_time)
            if better is plan:
                break
            plan = better
        return plan, rollout

    def _choose(self, inputs: ControllerInput, swarm: Swarm, task: Task) -> Plan | None:
        """Return the remaining plan, or a clearly better one; None: no plan."""
        plan = None if self._plan is None else self._plan.after(inputs.dt)
        if plan is not None and not len(plan.duration):
            plan = None
        self._ticks += 1
        if plan is not None and self._ticks % SEARCH_EVERY:
            return plan
        parts = math.ceil(len(task.goal) / SEARCHED_AT_ONCE)
        other = search(swarm, task, self._looks % parts, parts)
        self._looks += 1
        price = cost(swarm, other, task, roll_out(swarm, other, task.limit))
        if plan is None:
            waiting = float(np.mean(np.abs(task.goal - swarm.position) ** 2)) * 1e12
        else:
            waiting = cost(swarm, plan, task, roll_out(swarm, plan, task.limit))
        return other if price < WORTH * waiting else plan

    def _task(self, inputs: ControllerInput, goals: np.ndarray) -> Task:
        p = self.parameters
        margin = units.to_si('margin_um', p.margin_um)
        x, y, radius = units.to_si('obstacles_um', np.array(p.obstacles_um)).reshape(-1, 3).T
        solid = radius > 0
        view = inputs.workspace
        return Task(
            as_complex(goals), min(units.to_si('field_mT', p.field_mT), inputs.limits.field),
            Workspace(view.low + margin, view.high - margin),
            (x + 1j * y)[solid], radius[solid] + margin,
            units.to_si('impatience_um_s', p.impatience_um_s), p.wander_per_s)

    def _follow(self, inputs: ControllerInput, rows: np.ndarray, swarm: Swarm) -> Swarm:
        """Return the swarm with its headings at the time when this command takes effect.

        They follow the model under the last command, corrected towards the measured ones, which
        are older by exposure and delay.
        """
        ids = inputs.ids[rows]
        measured = np.exp(1j * (inputs.theta[rows] - inputs.phi[rows]))
        seen = np.isfinite(measured)
        if not np.array_equal(ids, self._ids):
            field = complex(*inputs.field.tolist())
            along = field / abs(field) if field else 1 + 0j
            self._ids, self._heading = ids, np.where(seen, measured, along)
            self._history.clear()
        elif inputs.dt > 0:
            last = dataclasses.replace(swarm, heading=self._heading)
            _, edges = last.paths(np.array([inputs.dt]), inputs.field[None, None])
            self._heading = edges[-1, :, 0]
        exposed = inputs.t - inputs.age
        then = next((h for t, h in reversed(self._history) if t <= exposed), None)
        if then is not None:
            off = np.where(seen, np.angle(np.where(seen, measured, 1) / then), 0.0)
            self._heading = self._heading * np.exp(1j * TRUST * off)
            self._history = deque(
                ((t, h * np.exp(1j * TRUST * off)) for t, h in self._history), maxlen=64)
        self._history.append((inputs.t + inputs.delay, self._heading))
        return dataclasses.replace(swarm, heading=self._heading)


@functools.cache
def _warm_up() -> None:
    """Make one plan, so that code is compiled and loaded once per process."""
    swarm = Swarm(np.arange(2), np.zeros(2, complex), np.array([1e-6, 1e-6j]), np.ones(2, complex),
                  with_lags(Model(1e-3), [0.1, 0.3]), 0.0)
    view = Workspace(np.array([-1e-4, -1e-4]), np.array([1e-4, 1e-4]))
    task = Task(np.array([1e-5, 1e-5j]), 1e-3, view, np.empty(0), np.empty(0), 1e-7, 0.01)
    plan = search(swarm, task)
    improve(swarm, plan, task, roll_out(swarm, plan, task.limit), 1.0)
