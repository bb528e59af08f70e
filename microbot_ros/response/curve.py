"""Fit of the effect `drive_response` to the plateaus of robots of one kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import fdtri

from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.effects.velocity.drive_response import DriveResponse
from microbot_ros.response.plateaus import Measured

FEWEST_LEVELS = 4
"""Frequencies needed to separate cut-in and step-out from a constant gain: one per parameter."""
_ALL_SHAPES = 6
"""Choice: frequencies needed to fit the steepness of the step-out as well.

That of the cut-in keeps its default: plateaus below the cut-in, which would determine it, are
rarely recorded.
"""
_LEAST_SCATTER = 0.02
"""Choice: least relative deviation of a robot from any law (slips, rough glass)."""
_GRID, _HALVINGS = 14, 5  # choices: trial values of a profile, and bisections of its end


@dataclass(frozen=True)
class DriveCurve:
    """Law fitted to robots of one kind.

    Attributes
    ----------
    effect : DriveResponse
    gains : (R,) array [m/s/Hz]
        Gain of each robot.
    cut_in, step_out, slip : Measured
        In [Hz], [Hz] and 1, with 95 % profile-likelihood intervals, infinite if unbounded.
    scatter : float
        Relative deviation of the plateaus from the law.
    """

    effect: DriveResponse
    gains: np.ndarray
    cut_in: Measured
    step_out: Measured
    slip: Measured
    scatter: float

    def steps_out(self, highest: float) -> bool:
        """Return whether the speed falls below the `highest` driven frequency [Hz].

        If not, the gain may still fall with frequency: rollers slip.

        Parameters
        ----------
        highest : float
            Highest driven frequency [Hz].

        Returns
        -------
        bool
            Whether it does.
        """
        speeds = self.speed(np.linspace(highest / 200, highest, 200))
        return bool(speeds[-1] < 0.9 * speeds.max() and self.step_out.high < highest)

    def speed(self, frequency: np.ndarray) -> np.ndarray:
        """Return the speed [m/s] of a robot of mean gain at each `frequency` [Hz].

        Parameters
        ----------
        frequency : ndarray
            Frequencies, of any shape [Hz].

        Returns
        -------
        ndarray
            Speeds [m/s], of the same shape.
        """
        found: np.ndarray = self.gains.mean() * frequency * _factor(self.effect, frequency)
        return found


def fit_curve(frequency: np.ndarray, speed: np.ndarray, std: np.ndarray, robot: np.ndarray,
              ) -> DriveCurve | None:
    """Fit the law to speeds at driven frequencies; robots share the law and have a gain each.

    Parameters
    ----------
    frequency : (N,) array [Hz]
        Driven frequency of each measurement.
    speed, std : (N,) array [m/s]
        Measured speed and its standard deviation.
    robot : (N,) int array
        Index of the robot from 0.

    Returns
    -------
    DriveCurve or None
        None for fewer than 4 frequencies.
    """
    known = np.isfinite(speed) & (frequency > 0)
    frequency, speed, robot = frequency[known], speed[known], robot[known]
    std = np.where(np.isfinite(std[known]), std[known], 0.0)
    count = len(np.unique(frequency))
    names, robot = np.unique(robot, return_inverse=True)
    if count < FEWEST_LEVELS or len(speed) <= len(names) + 3:
        return None
    fit = _Fit(frequency, speed, std, robot, len(names), count >= _ALL_SHAPES)
    shape, _ = fit.best()
    for _ in range(3):
        fit.estimate_scatter(shape)
        shape, cost = fit.best(shape)
    free = max(len(speed) - len(names) - len(shape), 1)
    limit = cost * (1 + float(fdtri(1, free, 0.95)) / free)
    cut_in, slip, step_out = (fit.profile(k, shape, limit) for k in range(3))
    return DriveCurve(fit.effect(shape), fit.gains(shape), cut_in, step_out, slip, fit.scatter)


def _factor(effect: DriveResponse, frequency: np.ndarray) -> np.ndarray:
    nothing = np.zeros(len(frequency))
    context = EffectContext(nothing, nothing, np.zeros((len(frequency), 2)), frequency, 1.0)
    return np.asarray(effect.speed_factor(context))


class _Fit:
    """Weighted least squares: the gains are solved for, the shape is searched."""

    def __init__(self, frequency: np.ndarray, speed: np.ndarray, std: np.ndarray,
                 robot: np.ndarray, robots: int, steepness: bool) -> None:
        self._frequency, self._speed, self._robot = frequency, speed, robot
        self._std, self._robots = std, robots
        declared = {one.field: one for one in DriveResponse.parameters()}
        self._names = ['cut_in', 'slip', 'step_out', 'step_out_steepness'][:4 if steepness else 3]
        self.low = np.array([declared[name].low for name in self._names])
        self.high = np.array([declared[name].high for name in self._names])
        # A negative slip (gain growing with frequency) could replace any cut-in.
        self.low[self._names.index('slip')] = 0.0
        self.scatter = 0.1
        self._weight = self._weights(speed)

    def _weights(self, expected: np.ndarray) -> np.ndarray:
        # A relative error alone would vanish where robots hardly move.
        floor = np.maximum(np.abs(expected), 0.05 * np.abs(self._speed).max())
        weight: np.ndarray = (self._std**2 + (self.scatter * floor) ** 2) ** -0.5
        return weight

    def effect(self, shape: np.ndarray) -> DriveResponse:
        values = dict(zip(self._names, shape.tolist(), strict=True))
        # A step-out below the cut-in would act as a second cut-in.
        values['step_out'] = max(values['step_out'], values['cut_in'])
        return DriveResponse(**values)

    def gains(self, shape: np.ndarray) -> np.ndarray:
        column = self._frequency * _factor(self.effect(shape), self._frequency)
        weight = self._weight**2
        power = np.bincount(self._robot, weight * column**2, self._robots)
        product = np.bincount(self._robot, weight * column * self._speed, self._robots)
        gains: np.ndarray = product / np.maximum(power, 1e-300)
        return gains

    def expected(self, shape: np.ndarray) -> np.ndarray:
        own: np.ndarray = self.gains(shape)[self._robot]
        return own * self._frequency * _factor(self.effect(shape), self._frequency)

    def residuals(self, shape: np.ndarray) -> np.ndarray:
        left: np.ndarray = self._weight * (self._speed - self.expected(shape))
        return left

    def estimate_scatter(self, shape: np.ndarray) -> None:
        expected = self.expected(shape)
        floor = np.maximum(np.abs(expected), 0.05 * np.abs(self._speed).max())
        excess = ((self._speed - expected) ** 2 - self._std**2) / floor**2
        free = max(len(expected) - self._robots - len(shape), 1)
        self.scatter = float(np.sqrt(max(excess.sum() / free, _LEAST_SCATTER**2)))
        self._weight = self._weights(expected)

    def best(self, near: np.ndarray | None = None, fixed: tuple[int, float] | None = None,
             ) -> tuple[np.ndarray, float]:
        """Return the best shape and its cost, started `near` one or everywhere."""
        free = [k for k in range(len(self.low)) if fixed is None or k != fixed[0]]

        def whole(part: np.ndarray) -> np.ndarray:
            shape = np.empty(len(self.low))
            shape[free] = part
            if fixed is not None:
                shape[fixed[0]] = fixed[1]
            return shape

        found: tuple[np.ndarray, float] | None = None
        for start in [near] if near is not None else self._starts():
            part = np.clip(start, self.low + 1e-6, self.high - 1e-6)[free]
            result = least_squares(lambda part: self.residuals(whole(part)), part,
                                   bounds=(self.low[free], self.high[free]), x_scale='jac',
                                   max_nfev=60)
            if found is None or 2 * result.cost < found[1]:
                found = whole(result.x), float(2 * result.cost)
        assert found is not None
        return found

    def _starts(self) -> list[np.ndarray]:
        low, *corners = np.quantile(np.unique(self._frequency), [0.1, 0.3, 0.6, 0.9])
        return [np.array([low / 2, slip, corner, 4.0])[:len(self.low)]
                for corner in corners for slip in (0.1, 0.6)]

    def profile(self, k: int, shape: np.ndarray, limit: float) -> Measured:
        """Return entry `k` of the shape, and where its profile cost is below `limit`."""
        value = float(shape[k])
        ends = []
        for bound in (self.low[k], self.high[k]):
            inside, near, outside = value, shape, np.nan
            for share in np.geomspace(0.01, 1.0, _GRID):
                trial = value + share * (bound - value)
                near, cost = self.best(near, (k, float(trial)))
                if cost > limit:
                    outside = float(trial)
                    break
                inside = float(trial)
            if np.isnan(outside):
                # 0 is a physical bound; any other is only the end of the search.
                ends.append(0.0 if bound == 0 else np.copysign(np.inf, bound - value))
                continue
            for _ in range(_HALVINGS):
                trial = (inside + outside) / 2
                if self.best(near, (k, trial))[1] > limit:
                    outside = trial
                else:
                    inside = trial
            ends.append((inside + outside) / 2)
        return Measured(value, np.nan, *ends)
