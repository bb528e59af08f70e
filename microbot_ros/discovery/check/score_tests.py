"""Residual maps: χ² tests of the whitened residual against one covariate each.

With U orthonormal functions of a covariate, orthogonal to all fitted parameters and to an error of
the clock, T = ‖Uᵀr‖² is χ² if the model is complete (a score test: Rao 1948). P-values are
adjusted by Holm's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import solve_banded

from microbot_ros.discovery.check.covariates import Covariates, Group
from microbot_ros.discovery.check.tail_probabilities import chi_square_tail, peak_tail_probability
from microbot_ros.discovery.check.time_shift import time_shifts
from microbot_ros.discovery.processes import Run, serially
from microbot_ros.discovery.result import HORIZON, ResidualMap
from microbot_ros.discovery.starting_points import background, rotating_components
from microbot_ros.estimation.likelihood.joint import (
    SessionFit,
    eliminate,
    eliminate_shared,
    inner,
    solve,
)
from microbot_ros.estimation.likelihood.model_fit import ModelFit

RANK = 1e-6
"""Eigenvalue, relative to 1 for an independent column, below which a direction is already fitted.

Choice: well above rounding errors of double precision in inner products.
"""

BINS = 12
"""Bins of a covariate in a figure. Choice: enough for the shape, with small errors in each."""

DIRECTED = 0.02
"""Fraction of its largest speed below which a particle has no direction to draw along.

