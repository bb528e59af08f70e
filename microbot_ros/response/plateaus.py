"""Motion of each particle at each plateau of a command, with 95 % intervals.

`motion`: displacements between frames, rotated into the frame of the command, over the stretches
without a change. Blocks of half a second are the independent samples; if neighbours are still
correlated, the number of samples is reduced accordingly.

`tables`: the mean, over all rows of a plateau, of the speed that a laboratory's tables state: the
length of the displacement over some frames, divided by a time, whatever happens in between.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from microbot_ros.common.records import Commands, Session, SpeedWindow, Tracks

Against = Literal['frequency', 'field', 'tilt']
Definition = Literal['motion', 'tables']

SETTLE_S = 0.3
"""Choice: frames within this time [s] of a change are left out, twice the 0.09 to 0.15 s delay of
cameras and amplifiers. At half, the delay is included; at twice, plateaus of 1.5 s lose 40 %.
"""
TURN = np.radians(10.0)
"""Choice: frames are left out if the direction turned by more [rad] within `SETTLE_S`. The speed
along the command is then off by at most 1.5 % (1 − cos 10°).
"""
BLOCK_S = 0.5
"""Choice: length of a sample [s]. Correlated samples count as fewer."""
_MOST_ALIKE = 0.8  # choice: largest correlation of samples that is taken into account
_LONGEST_GAP = 3.0
"""Choice: steps longer than this many frame intervals are gaps."""
_LEAP = 8.0
"""Choice: steps longer than this many times the 95th percentile are tracking errors."""
_DELAYS = np.arange(0.0, 0.51, 0.02)  # choice: delays [s] tried, up to three times the usual
_STILL_SHARE = 0.2
"""Choice: share of the driven frames with constant direction from which only they are used."""
_PRIOR_FREEDOM = 4.0  # choice: weight of the usual scatter in degrees of freedom (Smyth 2004)
_FEWEST_PLATEAUS = 3
"""Choice: plateaus needed to determine the usual scatter of a particle."""
_DEFAULT_WINDOW = SpeedWindow(15, 'elapsed')
"""Window of the tables if a session names none: that of the MagScope tracker."""


@dataclass(frozen=True)
class Measured:
    """Estimate with standard deviation `std` and 95 % interval from `low` to `high`.

    NaN if unknown, infinite if unbounded. The estimate is `value`.
    """

    value: float = np.nan
    std: float = np.nan
    low: float = np.nan
    high: float = np.nan


@dataclass(frozen=True)
class Plateau:
    """Motion of one particle at one level of the commanded quantity, in SI.

    Attributes
    ----------
    session : str
    particle : int
    level : float
        |f| [Hz], |B| [T] or tilt [rad].
    speed : Measured [m/s]
        Along the command for `motion`, as tables state it for `tables`.
    across : Measured [m/s]
        To the left of the command.
    slip : Measured [rad]
        Angle from the command to the motion.
    turning : Measured [rad/s]
        Rate of the slip angle.
    n : float
        Equivalent number of independent samples.
    frames, visits, left_out : int
        Frames used, stretches of this level, frames not used.
    seconds : float
        Total duration of the frames used [s].
    """

    session: str
    particle: int
    level: float
    speed: Measured
    across: Measured
    slip: Measured
    turning: Measured
    n: float
    frames: int
    visits: int
    seconds: float
    left_out: int


@dataclass(frozen=True)
class SessionResponse:
    """Plateaus of a session, the `delay` [s] of its commands, and `notes` on omitted data."""

    plateaus: list[Plateau]
    delay: float
    notes: list[str]


def levels(commands: Commands, against: Against) -> np.ndarray:
    """Return the level (K,) of each command; NaN if nothing is driven.

    `against` selects |f| [Hz], |B| [T] or the tilt of the axis [rad].

    Parameters
    ----------
    commands : Commands
        K commands.
    against : Against
        Frequency, field or tilt.

    Returns
    -------
    ndarray, shape (K,)
        Levels in SI.
    """
    strength = np.hypot(*commands.field.T)
    driven = strength > 0
    if commands.frequency is not None:
        driven &= commands.frequency != 0
    values = {
        'frequency': np.full(len(commands.t), np.nan) if commands.frequency is None
        else np.abs(commands.frequency),
        'field': strength,
        'tilt': np.full(len(commands.t), np.pi / 2) if commands.tilt is None else commands.tilt,
    }[against]
    # Users set levels; equal to six digits means the same level.
    return np.where(driven, _six_digits(values), np.nan)


def respond(session: Session, against: Against, definition: Definition) -> SessionResponse:
    """Measure the motion of each particle of a `session` at each level of the quantity `against`.

    `definition` selects how speed is measured. For `motion`, stretches in which another commanded
    quantity is not at its most common value are left out. The result may have no plateaus.

    Parameters
    ----------
    session : Session
        The session.
    against : Against
        Quantity that is varied.
    definition : Definition
        Definition of speed.

    Returns
    -------
    SessionResponse
        Plateaus of each particle.
    """
    commands = session.commands
    if not len(commands.t):
        return SessionResponse([], 0.0, ['nothing was commanded'])
    level = levels(commands, against)
    if definition == 'tables':
        window = session.speed_window or _DEFAULT_WINDOW
        found = [plateau for name in session.tracks.particles
                 for plateau in _by_window(session, int(name), level, window)]
        return SessionResponse(found, 0.0, [])
    level, notes = _others_held(commands, level, against, float(session.tracks.t[-1]))
    steps = [_steps(session.tracks.of(name)) for name in session.tracks.particles]
    delay = _delay(commands, steps)
    still = [_still(commands, one) for one in steps]
    driven = [np.isfinite(_at(level, commands, one.middle)) for one in steps]
    standing = sum(int((s & d).sum()) for s, d in zip(still, driven, strict=True))
    modelled = standing < _STILL_SHARE * max(sum(int(d.sum()) for d in driven), 1)
    if modelled and standing < sum(int(d.sum()) for d in driven):
        notes.append('the direction turns nearly all the time: frames during turns are kept, each '
                     f'compared with the command {delay:.2f} s before')
        still = [np.ones(len(one.middle), bool) for one in steps]
    blocks = [_blocks(commands, level, one, use, delay)
              for one, use in zip(steps, still, strict=True)]
    alike = _alike(blocks)
    found = []
    for name, one, own in zip(session.tracks.particles, steps, blocks, strict=True):
        found += _of_particle(session, int(name), commands, level, one, own, alike)
    return SessionResponse(found, delay, notes)


@dataclass(frozen=True)
class _Steps:
    """Steps between frames of one particle, from `start` to `end` [s] by `moved` (complex) [m]."""

    start: np.ndarray
    end: np.ndarray
    moved: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        return (self.start + self.end) / 2


@dataclass(frozen=True)
class _Block:
    """Mean velocity in the frame of the command (complex) [m/s] over `seconds` from `start`."""

    level: float
    stretch: int
    start: float
    seconds: float
    frames: int
    velocity: complex


def _six_digits(values: np.ndarray) -> np.ndarray:
    return np.array([float(f'{value:.6g}') for value in values])


def _others_held(commands: Commands, level: np.ndarray, against: Against, end: float,
                 ) -> tuple[np.ndarray, list[str]]:
    """Set `level` to NaN where another quantity is not at its most common value, with notes."""
    notes = []
    lasts = np.clip(np.append(commands.t[1:], end) - commands.t, 0, None)
    units = {'frequency': ('rotation', 'Hz', 1.0), 'field': ('field', 'mT', 1e3),
             'tilt': ('axis', '° from the vertical', 180 / np.pi)}
    others: tuple[Against, ...] = ('frequency', 'field', 'tilt')
    for other in others:
        value = levels(commands, other)
        used = np.isfinite(level) & np.isfinite(value)
        if other == against or not used.any():
            continue
        different = np.unique(value[used])
        common = max(different, key=lambda one: lasts[used & (value == one)].sum())
        off = used & (np.abs(value - common) > 0.02 * abs(common))
        if off.any():
            name, unit, factor = units[other]
            notes.append(f'{lasts[off].sum():.1f} s left out, in which the {name} is not '
                         f'{common * factor:.4g} {unit}')
            level = np.where(off, np.nan, level)
    return level, notes


def _steps(track: Tracks) -> _Steps:
    z = track.position @ np.array([1, 1j])
    moved, lasts = np.diff(z), np.diff(track.t)
    if not len(moved):
        return _Steps(track.t[:0], track.t[:0], moved)
    keep = lasts <= _LONGEST_GAP * np.median(lasts)
    keep &= np.abs(moved) <= _LEAP * np.quantile(np.abs(moved), 0.95)
    return _Steps(track.t[:-1][keep], track.t[1:][keep], moved[keep])


def _at(values: np.ndarray, commands: Commands, t: np.ndarray) -> np.ndarray:
    """Return `values` (K,) of the commands at times `t`; NaN before the first."""
    return np.append(np.nan, values)[commands.index_at(t) + 1]


def _directions(commands: Commands) -> np.ndarray:
    """Return complex unit vectors (K,) of the commanded motion; 0 if nothing is driven."""
    z = commands.field @ np.array([1, 1j])
    if commands.frequency is not None:
        z = z * np.sign(commands.frequency)
    size = np.abs(z)
    return np.divide(z, size, out=np.zeros_like(z), where=size > 0)


def _delay(commands: Commands, steps: list[_Steps]) -> float:
    """Return the delay [s] at which motion follows the commands best, the smallest of equals."""
    unit = np.append(0, _directions(commands))
    scores = np.zeros(len(_DELAYS))
    for one in steps:
        for k, delay in enumerate(_DELAYS):
            turned = unit[commands.index_at(one.middle - delay) + 1].conj() * one.moved
            scores[k] += abs(turned.sum())
    return float(_DELAYS[np.argmax(scores > 0.995 * scores.max())]) if scores.max() > 0 else 0.0


def _still(commands: Commands, steps: _Steps) -> np.ndarray:
    """Return whether neither drive nor direction changed shortly before or during each step."""
    first = commands.index_at(steps.start - SETTLE_S)
    last = commands.index_at(steps.end)
    # A command at exactly the time of the last frame acts after it.
    last = np.where((last > first) & (commands.t[np.maximum(last, 0)] == steps.end),
                    last - 1, last)
    direction, drive = _directions(commands), _drive(commands)
    still = first >= 0
    for k in np.flatnonzero((first != last) & still):
        rows = slice(first[k], last[k] + 1)
        turned = np.abs(np.angle(direction[rows] * np.conj(direction[last[k]]))).max()
        still[k] = turned <= TURN and bool((drive[rows] == drive[last[k]]).all())
    return still


def _drive(commands: Commands) -> np.ndarray:
    """Return the size of the drive of each command (K,); its change starts a new plateau."""
    size = _six_digits(np.hypot(*commands.field.T))  # components carry the error of rounding
    return size if commands.frequency is None else size * 1e6 + np.abs(commands.frequency)


def _blocks(commands: Commands, level: np.ndarray, steps: _Steps, use: np.ndarray, delay: float,
            ) -> list[_Block]:
    """Return samples of half a second from the steps in `use`, within stretches of one level."""
    unit = np.append(0, _directions(commands))
    at = _at(level, commands, steps.middle)
    lead = unit[commands.index_at(steps.middle - delay) + 1]
    # Just after a change the delayed command may still be zero.
    lead = np.where(lead == 0, unit[commands.index_at(steps.middle) + 1], lead)
    velocity = steps.moved * lead.conj()
    lasts = steps.end - steps.start
    rows = np.flatnonzero(use & np.isfinite(at))
    result: list[_Block] = []
    breaks = np.flatnonzero((np.diff(rows) != 1) | (np.diff(at[rows]) != 0)) + 1
    for stretch, own in enumerate(np.split(rows, breaks)):
        total = float(lasts[own].sum())
        count = max(1, int(total / BLOCK_S))
        for part in np.array_split(own, count):
            seconds = float(lasts[part].sum())
            if len(part) and seconds > 0:
                result.append(_Block(float(at[part[0]]), stretch, float(steps.start[part[0]]),
                                     seconds, len(part), complex(velocity[part].sum()) / seconds))
    return result


def _alike(blocks: list[list[_Block]]) -> float:
    """Return the correlation of neighbouring samples about their means, from 0 to 0.8."""
    product, power = 0.0, 0.0
    for own in blocks:
        means = {level: np.mean([b.velocity for b in own if b.level == level])
                 for level in {b.level for b in own}}
        for one, other in pairwise(own):
            left = one.velocity - means[one.level]
            power += float(abs(left) ** 2)
            if one.stretch == other.stretch:
                product += float((left * np.conj(other.velocity - means[other.level])).real)
    return float(np.clip(product / power, 0.0, _MOST_ALIKE)) if power else 0.0


def _of_particle(session: Session, name: int, commands: Commands, level: np.ndarray,
                 steps: _Steps, blocks: list[_Block], alike: float) -> Iterator[Plateau]:
    at = _at(level, commands, steps.middle)
    of = {value: [block for block in blocks if block.level == value]
          for value in sorted({block.level for block in blocks})}
    samples = {value: (np.array([block.velocity for block in own]),
                       np.array([block.seconds for block in own])) for value, own in of.items()}
    usual = _usual_scatter(list(samples.values()))
    for value, own in of.items():
        velocity, weight = samples[value]
        mean = complex((weight * velocity).sum() / weight.sum())
        n = float(weight.sum() ** 2 / (weight**2).sum()) * (1 - alike) / (1 + alike)
        along, across = (_measured(part, weight, n, usual * abs(mean))
                         for part in (velocity.real, velocity.imag))
        frames = sum(block.frames for block in own)
        yield Plateau(
            session.name, name, value, along, across, _slip(mean, across),
            _turning(own), max(n, 1.0), frames, len({block.stretch for block in own}),
            float(weight.sum()), int((at == value).sum()) - frames)


def _usual_scatter(samples: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Return the median relative standard deviation of samples; NaN for too few plateaus."""
    shares = []
    for values, weight in samples:
        mean = (weight * values).sum() / weight.sum()
        if len(values) > 1 and abs(mean) > 0:
            per_axis = 2.0 if np.iscomplexobj(values) else 1.0
            shares.append(np.sqrt((np.abs(values - mean) ** 2).sum() / (len(values) - 1)
                                  / per_axis) / abs(mean))
    return float(np.median(shares)) if len(shares) >= _FEWEST_PLATEAUS else np.nan


