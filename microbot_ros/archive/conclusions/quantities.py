"""v, φ, D and σ over an archive: by session, rig, batch and day; outliers and drifts."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from microbot_ros.archive.conclusions.random_effects import Spread, Trend, spread, trend, unlike
from microbot_ros.common.units import bare, symbol

NAMES = {'v_um_s': 'v', 'gain_um_s_hz': 'gain', 'phi_rad': 'φ', 'diffusion_um2_s': 'D',
         'localisation_um': 'σ'}
LABELS = ('rig', 'batch', 'day', 'particle_kind')
DRIFTS = 0.01
"""Probability, over all comparisons, below which a trend or an unusual session is reported.
Choice: one false report in a hundred archives."""

_TOGETHER = 0.7
"""Length of the mean of e^{iφ} above which angles have a meaningful mean. Choice: at 0.7 they
spread by about 50°, so that jumps at ±π are rare."""


@dataclass(frozen=True)
class Quantity:
    """A quantity with one value per session.

    Attributes
    ----------
    name : str
        Its name, which contains its unit.
    sessions : tuple of str
        Names of the K sessions.
    days : ndarray, shape (K,)
        Days of the sessions; NaN for unknown.
    value : ndarray, shape (K,)
        Values.
    std : ndarray, shape (K,)
        Standard deviations of the values.
    particles_between : float
        Standard deviation between the particles of a session, beyond their errors.
    groups : dict[str, dict of str to list of int]
        Indices of the sessions of each rig, batch, day or kind, by label.
    of_kind : str
        Common kind of particles; '' for none.
    """

    name: str
    sessions: tuple[str, ...]
    days: np.ndarray
    value: np.ndarray
    std: np.ndarray
    particles_between: float
    groups: dict[str, dict[str, list[int]]]
    of_kind: str = ''

    @property
    def title(self) -> str:
        """Title for people, such as 'v (µm/s)' or 'delay of command_delay (s)'."""
        *effect, name = self.name.split('.')
        of = ''.join(f' of {one}' for one in effect)
        unit = f' ({symbol(name)})' if symbol(name) else ''
        return NAMES.get(name, bare(name)) + of + unit

    def by_kind(self) -> list[Quantity]:
        """Return the quantity separately for each kind of particles, and for those without a kind.

        Returns
        -------
        list of Quantity
            One quantity per kind.
        """
        if not self.groups['particle_kind']:
            return [self]
        return [self._only(of, kind) for kind, of in self.kinds()]

    def kinds(self) -> list[tuple[str, list[int]]]:
        """Return the kinds of particles with the indices of their sessions.

        Returns
        -------
        list of tuple[str, list of int]
            '' is the kind of sessions without one.
        """
        kinds = self.groups['particle_kind']
        known = {k for of in kinds.values() for k in of}
        rest = [k for k in range(len(self.value)) if k not in known]
        return [(kind, of) for kind, of in [*kinds.items(), ('', rest)] if of]

    def _only(self, of: list[int], kind: str) -> Quantity:
        places = {k: place for place, k in enumerate(of)}
        groups = {label: {group: own for group, members in one.items()
                          if (own := [places[k] for k in members if k in places])}
                  for label, one in self.groups.items()}
        return Quantity(self.name, tuple(self.sessions[k] for k in of), self.days[of],
                        self.value[of], self.std[of], self.particles_between, groups, kind)

    @property
    def spread(self) -> Spread | None:
        """Spread between all sessions."""
        return spread(self.value, self.std)

    @property
    def trend(self) -> Trend | None:
        """Trend per week; None if too few sessions have a day."""
        return trend(self.days / 7, self.value, self.std)

    def by(self, label: str) -> dict[str, Spread]:
        """Return mean and spread of the sessions of each rig, batch or day.

        Parameters
        ----------
        label : str
            One of LABELS.

        Returns
        -------
        dict of str to Spread
            Spread by group.
        """
        return {group: found for group, of in self.groups[label].items()
                if (found := spread(self.value[of], self.std[of]))}

    def between(self, label: str) -> Spread | None:
        """Return the spread between rigs, batches or days, in addition to that within them.

        Parameters
        ----------
        label : str
            One of LABELS.

        Returns
        -------
        Spread or None
            None for fewer than two groups.
        """
        means = list(self.by(label).values())
        if len(means) < 2:
            return None
        return spread(np.array([one.mean for one in means]),
                      np.array([one.mean_std for one in means]))


def quantities(rows: Sequence[Mapping[str, Any]]) -> list[Quantity]:
    """Return every quantity in the rows, in the order of `NAMES`.

    Parameters
    ----------
    rows : sequence of mapping of str to object
        Rows of the archive's table.

    Returns
    -------
    list of Quantity
        The quantities.
    """
    sessions = [list(group) for _, group in groupby(rows, key=lambda row: row['session'])]
    return [found for name in NAMES if (found := _quantity(name, sessions))]


def _quantity(name: str, sessions: Sequence[Sequence[Mapping[str, Any]]]) -> Quantity | None:
    one_each = name in ('diffusion_um2_s', 'localisation_um')
    kept, estimates = [], []
    for rows in sessions:
        pairs = [(row[name], row[f'{name}_std']) for row in (rows[:1] if one_each else rows)
                 if row.get(name) is not None and row.get(f'{name}_std')]
        if pairs:
            kept.append(rows[0])
            estimates.append(np.array(pairs, dtype=float))
    if not kept:
        return None
    if name == 'phi_rad' and not (estimates := _about_their_mean(estimates)):
        return None
    between = _between_particles(estimates)
    weights = [1 / (pairs[:, 1] ** 2 + between) for pairs in estimates]
    value = np.array([(w * pairs[:, 0]).sum() / w.sum()
                      for w, pairs in zip(weights, estimates, strict=True)])
    return of_sessions(name, kept, value, np.array([w.sum() ** -0.5 for w in weights]),
                       float(np.sqrt(between)))


def of_sessions(name: str, rows: Sequence[Mapping[str, Any]], value: np.ndarray, std: np.ndarray,
                particles_between: float = 0.0) -> Quantity:
    """Return a quantity from one value per session.

    Parameters
    ----------
    name : str
        Name of the quantity.
    rows : sequence of mapping of str to object
        One row of the table for each session.
    value : ndarray, shape (K,)
        Values.
    std : ndarray, shape (K,)
        Standard deviations of the values.
    particles_between : float
        As of `Quantity`.

    Returns
    -------
    Quantity
        The quantity.
    """
    days = np.array([row['day'].toordinal() if row.get('day') else np.nan for row in rows], float)
    groups: dict[str, dict[str, list[int]]] = {label: {} for label in LABELS}
    for label in LABELS:
        for k, row in enumerate(rows):
            if row.get(label) is not None:
                groups[label].setdefault(_group(row[label]), []).append(k)
    return Quantity(name, tuple(row['session'] for row in rows), days, value, std,
                    particles_between, {label: dict(sorted(one.items()))
                                        for label, one in groups.items()})


def _group(value: str | datetime.date) -> str:
    return value.isoformat() if isinstance(value, datetime.date) else value


def _about_their_mean(estimates: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return angles without a jump at ±π; empty if they have no meaningful mean."""
    mean = np.exp(1j * np.concatenate([pairs[:, 0] for pairs in estimates])).mean()
    if abs(mean) < _TOGETHER:
        return []
    middle = float(np.angle(mean))
    return [np.column_stack([
        middle + np.angle(np.exp(1j * (pairs[:, 0] - middle))), pairs[:, 1]])
        for pairs in estimates]


