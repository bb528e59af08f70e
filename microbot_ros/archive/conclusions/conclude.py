"""Conclusions on an archive as a whole, from its results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.archive.conclusions.quantities import (
    LABELS,
    NAMES,
    Quantity,
    Unlike,
    drifting,
    of_sessions,
    quantities,
    unlike_the_others,
)
from microbot_ros.archive.conclusions.random_effects import Spread, Trend
from microbot_ros.archive.conclusions.recurring import Recurring, proxies, recurring_effects
from microbot_ros.archive.imports import imported
from microbot_ros.archive.store import Archive
from microbot_ros.archive.table import rows

_MULTIPLE = 1.5
"""Ratio of a speed to the others' from which a wrong scale is suggested. Choice: objectives differ
by factors of 2, robots of one kind by 20 %."""


@dataclass(frozen=True)
class Conclusions:
    """Conclusions on an archive. Sessions are compared with those of their own kind of particles.

    Attributes
    ----------
    rows : list of dict of str to object
        Rows of its table, one for each particle.
    quantities : list of Quantity
        Quantities of the sessions.
    effects : list of Recurring
        Effects that recur.
    parameters : dict of str to list of Quantity
        Quantities of the parameters of each effect.
    unlike : list of Unlike
        Sessions that differ from the others.
    drifts : list of tuple[Quantity, Trend]
        Quantities that drift, with their trends.
    verdicts : dict of str to int
        Number of sessions with each verdict.
    proxies : dict of str to list of str
        Sessions in which an effect stands for an unnamed one, by effect.
    films : dict[str, dict of str to object]
        Results of tracked films by name.
    imported : dict of str to object
        Summary of the imports.
    """

    rows: list[dict[str, Any]]
    quantities: list[Quantity]
    effects: list[Recurring]
    parameters: dict[str, list[Quantity]]
    unlike: list[Unlike]
    drifts: list[tuple[Quantity, Trend]]
    verdicts: dict[str, int]
    proxies: dict[str, list[str]]
    films: dict[str, dict[str, Any]]
    imported: dict[str, Any]

    @property
    def sessions(self) -> list[str]:
        """Names of all sessions, in the order of the table."""
        return list(dict.fromkeys(row['session'] for row in self.rows))

    def sentences(self) -> list[str]:
        """Return the findings as text.

        Returns
        -------
        list of str
            One sentence per finding.
        """
        said = [effect.sentence() for effect in self.effects]
        said += [f'{one.session} differs from the others: {one.title} {one.value:.3g}, usually '
                 f'{one.mean:.3g}{_scale_hint(one)}.' for one in self.unlike]
        said += self.imported['sentences']
        said += [f'{one.title} drifts by {line.slope:+.2g} ± {1.96 * line.std:.1g} per week.'
                 for one, line in self.drifts]
        return said

    def as_json(self) -> dict[str, Any]:
        """Return the findings for programs.

        Returns
        -------
        dict of str to object
            Values by name, in the units of the names.
        """
        return {
            'sentences': self.sentences(),
            'sessions': len(self.sessions), 'particles': len(self.rows),
            'verdicts': self.verdicts, 'proxies': self.proxies,
            'quantities': {one.name: _quantity(one) for one in self.quantities},
            'effects': [_effect(one) for one in self.effects],
            'unlike': [asdict(one) for one in self.unlike],
            'drifts': [{'quantity': one.name, 'per_week': line.slope, 'std': line.std,
                        'p_value': line.p_value} for one, line in self.drifts],
            'films': self.films, 'imported': self.imported,
        }


def conclude(archive: Archive | str | Path) -> Conclusions:
    """Return the conclusions on an archive; nothing is computed anew.

    Parameters
    ----------
    archive : Archive or str or Path
        The archive, or its folder.

    Returns
    -------
    Conclusions
        The conclusions.
    """
    if not isinstance(archive, Archive):
        archive = Archive(archive)
    measured = archive.results('measure')
    effects = recurring_effects(measured)
    # Without a measurement, presence is unknown.
    present: dict[str, list[str]] = {path: [] for path in measured}
    for effect in effects:
        for path in effect.present:
            present[path].append(effect.id)
    table = list(rows(archive, present))
    first = {row['path']: row for row in reversed(table)}
    parameters = {effect.id: _parameters(effect, first) for effect in effects}
    known = quantities(table)
    over_sessions = [*known, *(one for of in parameters.values() for one in of)]
    alike = [part for one in over_sessions for part in one.by_kind()]
    verdicts = Counter(row['verdict'] for row in first.values() if row['verdict'])
    return Conclusions(
        table, known, [_by_name(effect, first) for effect in effects], parameters,
        unlike_the_others(alike), drifting(alike), dict(verdicts),
        {effect: [str(first[path]['session']) for path in paths if path in first]
         for effect, paths in proxies(archive.results('discover')).items()},
        {archive.entries[path].name: found['film']
         for path, found in archive.results('track').items() if 'film' in found},
        imported(archive))


def _scale_hint(one: Unlike) -> str:
    """Return the usual cause of a speed that is a multiple of the others."""
    is_speed = one.title.startswith((NAMES['v_um_s'] + ' ', NAMES['gain_um_s_hz'] + ' '))
    ratio = one.value / one.mean if one.mean else 1.0
    if not is_speed or 1 / _MULTIPLE < ratio < _MULTIPLE:
        return ''
    return '; another objective or a wrong pixel size can cause that'


def _parameters(effect: Recurring, first: Mapping[str, Mapping[str, Any]]) -> list[Quantity]:
    """Return the parameters of an effect in the sessions that have and determine them."""
    found = []
    for name, estimates in effect.estimates.items():
        has = [path for path in effect.present if path in first and path in estimates]
        if has:
            value, std = np.array([estimates[path] for path in has]).T
            rows = [first[path] for path in has]
            found.append(of_sessions(f'{effect.id}.{name}', rows, value, std))
    return found


def _by_name(effect: Recurring, first: Mapping[str, Mapping[str, Any]]) -> Recurring:
    """Replace the paths of sessions by their names."""
    def name(path: str) -> str:
        return str(first[path]['session']) if path in first else path

    return Recurring(
        effect.id, {name(path): p for path, p in effect.probability.items()},
        tuple(map(name, effect.unseen)), effect.parameters,
        {parameter: {name(path): pair for path, pair in of.items()}
         for parameter, of in effect.estimates.items()})


def _quantity(one: Quantity) -> dict[str, Any]:
    return {
        'all': _spread(one.spread), 'particles_between': one.particles_between,
        'trend_per_week': one.trend and asdict(one.trend),
        'by': {label: {group: _spread(found) for group, found in one.by(label).items()}
               for label in LABELS},
        'between': {label: _spread(one.between(label)) for label in LABELS}}


def _spread(found: Spread | None) -> dict[str, Any] | None:
    """Return a spread for JSON, with null for values that are not finite."""
    return None if found is None else {
        key: value if np.isfinite(value) else None for key, value in asdict(found).items()}


def _effect(effect: Recurring) -> dict[str, Any]:
    return {
        'id': effect.id, 'sentence': effect.sentence(),
        'present': effect.present, 'absent': effect.absent, 'undecided': effect.undecided,
        'varying': effect.varying,
        'parameters': {name: {**(_spread(found) or {}), 'unit': effect.unit(name)}
                       for name, found in effect.parameters.items()}}


def refused(archive: Archive) -> dict[str, str]:
    """Return why recordings of an archive could not be read or processed.

    Parameters
    ----------
    archive : Archive
        The archive.

    Returns
    -------
    dict of str to str
        Reason by name.
    """
    found = {one.name: one.reason for one in archive.refused.values()}
    for entry in archive.entries.values():
        for key in entry.jobs.values():
            if reason := (archive.result(key) or {}).get('refused'):
                found[entry.name] = reason
    return dict(sorted(found.items()))


def listed(names: Sequence[str], most: int = 12) -> str:
    """Return the first names as text, and the number of the others.

    Parameters
    ----------
    names : sequence of str
        Names.
    most : int
        Largest number of names in the text.

    Returns
    -------
    str
        The text.
    """
    more = len(names) - most
    return ', '.join(names[:most]) + (f' and {more} more' if more > 0 else '')