def _measured(values: np.ndarray, weight: np.ndarray, n: float, usual: float = np.nan) -> Measured:
    """Return the weighted mean of `values` that count as `n` independent ones.

    Their variance is estimated together with that of the particle's other plateaus, whose `usual`
    standard deviation counts as 4 degrees of freedom (Smyth 2004): two samples alone determine
    none.
    """
    mean = float((weight * values).sum() / weight.sum())
    own = max(n - 1, 0.0) if len(values) > 1 else 0.0
    prior = _PRIOR_FREEDOM if np.isfinite(usual) else 0.0
    if own + prior < 1:
        return Measured(mean)
    share = weight / weight.sum()
    variance = 0.0
    if own:
        variance = float((share * (values - mean) ** 2).sum() / (1 - (share**2).sum()))
    together = (own * variance + (prior * usual**2 if prior else 0.0)) / (own + prior)
    std = float(np.sqrt(together / max(n, 1.0)))
    half = -float(stdtrit(own + prior, 0.025)) * std
    return Measured(mean, std, mean - half, mean + half)


def _slip(mean: complex, across: Measured) -> Measured:
    """Return the angle of the `mean` velocity from the command, with the error of `across`."""
    angle = float(np.angle(mean))
    if not abs(mean) > 0:
        return Measured()
    std, half = across.std / abs(mean), (across.high - across.low) / 2 / abs(mean)
    if not half < np.pi:
        return Measured(angle)
    return Measured(angle, std, angle - half, angle + half)


