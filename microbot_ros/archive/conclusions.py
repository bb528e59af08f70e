"""What an archive says as a whole, from the results that lie in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.archive.imports import imported
from microbot_ros.archive.quantities import (
    LABELS,
    NAMES,
    Quantity,
    Unlike,
    drifting,
    of_sessions,
    quantities,
    unlike_the_others,
)
from microbot_ros.archive.random_effects import Spread, Trend
from microbot_ros.archive.recurring import Recurring, proxies, recurring_effects
from microbot_ros.archive.store import Archive
from microbot_ros.archive.table import rows

_MULTIPLE = 1.5
"""Objectives differ by factors of 2; robots of one kind by 20 %."""


@dataclass(frozen=True)
class Conclusions:
    """An archive as a whole: the `rows` of its table, one for each particle; `quantities` of the
    sessions; `effects` that recur, with the quantities `parameters` {effect: ...}; sessions
    `unlike` the others; what drifts, with its `drifts`; `verdicts` and how often; `proxies`
    {effect: sessions in which it stands in for something without a name}; `films` tracked;
    what was `imported`. Sessions are compared with those of their own kind of particles.
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
        """All sessions, in the order of the table."""
        return list(dict.fromkeys(row['session'] for row in self.rows))

    def sentences(self) -> list[str]:
        """The findings for people."""
        said = [effect.sentence() for effect in self.effects]
        said += [f'{one.session} differs from the others: {one.title} {one.value:.3g}, usually '
                 f'{one.mean:.3g}{_scale_hint(one)}.' for one in self.unlike]
        said += self.imported['sentences']
        said += [f'{one.title} drifts by {line.slope:+.2g} ± {1.96 * line.std:.1g} per week.'
                 for one, line in self.drifts]
        return said

    def as_json(self) -> dict[str, Any]:
        """The findings for programs, in the units of the names."""
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
    """What an `archive`, or the one in a folder, says as a whole; nothing is computed anew."""
    if not isinstance(archive, Archive):
        archive = Archive(archive)
    measured = archive.results('measure')
    effects = recurring_effects(measured)
    # Where nobody measured, nobody knows of presence.
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
    """What a speed that is a multiple of the others' most often is."""
    is_speed = one.title.startswith((NAMES['v_um_s'] + ' ', NAMES['gain_um_s_hz'] + ' '))
    ratio = one.value / one.mean if one.mean else 1.0
    if not is_speed or 1 / _MULTIPLE < ratio < _MULTIPLE:
        return ''
    return '; another objective or a wrong pixel size can cause that'


def _parameters(effect: Recurring, first: Mapping[str, Mapping[str, Any]]) -> list[Quantity]:
    """The parameters of an effect in the sessions that have it."""
    found = []
    for name, estimates in effect.estimates.items():
        has = [path for path in effect.present if path in first]
        value, std = np.array([estimates[path] for path in has]).reshape(-1, 2).T
        found.append(of_sessions(f'{effect.id}.{name}', [first[path] for path in has], value, std))
    return found


def _by_name(effect: Recurring, first: Mapping[str, Mapping[str, Any]]) -> Recurring:
    """With the names of sessions where there were paths."""
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
    """Null for what is not finite: JSON knows no infinity."""
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
    """{name: reason} of what could not be read or done in an `archive`."""
    found = {one.name: one.reason for one in archive.refused.values()}
    for entry in archive.entries.values():
        for key in entry.jobs.values():
            if reason := (archive.result(key) or {}).get('refused'):
                found[entry.name] = reason
    return dict(sorted(found.items()))


def listed(names: Sequence[str], most: int = 12) -> str:
    """The first `most` of some `names`, and how many there are more."""
    more = len(names) - most
    return ', '.join(names[:most]) + (f' and {more} more' if more > 0 else '')
