"""95 % intervals of all published estimates, by curvature or by profile likelihood.

Model selection widens them: where other models are possible, the spread of their estimates,
weighted by probability, is added to the variance (Hoeting et al. 1999).

An effect whose likelihood is not a parabola, such as a field scale far above the fields in use,
shifts v and φ with it. Its interval ends where the profile likelihood has fallen by χ²/2 (Venzon
and Moolgavkar 1988). That of v contains the intervals at all points of the profile.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from microbot_ros.discovery.result import Estimate, Particle
from microbot_ros.estimation.likelihood.model_fit import ModelFit, maximise
from microbot_ros.estimation.likelihood.noise import Noise
from microbot_ros.estimation.likelihood.phasor import Polar
from microbot_ros.model.parameter import Parameter

ROOT = 1.96
"""Square root of twice the fall in log likelihood at the ends of a 95 % interval: √χ²(0.95, 1)."""

BENT = 0.1
"""Error of an interval's end, as a fraction of its half-width, above which the profile is
computed.

Choice: half of it computes profiles, of some ten fits each, for intervals that hardly change."""

FURTHEST, TRIED = 4.0, 5
"""Largest and smallest ratio of distances of successive points of a profile, and the most points
tried per side (`TRIED`).

Choice: larger steps may leave the region where a fit converges; fewer points may not reach the
end, more cost one fit each."""

STEPS = 5
"""Maximum number of steps in which the other parameters follow a held one.

Choice: neighbouring points of a profile start close to their maximum.
"""

GRID = 200
"""Points at which a profile is interpolated. Choice: 0.02 standard deviations apart, far below
BENT."""


@dataclass(frozen=True)
class _Profile:
    """Fits with one parameter held, in ascending order of its coordinate `x` (K,).

    `root` (K,) is the signed square root of twice the fall in log likelihood, 0 at the maximum.
    `polars[k][s]` belong to session s at point k, without the uncertainty of the parameter itself.
    """

    x: np.ndarray
    root: np.ndarray
    polars: list[list[Polar]]

    def ends(self) -> tuple[float, float]:
        """Return the ends of the interval in fit coordinates, or the bounds of the parameter."""
        low, high = np.interp([-ROOT, ROOT], self.root, self.x)
        return float(low), float(high)

    def hull(self, session: int, quantity: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and upper ends (N,) of `speed` or `phi` over the whole profile."""
        fine = np.linspace(max(self.root[0], -ROOT), min(self.root[-1], ROOT), GRID)
        value, std = (np.array([getattr(p[session], quantity + part) for p in self.polars])
                      for part in ('', '_std'))
        if quantity == 'phi':
            value = np.unwrap(value, axis=0)
        value, std = (_interpolated(fine, self.root, of) for of in (value, std))
        left = std * np.sqrt(np.maximum(ROOT**2 - fine**2, 0.0))[:, None]
        return (value - left).min(axis=0), (value + left).max(axis=0)


def _interpolated(at: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(at, x, one) for one in y.T], axis=1)