Choice: at 2 % rounding and cancellation decide the direction.
"""


def residual_maps(fit: ModelFit, run: Run = serially) -> tuple[ResidualMap, ...]:
    """Compute all residual maps of a fit.

    Parameters
    ----------
    fit : ModelFit
        Any fit.
    run : Run, optional
        Distributes the maps.

    Returns
    -------
    tuple of ResidualMap
        P-values are adjusted for all of them by Holm's method.
    """
    fitted = [
        np.concatenate([jacobian, shift.column], axis=-1) if shift and shift.is_of_clock
        else jacobian for jacobian, shift in zip(fit.jacobian, time_shifts(fit), strict=True)]
    covariates = [Covariates(p) for p in fit.session_fits]
    by_name: dict[str, list[tuple[int, Group]]] = {}
    for k, context in enumerate(covariates):
        for group in context.groups():
            by_name.setdefault(group.against, []).append((k, group))
    raw = list(run(partial(_tested, fit, fitted), list(by_name.values())))
    raw += [_rhythm(fit, fitted), _rhythm(fit, fitted, covariates), _single_steps(fit)]
    adjusted = _holm([m.p_value for m in raw])
    return tuple(
        replace(m, p_value=p) for m, p in zip(raw, adjusted, strict=True)
    )


def _holm(p_values: list[float]) -> list[float]:
    """Return adjusted p-values: the smallest times their number, and so on, never falling."""
    order = np.argsort(p_values)
    adjusted = np.array(p_values)[order] * np.arange(len(order), 0, -1)
    result = np.empty(len(order))
    result[order] = np.minimum(np.maximum.accumulate(adjusted), 1.0)
    return [float(p) for p in result]


def _tested(fit: ModelFit, jacobian: Sequence[np.ndarray],
            groups: list[tuple[int, Group]]) -> ResidualMap:
    """Test one covariate over the sessions that have it, each with its own coefficients."""
    statistic, dof, squares = 0.0, 0, np.empty(0)
    for k, group in groups:
        value, rank, moved = _score(fit.session_fits[k], jacobian[k], group.fields)
        statistic, dof, squares = statistic + value, dof + rank, np.append(squares, moved)
    group = groups[0][1]
    middles, curves = _curves(fit.session_fits[groups[0][0]], group)
    p_value = chi_square_tail(statistic, dof) if dof else 1.0
    return ResidualMap(group.against, group.label, statistic, dof, p_value, middles, curves,
                       size=_size(statistic, dof, squares))


def _size(statistic: float, dof: int, squares: np.ndarray) -> float:
    """Return the size of what a map shows, less what χ² of `dof` would show by chance.

    From the `squares` (R,) of `_score`; infinite without any.
    """
    beyond_chance = max(1 - dof / max(statistic, 1e-300), 0.0)
    return float(np.sqrt(squares.mean() * beyond_chance)) if squares.size else np.inf


def squared_floor(p: SessionFit, horizon: float) -> float:
    """Return the mean square error of predictions by a complete model.

    Parameters
    ----------
    p : SessionFit
        Fit whose noise makes the floor.
    horizon : float
        Prediction horizon [s].

    Returns
    -------
    float
        2D·horizon + 2σ², plus fluctuations of velocity; of one axis [m²].
    """
    frames = max(round(horizon / p.session.interval), 1)
    return (2 * p.diffusion * (frames * p.session.interval + max(p.whitening.noise_ratio, 0.0))
            + p.unsteady_motion(horizon))


def _score(p: SessionFit, jacobian: np.ndarray, fields: np.ndarray,
           lead: float = HORIZON) -> tuple[float, int, np.ndarray]:
    """Return T and its degrees of freedom for velocity fields (T − 1, N, M) and their normals.

    Also the squared displacements (R,) over the time `lead` [s] by the best of these fields,
    beyond what v and φ absorb, in units of the noise floor of a prediction over HORIZON.
    """
    columns = np.zeros((len(p.session.times), *fields.shape[1:]), complex)
    moved = np.nan_to_num(fields) * np.diff(p.session.times)[:, None, None]
    np.cumsum(moved, axis=0, out=columns[1:])
    known = np.concatenate([p.white / np.sqrt(p.diffusion), jacobian], axis=-1)
    gram = along_and_across(known, p.whiten(columns)) if p.whitening.is_plain else inner(
        np.concatenate([known, p.whiten(np.concatenate([columns, 1j * columns], -1))], axis=-1))
    raw = np.diagonal(gram, axis1=1, axis2=2)[:, 3:].sum(axis=0)
    count = jacobian.shape[-1]
    total = eliminate_shared(eliminate(gram).sum(axis=0), count)
    size = np.sqrt(np.maximum(raw[count:], 1e-300))
    information = total[1:, 1:] / np.outer(size, size)
    values, vectors = np.linalg.eigh(information)
    kept = values > RANK
    found = vectors[:, kept].T @ (total[1:, 0] / size)
    best = vectors[:, kept] @ (found / values[kept]) / size
    absorbed = solve(gram[:, 1:3, 1:3], gram[:, 1:3, 3 + count:] @ best[:, None])[..., 0]
    left = columns @ (best[:len(best) // 2] + 1j * best[len(best) // 2:]) - (
        p.expected.along * absorbed[:, 0] + p.expected.across * absorbed[:, 1])
    ahead = min(max(round(lead / p.session.interval), 1), len(left) - 1)
    moved = (left[ahead:] - left[:-ahead])[p.session.joined(ahead)]
    return (float((found**2 / values[kept]).sum()), int(kept.sum()),
            np.abs(moved) ** 2 / 2 / squared_floor(p, HORIZON))


def along_and_across(known: np.ndarray, white: np.ndarray) -> np.ndarray:
    """Return real inner products of known columns, of complex columns, and of these times i.

    All are parts of the complex inner products, of which there are half as many.

    Parameters
    ----------
    known : ndarray of complex, shape (T, N, L)
        Columns of the data and the fitted parameters.
    white : ndarray of complex, shape (T, N, M)
        Columns of the tested fields.

    Returns
    -------
    ndarray, shape (N, L + 2M, L + 2M)
        Inner products for each track.
    """
    every = np.ascontiguousarray(np.concatenate([known, white], axis=-1).transpose(1, 2, 0))
    product = every.conj() @ every.transpose(0, 2, 1)
    first = known.shape[-1]
    same, turned = product.real, -product.imag[:, :, first:]
    return np.block([[same, turned], [np.swapaxes(turned, 1, 2), same[:, first:, first:]]])


def _rhythm(fit: ModelFit, jacobian: Sequence[np.ndarray],
            covariates: list[Covariates] | None = None) -> ResidualMap:
    """Return the largest peak of a periodogram: in the laboratory, or in the particles' frame.

    For the longest session. In the laboratory both axes count together (χ² of 4). Along and across
    the heading they count apart, since speed and angle may oscillate (χ² of 2 each). A peak is
    measured against the noise around it: a wandering speed is broad, and no rhythm. Its size is
    the displacement over half a period, or over HORIZON if that is shorter.
    """
    k = int(np.argmax([np.ptp(p.session.times) for p in fit.session_fits]))
    p = fit.session_fits[k]
    fastest = 0.4 / p.session.interval
    if covariates is None:
        frequency, *turned = rotating_components(p.session.times, p.residual.sum(axis=1), fastest)
        power = (np.abs(np.array(turned)) ** 2).sum(axis=0) / p.count
        name, dof, signals = 'rhythm', 4, 1
        direction = np.ones_like(p.residual)
    else:
        direction = np.zeros_like(p.residual)
        direction[1:] = covariates[k].body * np.abs(p.velocity_phasor)
        weight = max(float((np.abs(direction) ** 2 * p.session.seen).sum()), 1e-300)
        own = (p.residual * direction.conj()).sum(axis=1)
        axes = [rotating_components(p.session.times, axis, fastest)
                for axis in (own.real, own.imag)]
        frequency = axes[0][0]
        power = np.max([2 * np.abs(ahead) ** 2 / weight for _, ahead, _ in axes], axis=0)
        name, dof, signals = 'rhythm, along the heading', 2, 2
    power = power / background(power, dof, signals)
    best, peak = float(power.max()), float(frequency[power.argmax()])
    p_value = peak_tail_probability(best, dof, signals * fastest * float(np.ptp(p.session.times)))
    wave = np.exp(2j * np.pi * peak * p.session.times[1:, None])
    fields = np.stack([direction[1:] * wave.real, direction[1:] * wave.imag], axis=-1)
    squares = _score(p, jacobian[k], fields, min(HORIZON, 0.5 / peak))[2]
    return ResidualMap(name, 'frequency [Hz]', best, dof, p_value, frequency, {
        'power': (power, np.zeros(len(frequency)))}, size=_size(best, dof, squares))


def _single_steps(fit: ModelFit) -> ResidualMap:
    """Return the largest step of one particle or of all at once, and jumps that were cut out.

    It decides nothing: trackers slip and stages are touched, whatever the physics.
    """
    worst, trials = 0.0, 0
    for p in fit.session_fits:
        number = np.maximum((p.residual != 0).sum(axis=1, keepdims=True), 1)
        for white in (p.residual, p.residual.sum(axis=1, keepdims=True) / np.sqrt(number)):
            for residual in (white, _lasting(p, white)):
                worst = max(worst, float((np.abs(residual) ** 2).max()))
            trials += 2 * int((white != 0).sum())
    jumps = sum(int(p.session.jumps.sum()) for p in fit.session_fits)
    p_value = float(min(1.0, trials * np.exp(-worst / 2)))
    return ResidualMap('single steps', 'time [s]', worst, 2, 0.0 if jumps else p_value,
                       np.empty(0), {}, cut_out=True)


def _lasting(p: SessionFit, white: np.ndarray) -> np.ndarray:
    """Return whitened residuals (T, N) matched to a lasting step, for large localisation errors.

    The local-level filter follows a step by a fraction K, its steady gain, at every frame. The
    residual keeps (1 − K)^k of the step k frames later.
    """
    if p.whitening.noise_ratio <= 0:
        return white
    ratio = 2 * p.session.interval / p.whitening.noise_ratio
    kept = 1 - (np.sqrt(ratio**2 + 4 * ratio) - ratio) / 2
    # Not by scipy.signal, whose import takes half a second.
    recursion = np.stack([np.full(len(white), -kept), np.ones(len(white))])
    matched: np.ndarray = solve_banded((0, 1), recursion, np.sqrt(1 - kept**2) * white)
    return matched


def _curves(
    p: SessionFit, group: Group,
) -> tuple[np.ndarray, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Return the mean residual velocity along and across the frame, in bins of the covariate."""
    e = p.session
    left = np.diff(e.z - p.expected.at(p.velocity_phasor), axis=0)
    length = np.abs(group.frame)
    use = e.joined() & np.isfinite(group.value) & (length > DIRECTED)
    turned = left * np.conj(group.frame) / np.maximum(length, DIRECTED) / np.diff(e.times)[:, None]
    # Levels that differ by rounding errors are equal.
    value, velocity = np.round(group.value[use], 6), turned[use]
    if not value.size:
        return np.empty(0), {}
    edges = np.unique(np.quantile(value, np.linspace(0, 1, BINS + 1)))
    which = np.clip(np.searchsorted(edges, value, side='right') - 1, 0, max(len(edges) - 2, 0))
    count = np.bincount(which)
    filled = count > 2
    middles = (np.bincount(which, value) / np.maximum(count, 1))[filled]
    fixed = bool((group.frame == 1).all())
    curves = {}
    for name, part in zip(('x', 'y') if fixed else ('along', 'across'),
                          (velocity.real, velocity.imag), strict=True):
        mean = np.bincount(which, part) / np.maximum(count, 1)
        spread = np.sqrt(np.bincount(which, (part - mean[which]) ** 2)) / np.maximum(count, 1)
        curves[name] = mean[filled], spread[filled]
    return middles, curves