def _turning(blocks: list[_Block]) -> Measured:
    """Return the rate at which the motion turns from the command within stretches."""
    rates = [
        (float(np.angle(later.velocity * np.conj(one.velocity))), later.start - one.start)
        for one, later in pairwise(blocks)
        if one.stretch == later.stretch and one.velocity and later.velocity]
    if not rates:
        return Measured()
    angle, lasts = np.array(rates).T
    # Neighbouring differences share a block, so only half of them are independent.
    return _measured(angle / lasts, lasts, max(len(rates) / 2, 1.0))


def _by_window(session: Session, name: int, level: np.ndarray, window: SpeedWindow,
               ) -> Iterator[Plateau]:
    """Yield plateaus of a particle from the speeds that tables with that `window` state."""
    track = session.tracks.of(name)
    frames = window.frames
    if len(track.t) <= frames:
        return
    z = track.position @ np.array([1, 1j])
    moved = np.abs(z[frames:] - z[:-frames])
    last = np.diff(track.t)[frames - 1:]
    duration = {'elapsed': track.t[frames:] - track.t[:-frames],
                'last_interval': frames * last, 'frames': np.full(len(moved), float(frames))}
    speed = moved / duration[window.base]
    at = _at(level, session.commands, track.t[frames:])
    of = {float(value): np.flatnonzero(at == value) for value in np.unique(at[np.isfinite(at)])}
    usual = _usual_scatter([(speed[rows], np.ones(len(rows))) for rows in of.values()])
    for value, rows in of.items():
        n = max(len(rows) / frames, 1.0)
        mean = _measured(speed[rows], np.ones(len(rows)), n, usual * float(speed[rows].mean()))
        yield Plateau(
            session.name, name, value, mean, Measured(), Measured(), Measured(), n, len(rows),
            int((np.diff(rows) != 1).sum()) + 1, float(last[rows].sum()), 0)
