"""Files of a response: CSV, JSON, figures and a self-contained page."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from microbot_ros.discovery.report import words as report_words
from microbot_ros.discovery.report.figures import embedded
from microbot_ros.response import words
from microbot_ros.response.figure import draw
from microbot_ros.response.plateaus import Measured
from microbot_ros.response.result import Group, Level, Response, Row

_TEMPLATE = Path(__file__).with_name('page.html')
_QUANTITIES = {'speed_um_s': ('speed', 1e6), 'across_um_s': ('across', 1e6),
               'slip_rad': ('slip', 1.0), 'turning_rad_s': ('turning', 1.0)}
"""Field of a level and its factor from SI, by column; the factors are those of the units."""
_PARTS = {'': 'value', '_std': 'std', '_low_95': 'low', '_high_95': 'high'}


def rows(found: Response) -> list[dict[str, Any]]:
    """Return a row for every robot and level of the response `found`, in the units of the names.

    Unknown values are None.

    Parameters
    ----------
    found : Response
        The response.

    Returns
    -------
    list of dict of str to object
        One dictionary per row.
    """
    return [_row(found, row) for row in found.rows]


def _row(found: Response, row: Row) -> dict[str, Any]:
    plateau, (column, factor, _) = row.plateau, words.COLUMNS[found.against]
    cells: dict[str, Any] = {
        'session': plateau.session, 'particle': plateau.particle, 'kind': row.kind or None,
        'day': row.day or None, 'rig': row.rig or None, column: plateau.level * factor}
    for name, (field, scale) in _QUANTITIES.items():
        one: Measured = getattr(plateau, field)
        cells |= {name + part: _finite(getattr(one, key) * scale) for part, key in _PARTS.items()}
    return cells | {
        'n': plateau.n, 'frames': plateau.frames, 'visits': plateau.visits,
        'seconds': plateau.seconds, 'left_out': plateau.left_out, 'definition': found.definition}


def as_json(found: Response) -> dict[str, Any]:
    """Return the response `found` as `response.json`; null if unknown.

    Parameters
    ----------
    found : Response
        The response.

    Returns
    -------
    dict of str to object
        Content of the file.
    """
    return {
        'sentence': words.summary(found), 'against': found.against,
        'definition': found.definition, 'difference': words.difference(found),
        'left_out': words.exclusions(found),
        'unlike': [{'session': one.robot[0], 'particle': one.robot[1], 'kind': one.kind,
                    'ratio': one.ratio, 'sentence': words.unlike(one)} for one in found.unlike],
        'kinds': [_group(found, group) for group in found.kinds],
        'days': [_group(found, group) for group in found.days],
        'tables_over_motion': {
            kind: [{words.COLUMNS[found.against][0]: level * words.COLUMNS[found.against][1],
                    'ratio': ratio} for level, ratio in of]
            for kind, of in found.compared.items()},
        'delays_s': found.delays, 'without_plateaus': found.without,
        'plateaus': rows(found)}


def _group(found: Response, group: Group) -> dict[str, Any]:
    curve, (column, factor, _) = group.curve, words.COLUMNS[found.against]
    law: dict[str, Any] | None = None
    if curve is not None:
        law = {
            'effect': 'drive_response', 'cut_in_hz': _estimate(curve.cut_in),
            'slip': _estimate(curve.slip), 'step_out_hz': _estimate(curve.step_out),
            'step_out_steepness': curve.effect.step_out_steepness,
            'steps_out': group.steps_out, 'scatter': curve.scatter,
            'robots_stepping_out': [
                {'session': name, 'particle': particle, 'step_out_hz': _estimate(one)}
                for (name, particle), one in group.stepping_out.items()],
            'gains': [{'session': name, 'particle': particle, 'gain_um_s_hz': gain * 1e6}
                      for (name, particle), gain in zip(
                          sorted(group.robots), curve.gains.tolist(), strict=True)]}
    return {
        'kind': group.kind or None, 'day': group.day or None, 'robots': len(group.robots),
        'levels': [{column: one.level * factor, **_level(one)} for one in group.levels],
        'law': law}


def _level(one: Level) -> dict[str, Any]:
    return {'speed_um_s': {key: _finite(value * 1e6) for key, value in (
        ('value', one.speed.value), ('std', one.speed.std), ('low_95', one.speed.low),
        ('high_95', one.speed.high), ('between_robots', one.between))}, 'n': one.robots}


def _estimate(one: Measured) -> dict[str, float | None]:
    return {'value': _finite(one.value), 'low_95': _finite(one.low), 'high_95': _finite(one.high)}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def write(found: Response, folder: Path) -> None:
    """Write `response.csv`, `.json`, `.png`, `.pdf` and `.html` of `found` into `folder`.

    Parameters
    ----------
    found : Response
        The response.
    folder : Path
        Folder for the files.
    """
    table = rows(found)
    (folder / 'response.csv').write_text(_csv(table), encoding='utf-8')
    text = json.dumps(as_json(found), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / 'response.json').write_text(text + '\n', encoding='utf-8')
    figure = draw(found)
    figure.savefig(folder / 'response.png', dpi=300)
    figure.savefig(folder / 'response.pdf', metadata={'CreationDate': None})
    (folder / 'response.html').write_text(page(found, embedded(figure)), encoding='utf-8')


def _csv(table: list[dict[str, Any]]) -> str:
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(table[0]), lineterminator='\n')
    writer.writeheader()
    for cells in table:
        writer.writerow({name: f'{value:.9g}' if isinstance(value, float) else value
                         for name, value in cells.items()})
    return stream.getvalue()


def page(found: Response, figure: str) -> str:
    """Return the response `found` as self-contained HTML, with its `figure` as a data address.

    Parameters
    ----------
    found : Response
        The response.
    figure : str
        Data address of the figure.

    Returns
    -------
    str
        HTML.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {'number': report_words.number}
    environment.globals |= {'finite': np.isfinite, 'degrees': np.degrees}
    template = environment.from_string(_TEMPLATE.read_text(encoding='utf-8'))
    _, factor, unit = words.COLUMNS[found.against]
    return template.render(
        found=found, figure=figure, summary=words.summary(found), factor=factor, unit=unit,
        difference=words.difference(found), exclusions=words.exclusions(found),
        unlike=[words.unlike(one) for one in found.unlike], versions=report_words.versions())
