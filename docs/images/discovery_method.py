"""Draw `discovery_method.png` with `python docs/images/discovery_method.py` (about a minute).

The session is that of `config/scenario_lag.yaml`, in which an alignment lag and a uniform drift
are hidden.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.hypotheses import (
    WORTH,
    Candidate,
    fit_first_order,
    likelier_than_not,
)
from microbot_ros.discovery.result import FIRES, Discovery
from microbot_ros.discovery.search import search
from microbot_ros.discovery.verdict import enough
from microbot_ros.estimation.likelihood.model_fit import ModelFit, fit_sessions
from microbot_ros.estimation.likelihood.prepared_session import prepare
from microbot_ros.model.effects import EFFECTS
from microbot_ros.virtual_rig.scenario import read_scenario
from microbot_ros.virtual_rig.simulation import run

_SCENARIO = Path(__file__).parents[2] / 'config' / 'scenario_lag.yaml'
_SHOWN = 6
_GREY, _BLUE, _ORANGE = '0.7', '#0072b2', '#d55e00'


def _candidates(fit: ModelFit) -> list[Candidate]:
    """Return the effects that a `fit` does not have, the likeliest first."""
    present = {effect.id for effect in fit.model.effects}
    found = search(fit, [name for name in EFFECTS if name not in present])
    return sorted(map(Candidate.of, found), key=lambda one: -one.evidence)


def _draw_evidence(axes: Axes, title: str, candidates: Sequence[Candidate]) -> None:
    """Draw the log evidence of the likeliest `candidates`, with both thresholds."""
    best = candidates[:_SHOWN][::-1]
    evidence = np.array([max(one.evidence, 0.5) for one in best])
    colours = [_BLUE if one.evidence >= enough() else _GREY for one in best]
    axes.barh([one.id.replace('_', ' ') for one in best], evidence, color=colours)
    axes.axvline(likelier_than_not() + WORTH, color='black', linestyle=':', linewidth=1)
    axes.axvline(enough(), color='black', linewidth=1)
    axes.set(title=title, xlabel='log evidence', xscale='log', xlim=(0.5, 9000))


def _draw_maps(axes: Axes, result: Discovery) -> None:
    """Draw the p-value of each residual map before and after the effects were added."""
    for maps, colour, label in ((result.maps_before, _ORANGE, 'first-order model'),
                                (result.maps_after, _BLUE, 'with both effects')):
        worst: dict[str, float] = {}
        for one in maps:
            worst[one.against] = min(worst.get(one.against, 1.0), one.p_value)
        axes.plot(np.maximum(list(worst.values()), 1e-40), list(worst), 'o', color=colour,
                  label=label)
    axes.axvline(FIRES, color='black', linewidth=1)
    axes.set(title='3  Test the residual', xlabel='p-value of each map', xscale='log',
             xlim=(1e-42, 1e3))
    axes.legend(fontsize='small')


def _draw_gap(axes: Axes, result: Discovery) -> None:
    """Draw the root mean square error of the held-out prediction [µm] beside the noise floor."""
    gap = result.gap
    errors = 1e6 * np.hypot([gap.before, gap.after, 0.0], gap.floor)
    axes.bar(['first-order\nmodel', 'with both\neffects', 'noise\nfloor'], errors,
             color=[_ORANGE, _BLUE, _GREY])
    axes.set(title='4  Predict held-out data', ylabel='error 1 s ahead (µm)')


def main() -> None:
    """Simulate the session, search it, and draw the four steps."""
    mpl.use('Agg')
    scenario, particles = read_scenario(_SCENARIO)
    session = run(scenario, particles, str(_SCENARIO))
    prepared = [prepare(session)]
    first = _candidates(fit_first_order(prepared))
    second = _candidates(fit_sessions(first[0].found.fit.model, prepared))
    result = discover([session])
    figure, axes = plt.subplots(1, 4, figsize=(15, 3.6), layout='constrained')
    _draw_evidence(axes[0], '1  Compare effects', first)
    _draw_evidence(axes[1], '2  Add one, compare again', second)
    _draw_maps(axes[2], result)
    _draw_gap(axes[3], result)
    figure.savefig(Path(__file__).with_suffix('.png'), dpi=100)


if __name__ == '__main__':
    main()