def _between_particles(estimates: Iterable[np.ndarray]) -> float:
    """Return the variance between particles of one session, by moments over all sessions.

    The estimator is that of DerSimonian and Laird (1986).
    """
    excess = weight = 0.0
    for pairs in estimates:
        w = pairs[:, 1] ** -2
        mean = (w * pairs[:, 0]).sum() / w.sum()
        excess += float((w * (pairs[:, 0] - mean) ** 2).sum()) - (len(pairs) - 1)
        weight += float(w.sum() - (w**2).sum() / w.sum())
    return max(excess / weight, 0.0) if weight > 0 else 0.0


@dataclass(frozen=True)
class Unlike:
    """A session that differs from the others in a quantity.

    Attributes
    ----------
    session : str
        Its name.
    title : str
        Title of the quantity, with its unit.
    value : float
        Its value.
    mean : float
        Mean of the others.
    p_value : float
        Probability of such a difference by chance, for this session alone.
    """

    session: str
    title: str
    value: float
    mean: float
    p_value: float


def unlike_the_others(known: Sequence[Quantity]) -> list[Unlike]:
    """Return sessions that differ from the others in a quantity, the most unusual first.

    Parameters
    ----------
    known : sequence of Quantity
        Quantities.

    Returns
    -------
    list of Unlike
        The sessions.
    """
    chances = [unlike(one.value, one.std) for one in known]
    asked = max(sum(int(np.isfinite(chance).sum()) for chance in chances), 1)
    found = [
        Unlike(one.sessions[k], one.title, float(one.value[k]), whole.mean, float(chance[k]))
        for one, chance in zip(known, chances, strict=True) if (whole := one.spread)
        for k in np.flatnonzero(chance * asked < DRIFTS)]
    return sorted(found, key=lambda one: one.p_value)


def drifting(known: Sequence[Quantity]) -> list[tuple[Quantity, Trend]]:
    """Return the quantities that drift over the weeks.

    Parameters
    ----------
    known : sequence of Quantity
        Quantities.

    Returns
    -------
    list of tuple[Quantity, Trend]
        Quantities with their trends.
    """
    found = [(one, one.trend) for one in known]
    asked = sum(line is not None for _, line in found)
    return [(one, line) for one, line in found
            if line is not None and line.p_value * asked < DRIFTS]