class Intervals:
    """Estimates with 95 % intervals of all parameters of a fit.

    Parameters
    ----------
    fit : ModelFit
        The published fit.
    complete : bool, optional
        Whether the model explains the data. If not, intervals are by curvature alone: profiles
        take too long for a model that is wrong.
    others : sequence of (ModelFit, float), optional
        Fits of other models to the same rows that may be true, with their probabilities.
    """

    def __init__(self, fit: ModelFit, complete: bool = True,
                 others: Sequence[tuple[ModelFit, float]] = ()) -> None:
        self._fit, self._complete, self._others = fit, complete, others
        self._std = np.sqrt(np.diag(fit.covariance))

    def effect(self, name: str) -> dict[str, Estimate]:
        """Return the parameters of an effect.

        Parameters
        ----------
        name : str
            Id of the effect.

        Returns
        -------
        dict of str to Estimate
            By parameter name, SI. Those of a reciprocal parameter are by the delta method.
        """
        result = {}
        for k, (effect, parameter) in enumerate(self._fit.model.parameters):
            if effect == name:
                result[parameter.name] = self._parameter(k, parameter)
        return result

    def _parameter(self, k: int, parameter: Parameter) -> Estimate:
        x, std = float(self._fit.model.vector()[k]), float(self._std[k])
        slope = parameter.scale / x**2 if parameter.inverse and x else parameter.scale
        value = parameter.from_fit(x)
        if parameter.is_angle:  # without bounds
            return Estimate.normal(value, std * slope)
        ends = (self._profiles[k].ends() if k in self._profiles
                else (x - ROOT * std, x + ROOT * std))
        apart = 0.0
        for other, p in self._others:
            known = dict(zip(other.model.parameters, other.model.vector(), strict=True))
            apart += p * (known.get(self._fit.model.parameters[k], x) - x) ** 2
        low, high = sorted(parameter.from_fit(float(end))
                           for end in _widened(np.array(ends), x, apart))
        return Estimate(value, float(np.sqrt(std**2 + apart)) * slope, low, high)

    @cached_property
    def _profiles(self) -> dict[int, _Profile]:
        """Profiles of parameters whose likelihood is not a parabola, by index in the vector."""
        return {k: found for k, (_, parameter) in enumerate(self._fit.model.parameters)
                if self._complete and np.isfinite(self._std[k]) and not parameter.is_angle
                and (found := _follow(self._fit, k, float(self._std[k]), parameter))}

    def particles(self) -> tuple[Particle, ...]:
        """Return speed, φ and force of every particle, over its longest track.

        Returns
        -------
        tuple of Particle
            Particles of all sessions; with several sessions the name begins with that of the
            session.
        """
        return tuple(
            particle for s, polar in enumerate(self._fit.polars())
            for particle in self._of_session(s, polar))

    def _of_session(self, s: int, polar: Polar) -> Iterator[Particle]:
        session = self._fit.session_fits[s].session
        speed, phi = (self._ends(s, polar, quantity) for quantity in ('speed', 'phi'))
        speed_apart, phi_apart = self._apart(s, polar)
        speed, phi = _widened(speed, polar.speed, speed_apart), _widened(phi, polar.phi, phi_apart)
        polar = polar.widened(np.sqrt(speed_apart) / polar.speed + 1j * np.sqrt(phi_apart))
        speed = np.maximum(speed, 0.0)
        force, force_std = polar.force(session.conditions)
        drag = np.divide(force, polar.speed)
        known = np.sqrt(np.maximum(force_std**2 - (drag * polar.speed_std) ** 2, 0.0))
        off = np.hypot(ROOT * known, drag * (speed - polar.speed))
        for n in session.main:
            name = session.ids[n]
            label = str(name) if len(self._fit.session_fits) == 1 else f'{session.name}:{name}'
            yield Particle(
                label, Estimate.of(polar.speed[n], polar.speed_std[n], speed[:, n]),
                Estimate.of(polar.phi[n], polar.phi_std[n], phi[:, n]),
                Estimate.of(force[n], force_std[n],
                            force[n] + np.array([-1.0, 1.0]) * off[:, n]))

    def _apart(self, s: int, polar: Polar) -> tuple[np.ndarray, np.ndarray]:
        """Return the variances (N,) of speed and φ that other models add in session `s`."""
        speed, phi = np.zeros((2, len(polar.speed)))
        for other, p in self._others:
            there = other.session_fits[s].polar()
            turned = np.angle(np.exp(1j * (there.phi - polar.phi)))
            speed += p * np.nan_to_num(there.speed - polar.speed) ** 2
            phi += p * np.nan_to_num(turned) ** 2
        return speed, phi

    def _ends(self, s: int, polar: Polar, quantity: str) -> np.ndarray:
        """Return lower and upper ends (2, N): by curvature, or the widest of all profiles."""
        value, std = getattr(polar, quantity), getattr(polar, quantity + '_std')
        if not self._profiles:
            return np.stack([value - ROOT * std, value + ROOT * std])
        hulls = [profile.hull(s, quantity) for profile in self._profiles.values()]
        return np.stack([np.min([low for low, _ in hulls], axis=0),
                         np.max([high for _, high in hulls], axis=0)])

    def diffusion(self) -> Estimate:
        """Return the diffusion coefficient, averaged over sessions.

        Returns
        -------
        Estimate
            D [m²/s].
        """
        return _mean([_diffusion(n) for n in self._noises])

    def localisation(self) -> Estimate:
        """Return the localisation error, averaged over sessions.

        Returns
        -------
        Estimate
            σ [m]; its interval may begin at 0.
        """
        return _mean([_localisation(n) for n in self._noises])

    @cached_property
    def _noises(self) -> list[Noise]:
        """D and σ of every session, as for an instantaneous exposure.

        An exposure of duration E would add DE/3 to σ².
        """
        return [p.noise() for p in self._fit.session_fits]


