"""The next experiment: which command would distinguish the remaining explanations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.discovery.processes import Run, serially
from microbot_ros.discovery.result import NextExperiment
from microbot_ros.estimation.likelihood.joint import Whitening
from microbot_ros.estimation.likelihood.model_fit import ModelFit, evaluate, maximise
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.model.first_order import simulate
from microbot_ros.model.increments import as_vectors
from microbot_ros.model.model import Model, ParticleParameters

DECIDES = 10.0
"""Expected difference in log likelihood that settles a question: odds of 20 000 to 1.

Choice: a smaller value recommends recordings that may not decide, a larger one longer recordings.
"""

TRIAL = 60.0
"""Duration [s] of a simulated trial experiment.

Choice: several rounds of most plans; a longer trial costs time in proportion.
"""

LONGEST = 120.0
"""Duration [min] above which no command is recommended.

Choice: about what a sample lasts under the microscope.
"""


@dataclass(frozen=True)
class _Plan:
    """A command: words, turns [rad], relative field levels and range of holding times [s]."""

    words: str
    turns: tuple[float, ...]
    levels: tuple[float, ...] = (1.0,)
    hold: tuple[float, float] = (2.0, 6.0)


_MENU = (
    _Plan('steps in all directions, each held for 2 to 6 s', (2.4, -1.3, 0.7, -2.9, 1.8, -0.4)),
    _Plan('short steps in all directions, each held for 0.3 to 1 s',
          (2.4, -1.3, 0.7, -2.9, 1.8, -0.4), hold=(0.3, 1.0)),
    _Plan('steps in all directions at full and at a third of the field magnitude',
          (2.4, -1.3, 0.7, -2.9, 1.8, -0.4), levels=(1.0, 1 / 3, 1 / 3, 1.0, 1.0, 1 / 3, 1.0)),
    _Plan('turns by 175° and by 30° in both senses, each held for 2 s',
          (3.05, 0.52, -3.05, -0.52), hold=(2.0, 2.0)),
    _Plan('straight lines forth and back, 20 s each, twice, at right angles',
          (np.pi, np.pi / 2), hold=(20.0, 20.0)),
    _Plan('a square driven in both senses, 5 s per side', (1.571, 1.571, 1.571, 1.571, -1.571,
                                                        -1.571, -1.571, -1.571), hold=(5.0, 5.0)),
)
"""Candidate plans. Choice: each excites effects that the others excite weakly."""


def next_experiment(fit: ModelFit, rivals: Sequence[Model],
                    run: Run = serially) -> NextExperiment | None:
    """Return the plan that best distinguishes a fit from its rivals, and its duration.

    Each plan is simulated with the particles of the last session under the fitted model. Its value
    is the smallest expected difference in log likelihood over the rivals, each with its
    parameters, v and φ at their best.

    Parameters
    ----------
    fit : ModelFit
        Fit of the current model.
    rivals : sequence of Model
        Models that explain the data as well.
    run : Run, optional
        Distributes the plans.

    Returns
    -------
    NextExperiment or None
        None without rivals. If no plan helps, the sentence says so and `minutes` is infinite.
    """
    if not rivals:
        return None

    def told(plan: _Plan) -> float:
        trial = _trial(fit, plan)
        return min(_separation(fit, trial, rival) for rival in rivals)

    worth = list(run(told, _MENU))
    best = int(np.argmax(worth))
    minutes = TRIAL / 60 * DECIDES / max(worth[best], 1e-9)
    if minutes > LONGEST:
        return NextExperiment(
            'no command distinguishes these: measure one of them separately, with a '
            'calibration grid for the camera, a field probe for the coils, passive beads for '
            'the flow', np.inf)
    span = f'{round(minutes)} min' if minutes > 1 else 'a minute'
    return NextExperiment(f'record {_MENU[best].words}, for {span}', float(minutes))


def _trial(fit: ModelFit, plan: _Plan) -> PreparedSession:
    """Return what the fitted model expects of the last session's particles under a plan."""
    last = fit.session_fits[-1]
    e = last.session
    commands = _commands(plan, e.commands)
    tracks = e.main
    particles = ParticleParameters.from_velocity_phasor(
        e.ids[tracks], last.velocity_phasor[tracks])
    first = np.isfinite(e.causal_positions[:, tracks, 0]).argmax(axis=0)
    start = fit.model.true_position(e.causal_positions[first, tracks])
    times = np.arange(0.0, TRIAL, max(e.interval, 1 / 30))
    places = fit.model.observe(simulate(fit.model, particles, commands, times, start))
    z = places[..., 0] + 1j * places[..., 1]
    return replace(
        e, ids=e.ids[tracks], times=times, z=z, pieces=np.ones(z.shape, int),
        causal_positions=as_vectors(z), commands=commands)


def _commands(plan: _Plan, used: Commands) -> Commands:
    """Return the commands of a plan at the session's field strength and frequencies."""
    strength = float(np.hypot(*used.field.T).max())
    rng = np.random.default_rng(0)
    count = int(TRIAL / plan.hold[0]) + 1
    t = np.append(0.0, np.cumsum(rng.uniform(*plan.hold, count)))[:count]
    turns = np.array([plan.turns[k % len(plan.turns)] for k in range(count)])
    angle = np.cumsum(turns)
    levels = np.array([plan.levels[k % len(plan.levels)] for k in range(count)])
    field = (strength * levels * np.exp(1j * angle)).astype(complex)
    frequency = None
    if used.frequency is not None:
        driven = np.unique(np.abs(used.frequency[used.frequency != 0]))
        frequency = rng.choice(driven, count)
    return Commands(t, as_vectors(field), frequency)


def _separation(fit: ModelFit, trial: PreparedSession, rival: Model) -> float:
    """Return ½‖W(μ − μ')‖² of the fitted model and a rival fitted to the expected data."""
    noise = fit.session_fits[-1]
    start = evaluate(rival, [trial], [Whitening(noise.whitening.noise_ratio)])
    best = maximise(start, 8)
    return best.session_fits[0].residual_sum_of_squares / noise.diffusion / 2
