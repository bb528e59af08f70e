"""Responses of many sessions: by robot, by kind and by day."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from microbot_ros.archive.conclusions.random_effects import spread
from microbot_ros.common.records import Session
from microbot_ros.response.curve import DriveCurve, fit_curve
from microbot_ros.response.plateaus import (
    Against,
    Definition,
    Measured,
    Plateau,
    SessionResponse,
    respond,
)

_FALLS = 0.9
"""Choice: share of its top speed above which a robot at its last level has not stepped out."""
_FEWEST_ROBOTS = 4
"""Choice: robots needed to call one of them unlike the others."""
_UNLIKE = 1.5
"""Choice: ratio of speeds from which a robot is unlike the others: objectives differ by factors of
2, robots of one kind by 20 %."""
_UNLIKE_SPREADS = 4.0
"""Choice: difference in usual spreads that is required as well; at half, chance would report one
robot in twenty."""


@dataclass(frozen=True)
class Labelled:
    """A `session` with the `kind` of its particles, its `day` (ISO) and `rig`; '' if unknown."""

    session: Session
    kind: str = ''
    day: str = ''
    rig: str = ''


@dataclass(frozen=True)
class Row:
    """A plateau with the `kind`, `day` and `rig` of its session; '' if unknown."""

    plateau: Plateau
    kind: str
    day: str
    rig: str

    @property
    def robot(self) -> tuple[str, int]:
        """Robot: session and particle."""
        return self.plateau.session, self.plateau.particle


@dataclass(frozen=True)
class Level:
    """Mean `speed` of `robots` at a `level`, and the standard deviation `between` robots [m/s]."""

    level: float
    speed: Measured
    between: float
    robots: int


@dataclass(frozen=True)
class Group:
    """Robots of one `kind`, of one `day` or of all ('').

    `curve` is the fitted `drive_response`, None if not fitted; `stepping_out` maps the robots
    whose own speeds fall within the driven frequencies to their step-outs [Hz].
    """

    kind: str
    day: str
    robots: list[tuple[str, int]]
    levels: list[Level]
    curve: DriveCurve | None
    stepping_out: dict[tuple[str, int], Measured]

    @property
    def common(self) -> list[Level]:
        """Levels at which at least half of the robots were driven; all levels if there are none.

        A mean over few robots next to one over all would show differences between robots.
        """
        return [one for one in self.levels if 2 * one.robots >= len(self.robots)] or self.levels

    @property
    def steps_out(self) -> bool:
        """Whether the law of the kind has a step-out that most of its robots show."""
        return (self.curve is not None and self.curve.steps_out(self.common[-1].level)
                and 2 * len(self.stepping_out) > len(self.robots))


@dataclass(frozen=True)
class Unlike:
    """A `robot` whose speeds are `ratio` times those of the others of its `kind`."""

    robot: tuple[str, int]
    kind: str
    ratio: float


@dataclass(frozen=True)
class Response:
    """Speeds in all sessions `against` a commanded quantity, by a `definition` of speed.

    `rows` one per robot and level; `kinds` and `days` (of each kind) are groups; `unlike` robots;
    `compared` {kind: [(level, speed in tables over that of motion)]}; `notes` {session:
    sentences}; `delays` {session: delay [s]}; `without` names sessions without a plateau.
    """

    against: Against
    definition: Definition
    rows: list[Row]
    kinds: list[Group]
    days: list[Group]
    unlike: list[Unlike]
    compared: dict[str, list[tuple[float, float]]]
    notes: dict[str, list[str]] = field(default_factory=dict)
    delays: dict[str, float] = field(default_factory=dict)
    without: list[str] = field(default_factory=list)


def respond_all(sessions: Sequence[Labelled], against: Against, definition: Definition,
                ) -> Response:
    """Combine all `sessions` `against` a commanded quantity, by a `definition` of speed.

    Parameters
    ----------
    sessions : sequence of Labelled
        The sessions with their labels.
    against : Against
        Quantity that is varied.
    definition : Definition
        Definition of speed.

    Returns
    -------
    Response
        The response.
    """
    rows, notes, delays, without = [], {}, {}, []
    both: dict[Definition, list[Row]] = {'motion': [], 'tables': []}
    for one in sessions:
        found: dict[Definition, SessionResponse] = {
            kind: respond(one.session, against, kind) for kind in ('motion', 'tables')}
        for kind, response in found.items():
            both[kind] += [Row(plateau, one.kind, one.day, one.rig)
                           for plateau in response.plateaus]
        if found[definition].notes:
            notes[one.session.name] = found[definition].notes
        if not found[definition].plateaus:
            without.append(one.session.name)
        delays[one.session.name] = found['motion'].delay
    rows = both[definition]
    kinds = [_group(list(own), kind, '', against) for kind, own in groupby(
        sorted(rows, key=lambda row: row.kind), key=lambda row: row.kind)]
    dated = sorted((row for row in rows if row.day), key=lambda row: (row.kind, row.day))
    days = [_group(list(own), *key, against) for key, own in groupby(
        dated, key=lambda row: (row.kind, row.day))]
    return Response(
        against, definition, rows, kinds, days,
        [one for group in kinds for one in _unlike(group, rows)],
        {group.kind: _ratios(group.kind, both) for group in kinds}, notes, delays, without)


def _group(rows: list[Row], kind: str, day: str, against: Against) -> Group:
    robots = sorted({row.robot for row in rows})
    levels = []
    ordered = sorted(rows, key=lambda row: row.plateau.level)
    for level, there in groupby(ordered, key=lambda row: row.plateau.level):
        found = _level(level, [row.plateau.speed for row in there])
        if found is not None:
            levels.append(found)
    curve = None
    stepping_out: dict[tuple[str, int], Measured] = {}
    if against == 'frequency':
        curve = None if day else _curve(rows, robots)
        for robot in robots if not day else ():
            own = sorted((row for row in rows if row.robot == robot),
                         key=lambda row: row.plateau.level)
            speeds = [row.plateau.speed.value for row in own]
            if speeds[-1] > _FALLS * max(speeds):
                continue
            single = _curve(own, [robot])
            if single and single.steps_out(own[-1].plateau.level):
                stepping_out[robot] = single.step_out
    return Group(kind, day, robots, levels, curve, stepping_out)


def _curve(rows: list[Row], robots: list[tuple[str, int]]) -> DriveCurve | None:
    table = np.array([(row.plateau.level, row.plateau.speed.value, row.plateau.speed.std,
                       robots.index(row.robot)) for row in rows])
    frequency, speed, std, robot = table.T
    return fit_curve(frequency, speed, std, robot.astype(int))


def _level(level: float, speeds: list[Measured]) -> Level | None:
    """Return mean and spread of the `speeds` of robots at a `level`, by random effects."""
    value = np.array([one.value for one in speeds])
    std = np.array([one.std for one in speeds])
    found = spread(value, std)
    if found is None:
        return Level(level, Measured(float(value.mean())), np.nan, len(speeds))
    if found.count == 1 and len(speeds) == 1:
        return Level(level, speeds[0], np.nan, 1)
    return Level(level, Measured(found.mean, found.mean_std, found.mean_low, found.mean_high),
                 found.between, found.count)


def _unlike(group: Group, rows: list[Row]) -> list[Unlike]:
    """Return the robots of a group whose speeds are a multiple of those of the others."""
    own = [row for row in rows if row.kind == group.kind]
    ratios: dict[tuple[str, int], float] = {}
    for robot in group.robots:
        shares = []
        for row in own:
            if row.robot != robot:
                continue
            others = [other.plateau.speed.value for other in own
                      if other.robot != robot and other.plateau.level == row.plateau.level]
            if others and (middle := float(np.median(others))) > 0:
                shares.append(row.plateau.speed.value / middle)
        if shares and (ratio := float(np.median(shares))) > 0:
            ratios[robot] = ratio
    if len(ratios) < _FEWEST_ROBOTS:
        return []
    logs = np.log(np.array([*ratios.values()]))
    usual = 1.4826 * float(np.median(np.abs(logs - np.median(logs))))
    return [Unlike(robot, group.kind, ratio) for robot, ratio in ratios.items()
            if abs(np.log(ratio)) > max(np.log(_UNLIKE), _UNLIKE_SPREADS * usual)]


def _ratios(kind: str, both: dict[Definition, list[Row]]) -> list[tuple[float, float]]:
    """Return (level, median ratio of table speed to motion speed) over the robots of a kind."""
    speeds: dict[Definition, dict[tuple[tuple[str, int], float], float]] = {
        name: {(row.robot, row.plateau.level): row.plateau.speed.value
               for row in rows if row.kind == kind} for name, rows in both.items()}
    shared: dict[float, list[float]] = {}
    for (robot, level), motion in speeds['motion'].items():
        tables = speeds['tables'].get((robot, level))
        if tables is not None and motion > 0:
            shared.setdefault(level, []).append(tables / motion)
    return [(level, float(np.median(of))) for level, of in sorted(shared.items())]