def _widened(ends: np.ndarray, value: np.ndarray | float,
             variance: np.ndarray | float) -> np.ndarray:
    """Return the `ends` (2, ...) of an interval about a `value` after adding a `variance`."""
    side = np.sign(ends - value)
    moved: np.ndarray = value + side * np.sqrt((ends - value) ** 2 + ROOT**2 * variance)
    return moved


def _follow(fit: ModelFit, k: int, std: float, parameter: Parameter) -> _Profile | None:
    """Return the profile of the `k`-th parameter; None where it is the parabola of `std`."""
    x, bounds = float(fit.model.vector()[k]), parameter.fit_bounds
    ends = [_held(fit, k, float(np.clip(x + side * ROOT * std, *bounds)), fit)
            for side in (-1, 1)]
    expected = [abs(_at(end, k) - x) / std for end in ends]
    if all(abs(_root(end, fit) - root) < BENT * ROOT
           for end, root in zip(ends, expected, strict=True)):
        return None
    points = [fit]
    for side, end in zip((-1, 1), ends, strict=True):
        points += _walk(fit, k, side, end, bounds)
    points = _rising(sorted(points, key=lambda one: _at(one, k)), fit)
    at = np.array([_at(one, k) for one in points])
    root = np.array([np.sign(one - x) * _root(point, fit)
                     for one, point in zip(at, points, strict=True)])
    return _Profile(at, root, [point.polars(held=k) for point in points])


def _walk(fit: ModelFit, k: int, side: int, last: ModelFit,
          bounds: tuple[float, float]) -> list[ModelFit]:
    """Return points on one side of the maximum, to the end of the interval or a bound."""
    x = _at(fit, k)
    points = [last]
    for _ in range(TRIED):
        root, distance = _root(last, fit), abs(_at(last, k) - x)
        if abs(root - ROOT) < BENT or distance == 0:
            break
        further = distance * float(np.clip(ROOT / max(root, 1e-3), 1 / FURTHEST, FURTHEST))
        at = float(np.clip(x + side * further, *bounds))
        if at == _at(last, k):
            break
        last = _held(fit, k, at, last)
        points.append(last)
    if _root(last, fit) < ROOT - BENT:  # a flat profile may have no end before the bound
        last = _held(fit, k, bounds[side > 0], last)
        points.append(last)
    middle = [_held(fit, k, x + part * (_at(last, k) - x), last) for part in (0.33, 0.67)]
    return [*points, *middle]


def _rising(points: list[ModelFit], best: ModelFit) -> list[ModelFit]:
    """Return the points around the `best`, as far as the likelihood falls monotonically."""
    middle = next(k for k, point in enumerate(points) if point is best)
    kept = [best]
    for side in (points[middle + 1:], points[:middle][::-1]):
        most = 0.0
        for point in side:
            if _root(point, best) > most:
                most = _root(point, best)
                kept.append(point)
    return [point for point in points if any(point is one for one in kept)]


def _held(fit: ModelFit, k: int, at: float, near: ModelFit) -> ModelFit:
    """Return the best fit with the `k`-th parameter held `at` a coordinate, from one `near`."""
    vector = near.model.vector()
    vector[k] = at
    return maximise(fit.under(fit.model.with_vector(vector)), STEPS, held=k)


def _at(fit: ModelFit, k: int) -> float:
    return float(fit.model.vector()[k])


def _root(fit: ModelFit, best: ModelFit) -> float:
    return float(np.sqrt(max(fit.cost - best.cost, 0.0)))


def _diffusion(noise: Noise) -> Estimate:
    factor = float(np.exp(ROOT * noise.diffusion_std / noise.diffusion))
    return Estimate(noise.diffusion, noise.diffusion_std,
                    noise.diffusion / factor, noise.diffusion * factor)


def _localisation(noise: Noise) -> Estimate:
    """Return σ with an interval from the spread of σ², which is normal where that of σ is not."""
    square = noise.localisation**2
    spread = (noise.localisation + noise.localisation_std) ** 2 - square
    low, high = (float(np.sqrt(max(square + side * ROOT * spread, 0.0))) for side in (-1, 1))
    return Estimate(noise.localisation, noise.localisation_std, low, high)


def _mean(values: list[Estimate]) -> Estimate:
    value, std, low, high = (
        np.array([getattr(e, part) for e in values]) for part in ('value', 'std', 'low', 'high'))
    mean, below, above = (float(np.sqrt((part**2).sum())) / len(values)
                          for part in (std, value - low, high - value))
    middle = float(value.mean())
    return Estimate(middle, mean, middle - below, middle + above)
