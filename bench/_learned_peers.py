"""What others learn on the same sessions, and the gap that it leaves, judged as ours is.

StochasticForceInference with PASTIS: linear terms of a library as wide as our grammar, selected
beside its own estimator of localisation error.

GP-SDE: symbolic regression by genetic programming on the likelihood of increments, in which
localisation error has no place. Its programs (pyoperon: Burlacu et al. 2020) are told the
first-order motion, and may be drawn in the laboratory, along the heading or towards the nearest
neighbour, whichever the likelihood prefers at BIC's price.

ADCD (anomaly-driven correction discovery, Erdita 2026): templates of one variable, screened by
their limit and fitted by least squares. It gets the same rows and frames as GP-SDE, and each
variable with both limits in turn, of which its own BIC takes one. It runs in the environment of
`make foreign`; where that is not there it is left out.

What was selected is of all rows. From those that are shown the coefficients of the terms, or one
factor on a program, are learned anew, in our whitened likelihood: both can only gain by that.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench._foreign_worlds import PYTHON
from bench._learned_gap import Foretold, gaps, only_session
from bench._unlisted_worlds import film
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.estimation.likelihood.joint import eliminate, inner
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession

MICRO = 1e6
LONGEST = 15
"""Seconds of one regression by genetic programming; there are five."""

Velocities = np.ndarray
"""(T−1, N) complex [µm/s] of every track, between frames."""

Learns = Callable[[np.ndarray], Velocities]
"""From the rows (T,) that are shown."""


@dataclass(frozen=True)
class Judged:
    """What a `peer` left on a world: the gap `before` and `after` it [m]; `seconds` of CPU time to
    learn once from all rows, `said`: what it learned."""

    kind: str
    seed: int
    peer: str
    said: str
    before: float
    after: float
    seconds: float


def judge(case: tuple[str, int, str]) -> Judged:
    """One world, kind and seed, by one peer."""
    kind, seed, peer = case
    filmed = film(kind, seed)
    session = only_session(filmed)
    scene = _Scene.of(fit_first_order([session]))
    began = sum(os.times()[:4])
    learns, said = PEERS[peer](scene)
    spent = sum(os.times()[:4]) - began  # with the processes that it started
    step = np.diff(session.times)[:, None] / MICRO

    def base(shown: np.ndarray) -> Foretold:
        return fit_first_order([session.only(shown)]), 0.0

    def learned(shown: np.ndarray) -> Foretold:
        added = np.concatenate([np.zeros((1, session.z.shape[1])),
                                np.cumsum(np.nan_to_num(learns(shown)) * step, axis=0)])
        clean = replace(session, z=session.z - added)
        return fit_first_order([clean.only(shown)]), added

    before, after = gaps(filmed, session, [base, learned])
    return Judged(kind, seed, peer, said, before, after, spent)


@dataclass(frozen=True)
class _Scene:
    """What a peer is told: the `session` and first-order `fit`; in µm and s places (T, N), the
    motion of that fit `own` (T−1, N), what it leaves `left` (T−1, N), NaN where not seen; the
    nearest neighbour's `away` (T−1, N), a unit vector from it, and distance `apart` (T−1, N)."""

    session: PreparedSession
    fit: ModelFit
    z: np.ndarray
    own: np.ndarray
    left: np.ndarray
    away: np.ndarray
    apart: np.ndarray
    command: np.ndarray
    since: np.ndarray
    age: np.ndarray

    @classmethod
    def of(cls, fit: ModelFit) -> _Scene:
        """As the sessions of a `fit` have it."""
        known = fit.session_fits[0]
        session = known.session
        step = np.diff(session.times)[:, None] / MICRO
        z = np.where(session.seen, session.z, np.nan) * MICRO
        own = np.diff(known.expected.at(known.velocity_phasor), axis=0) / step
        moved = np.where(session.joined(), np.diff(session.z, axis=0) / step, np.nan)
        between = z[:-1, :, None] - z[:-1, None, :]
        far = np.where(np.isfinite(between) & (between != 0), np.abs(between), np.inf)
        nearest = far.argmin(axis=2)[..., None]
        apart = np.take_along_axis(far, nearest, axis=2)[..., 0]
        away = np.take_along_axis(between, nearest, axis=2)[..., 0] / apart
        times, commands = session.times[:-1], session.commands
        row = np.maximum(commands.index_at(times), 0)
        field = commands.field[row]
        return cls(session, fit, z, own, moved - own, np.where(np.isfinite(apart), away, 0),
                   apart, np.arctan2(field[:, 1], field[:, 0])[:, None],
                   (times - commands.t[row])[:, None],
                   (times[:, None] - times[0]) / np.ptp(times))

    @property
    def heading(self) -> np.ndarray:
        """Unit vectors (T−1, N) along the first-order motion."""
        return self.own / np.maximum(np.abs(self.own), 1e-9)


