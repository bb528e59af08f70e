"""Figure of a session: paths, commands, and rates of the topics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Session
from microbot_ros.session.survey import Survey

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_survey(survey: Survey, session: Session | None, path: Path) -> None:
    """Save a figure of `survey` and `session`; the suffix of `path` gives the format.

    Parameters
    ----------
    survey : Survey
        The survey.
    session : Session or None
        The session; None for none.
    path : Path
        File to write.
    """
    from matplotlib.figure import Figure

    heights = [2.4, 2.4, 0.8 + 0.2 * len(survey.topics)]
    figure = Figure(figsize=(11, sum(heights)), layout='constrained')
    axes = figure.subplot_mosaic([['paths', 'direction'], ['paths', 'size'], ['rates', 'rates']],
                                 height_ratios=heights)
    axes['direction'].sharex(axes['size'])
    if session is not None:
        _draw_paths(axes['paths'], session)
        _draw_commands(axes['direction'], axes['size'], session)
    _draw_rates(axes['rates'], survey)
    figure.suptitle(Path(survey.path).name)
    if path.suffix.lstrip('.').lower() not in figure.canvas.get_supported_filetypes():
        raise InputError(path, 'expected a picture format such as .png, .svg or .pdf')
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


def _draw_paths(axes: Axes, session: Session) -> None:
    for particle in session.tracks.particles:
        x, y = session.tracks.of(particle).position.T * 1e6
        line, = axes.plot(x, y, lw=0.8, label=str(particle))
        axes.plot(x[0], y[0], 'o', ms=4, color=line.get_color())
    axes.set(xlabel='x [µm]', ylabel='y [µm]', title='paths, from the dots')
    axes.set_aspect('equal', 'datalim')
    if len(session.tracks.particles) <= 12:
        axes.legend(title='particle', fontsize='small', loc='upper left', bbox_to_anchor=(1, 1))


def _draw_commands(direction: Axes, size: Axes, session: Session) -> None:
    commands = session.commands
    bx, by = commands.field.T
    on = np.hypot(bx, by) > 0
    angle = np.where(on, np.degrees(np.arctan2(by, bx)), np.nan)
    direction.plot(commands.t, angle, '.', ms=2)
    direction.set(ylabel='direction [°]', ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180),
                  title='commands')
    if commands.frequency is None:
        size.step(commands.t, np.hypot(bx, by) * 1e3, where='post')
        size.set(xlabel='t [s]', ylabel='field [mT]')
    else:
        size.step(commands.t, commands.frequency, where='post')
        size.set(xlabel='t [s]', ylabel='frequency [Hz]')


def _draw_rates(axes: Axes, survey: Survey) -> None:
    names = [topic.name for topic in survey.topics]
    rates = [topic.rate_hz for topic in survey.topics]
    axes.barh(names, rates, color='0.7')
    for row, topic in enumerate(survey.topics):
        said = f' {topic.count} messages, longest gap {topic.longest_gap_s:.3g} s'
        said = said if topic.count > 1 else ' 1 message' if topic.count else ' none'
        axes.text(topic.rate_hz, row, said, va='center', fontsize='small')
    axes.set(xlabel='rate [Hz]', title='topics', xlim=(0, 1.6 * max([*rates, 1.0])))
    axes.invert_yaxis()
