"""The page on the repeated experiment: one file, pictures inside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2

from microbot_ros import __version__
from microbot_ros.virtual_rig.paper_experiment import FIELD
from microbot_ros.virtual_rig.paper_figures import LABELS, embedded

_TEMPLATE = Path(__file__).with_name('paper_page.html')
_SOLVERS = {'first_order': 'first-order', 'newton_stokes': 'Newton–Stokes'}


def page(summary: dict[str, Any], trajectories: bytes, errors: bytes) -> str:
    """The page for a summary (`paper_summary.summarise`) and the two figures as PNGs."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(_TEMPLATE.read_text(encoding='utf-8'))
    stokes, rotation, _, first = summary['run_time_s'].values()
    return template.render(
        s=summary, c=summary['constants'], m=summary['magnetic_force'],
        own=summary['rmse_um']['first_order']['own'],
        stokes_s=stokes, rotation_s=rotation, first_s=first, labels=LABELS, solvers=_SOLVERS,
        field_mT=f'{FIELD * 1e3:g}', trajectories=embedded(trajectories), errors=embedded(errors),
        version=__version__)