# StochasticForceInference -----------------------------------------------------------------------

def _features(scene: _Scene) -> dict[str, np.ndarray]:
    """The library: velocities (T−1, N) [µm/s] by name, the first-order motion first."""
    z, one = scene.z[:-1] / 50, np.ones_like(scene.own)
    x, y = z.real, z.imag
    factors = {f'cos {k}πt': np.cos(k * np.pi * scene.age) for k in range(1, 9)}
    angles = {f'{name} {m}{what}': call(m * angle)
              for what, angle in (('θ', np.angle(scene.own)), ('command', scene.command))
              for m in (1, 2, 3) for name, call in (('cos', np.cos), ('sin', np.sin))}
    falls = {f'exp −since/{tau}': np.exp(-scene.since / tau) for tau in (0.3, 1.0, 3.0)}
    places = {f'x{i}y{j}': x**i * y**j for i in range(4) for j in range(4 - i) if i + j}
    columns = {'own': scene.own, 'turned': 1j * scene.own}
    for name, factor in (('1', 1.0), *factors.items(), *places.items()):
        columns |= {f'{name} right': factor * one, f'{name} up': 1j * factor * one}
    short = {name: part for name, part in places.items() if len(name) == 4 and (
        int(name[1]) + int(name[3]) < 3)}
    for name, factor in (*factors.items(), *angles.items(), *falls.items(), *short.items()):
        columns |= {f'{name} ahead': factor * scene.own, f'{name} turned': 1j * factor * scene.own}
    if scene.z.shape[1] > 1:
        columns |= {f'away r^−{p}': scene.away * (10 / np.maximum(scene.apart, 1)) ** p
                    for p in (1, 2, 4)}
    return columns


def _force_inference(scene: _Scene) -> tuple[Learns, str]:
    columns = _features(scene)
    names = list(columns)
    stack = np.stack([np.broadcast_to(c, scene.own.shape) for c in columns.values()], axis=-1)
    kept = [k for k in _selected(scene, stack) if names[k] not in ('own', 'turned')]
    return _again(scene, stack[..., kept]), ', '.join(names[k] for k in kept)


def _selected(scene: _Scene, stack: np.ndarray) -> np.ndarray:
    """The columns of `stack` (T−1, N, M) that PASTIS keeps."""
    from SFI import OverdampedLangevinInference, TrajectoryCollection
    from SFI.statefunc import make_basis
    from SFI.trajectory.dataset import time_series_extra

    driven = np.nan_to_num(np.stack([stack.real, stack.imag], axis=2))
    driven = np.concatenate([driven, driven[-1:]])
    data = TrajectoryCollection.from_arrays(
        X=np.nan_to_num(np.stack([scene.z.real, scene.z.imag], axis=-1)),
        t=scene.session.times - scene.session.times[0], mask=np.isfinite(scene.z),
        extras_local={'driven': time_series_extra(driven)})
    basis = make_basis(
        lambda x, *, extras: extras['driven'] + 0 * x[:, None], dim=2, rank=1,
        n_features=stack.shape[-1], labels=[str(k) for k in range(stack.shape[-1])],
        extras_keys=('driven',), particle_extras=('driven',))
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        inference = OverdampedLangevinInference(data)
        inference.infer_force(basis)
        inference.sparsify_force(criterion='PASTIS')
    return np.asarray(inference.force_support)


def _again(scene: _Scene, columns: np.ndarray) -> Learns:
    """Coefficients of velocities `columns` (T−1, N, M), learned from the rows that are shown."""
    known = scene.fit.session_fits[0]
    session, expected = known.session, known.expected
    step = np.diff(session.times)[:, None, None] / MICRO
    moved = np.concatenate([np.zeros((1, *columns.shape[1:])),
                            np.cumsum(np.nan_to_num(columns) * step, axis=0)])
    own = [np.broadcast_to(part, session.z.shape)[..., None]
           for part in (session.z, expected.along, expected.across)]
    every = np.concatenate([*own, moved], axis=-1).astype(complex)

    def learns(shown: np.ndarray) -> Velocities:
        white, *_ = known.whitening.apply(session.only(shown), every)
        left = eliminate(inner(white)).sum(axis=0)
        weights = np.linalg.pinv(left[1:, 1:], rcond=1e-10, hermitian=True) @ left[1:, 0]
        return np.asarray(columns @ weights)

    return learns


# Formulas: genetic programming, and corrections by templates -------------------------------------

Regress = Callable[[np.ndarray, np.ndarray, np.ndarray, list[str]], tuple[np.ndarray, int, str]]
"""From inputs (n, M) and targets (n,), inputs (m, M) to foretell, and the names of the inputs:
what is foretold (m,), the number of constants, and the formula."""


def _formula(scene: _Scene, inputs: dict[str, np.ndarray],
             regress: Regress) -> tuple[Learns, str]:
    """The frame whose formulas the likelihood prefers, less what their size costs."""
    frames = {'laboratory': np.ones_like(scene.own), 'heading': scene.own,
              'neighbour': scene.away}
    best: tuple[float, np.ndarray, str] | None = None
    for name, frame in frames.items():
        if name == 'neighbour' and scene.z.shape[1] < 2:
            continue
        found, bits, said = np.zeros_like(scene.own), 0.0, name
        for way in (1, 1j) if name != 'neighbour' else (1,):
            values, gain, text = _factor(scene, inputs, frame * way, regress)
            found, bits, said = found + values * frame * way, bits + gain, f'{said}: {text}'
        if best is None or bits > best[0]:
            best = bits, found, said
    assert best is not None
    _, velocity, said = best
    return _again(scene, velocity[..., None]), said


def _genetic(scene: _Scene) -> tuple[Learns, str]:
    return _formula(scene, _inputs(scene), _program)


def _correction(scene: _Scene) -> tuple[Learns, str]:
    inputs = _inputs(scene)
    for angle, part in (('heading', scene.heading), ('command', np.exp(1j * scene.command))):
        del inputs[f'cos_{angle}'], inputs[f'sin_{angle}']
        inputs[angle] = np.broadcast_to(np.angle(part), scene.own.shape)
    return _formula(scene, inputs, _template)


def _inputs(scene: _Scene) -> dict[str, np.ndarray]:
    z = scene.z[:-1] / 10
    raw = {'x': z.real, 'y': z.imag, 't': 10 * scene.age, 'since': scene.since,
           'cos_heading': scene.heading.real, 'sin_heading': scene.heading.imag,
           'cos_command': np.cos(scene.command), 'sin_command': np.sin(scene.command),
           'distance': np.minimum(scene.apart, 1e3) / 10}
    return {name: np.broadcast_to(part, scene.own.shape) for name, part in raw.items()
            if name != 'distance' or scene.z.shape[1] > 1}


def _factor(scene: _Scene, inputs: dict[str, np.ndarray], frame: np.ndarray,
            regress: Regress) -> tuple[np.ndarray, float, str]:
    """A factor (T−1, N) on `frame` by regression, its gain in log likelihood less its price, and
    its text."""
    size = np.abs(frame)
    use = np.isfinite(scene.left) & (size > 0.02)
    target = (scene.left * np.conj(frame)).real[use] / size[use] ** 2
    design = np.stack([part[use] for part in inputs.values()], axis=1)
    # Of a factor on a small velocity little is known: rows are as good as that is large.
    rows = np.random.default_rng(0).choice(
        len(target), len(target), p=size[use] ** 2 / (size[use] ** 2).sum())
    every = np.stack([np.nan_to_num(part).ravel() for part in inputs.values()], axis=1)
    foretold, constants, text = regress(design[rows], target[rows], every, list(inputs))
    values = np.nan_to_num(foretold).reshape(frame.shape)
    limit = np.quantile(np.abs(values[use]), 0.999)
    values = np.clip(values, -limit, limit)
    noise = np.nanvar(scene.left) / 2
    done, known = values[use] * size[use], target * size[use]
    gain = float((known**2 - (known - done) ** 2).sum() / (2 * noise))
    return values, gain - constants * np.log(len(target)) / 2, text


def _program(design: np.ndarray, target: np.ndarray, every: np.ndarray,
             names: list[str]) -> tuple[np.ndarray, int, str]:
    from pyoperon.sklearn import SymbolicRegressor

    found = SymbolicRegressor(
        allowed_symbols='add,sub,mul,div,exp,sin,cos,pow,square,constant,variable',
        optimizer_iterations=5, max_length=20, population_size=500, generations=200,
        max_time=LONGEST, n_threads=1, random_state=0)
    found.fit(design, target)
    text = found.get_model_string(found.model_, 3, names=names)
    constants = sum(part.replace('.', '').isdigit() for part in text.replace('(', ' ').replace(
        ')', ' ').split())
    return found.predict(every), constants, text


def _template(design: np.ndarray, target: np.ndarray, every: np.ndarray,
              names: list[str]) -> tuple[np.ndarray, int, str]:
    with tempfile.TemporaryDirectory() as scratch:
        given, told = Path(scratch, 'given.npz'), Path(scratch, 'told.npz')
        np.savez(given, design=design, target=target, every=every, names=names)
        subprocess.run([PYTHON, Path(__file__).parent / 'foreign' / 'adcd_corrections.py',
                        given, told], check=True, stdout=subprocess.DEVNULL,
                       stderr=subprocess.DEVNULL)
        with np.load(told) as found:
            return found['values'], int(found['constants']), str(found['text'])


PEERS: dict[str, Callable[[_Scene], tuple[Learns, str]]] = {
    'StochasticForceInference': _force_inference, 'GP-SDE': _genetic, 'ADCD': _correction}
