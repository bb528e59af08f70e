"""Whitening and noise levels against dense linear algebra and simulated diffusion."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.common.records import Commands, Conditions
from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import (
    SMALLEST,
    SessionFit,
    Whitening,
    search_noise_ratio,
)
from microbot_ros.estimation.likelihood.kernels import knot_products, whiten_columns
from microbot_ros.estimation.likelihood.noise import Noise, implausible_diffusion, whiten
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.estimation.online.shared import SharedKnowledge
from microbot_ros.estimation.online.window import Window
from microbot_ros.model.increments import as_vectors


def dense_covariance(times, noise):
    """Covariance of increments written down entry by entry."""
    n = len(times) - 1
    blur = noise.diffusion * noise.exposure / 3
    cov = np.diag(2 * noise.diffusion * np.diff(times) + 2 * noise.localisation**2 - 2 * blur)
    beside = -noise.localisation**2 + blur
    return cov + np.diag([beside] * (n - 1), 1) + np.diag([beside] * (n - 1), -1)


def under(ratio, z, times, path=None):
    """Tracks z (T, N) that go along a path (T,), with a noise ratio."""
    session = PreparedSession(
        '', np.arange(z.shape[1]), times, np.nan_to_num(z), np.isfinite(z).astype(int),
        as_vectors(z), Commands(np.empty(0), np.empty((0, 2))), Conditions(),
        np.zeros(z.shape[1], int))
    along = (np.zeros(len(times), complex) if path is None else path)[:, None]
    nothing = np.zeros_like(along)
    return SessionFit.of(
        session, Whitening(ratio), ExpectedDisplacement(nothing, along, 1j * along, True))


def fitted(z, times, path=None):
    *waiting, found = search_noise_ratio(under(0.1, z, times, path))
    assert waiting == [None] * len(waiting)
    assert len(waiting) < 25
    return found


def diffuse(rng, frames, particles, step, diffusion, sigma, exposure=0.0, parts=20):
    """Tracks (T, N) complex by fine steps; a shutter open for `exposure` averages over them."""
    fine = np.sqrt(2 * diffusion * step / parts) * (
        rng.normal(size=(frames * parts, particles, 2)) @ [1, 1j]
    )
    path = np.cumsum(fine, axis=0).reshape(frames, parts, particles)
    open_parts = max(round(exposure / step * parts), 1)
    seen = path[:, :open_parts].mean(axis=1)
    return seen + sigma * (rng.normal(size=(frames, particles, 2)) @ [1, 1j])


@pytest.mark.parametrize('sigma', [0.0, 2e-9, 0.1e-6, 3e-6])
@pytest.mark.parametrize('exposure', [0.0, 0.03])
def test_whitening_is_the_inverse_root_of_the_dense_covariance(sigma, exposure):
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.choice([0.03, 0.03, 0.06, 0.5], 40))
    noise = Noise(1e-13, sigma, exposure)
    columns = rng.normal(size=(40, 1, 3)) * 1e-6
    white = whiten(columns, times, noise)
    rows = white[1:, 0]
    cov = dense_covariance(times, noise)
    steps = np.diff(columns[:, 0], axis=0)
    np.testing.assert_allclose(rows.T @ rows, steps.T @ np.linalg.solve(cov, steps), rtol=1e-9)
    assert not white[0].any()
    _, log_det, count = whiten_columns(times, np.ones((40, 1), int), columns, noise.ratio)
    assert count == 39
    assert log_det + 39 * np.log(noise.diffusion) == pytest.approx(
        np.linalg.slogdet(cov)[1], rel=1e-12)


def test_rows_that_are_missing_are_rows_not_used():
    rng = np.random.default_rng(1)
    times = np.arange(30) * 0.05
    z = rng.normal(size=(30, 1, 1))
    seen = rng.random((30, 1)) < 0.6
    noise = Noise(1.0, 0.5)
    gappy = whiten(np.where(seen[..., None], z, np.nan), times, noise)
    kept = seen[:, 0]
    whole = whiten(z[kept], times[kept], noise)
    np.testing.assert_allclose(gappy[kept], whole)
    assert not gappy[~kept].any()
    of_all = whiten_columns(times, seen.astype(int), z, noise.ratio)
    of_kept = whiten_columns(times[kept], np.ones((kept.sum(), 1), int), z[kept], noise.ratio)
    assert of_all[1:] == pytest.approx(of_kept[1:])


@given(st.integers(0, 10**6), st.floats(-0.01, 3.0))
def test_knots_that_few_rows_feel_have_the_products_of_all_columns(seed, ratio):
    rng = np.random.default_rng(seed)
    frames, count = 40, 7
    times = np.cumsum(rng.uniform(0.03, 0.2, frames))
    pieces = np.sort(rng.integers(0, 4, frames)) * (rng.random(frames) < 0.8)
    starts = np.append(0, np.cumsum(rng.integers(0, 4, frames - 1)))
    knots = rng.integers(0, count, starts[-1])
    moved = (rng.normal(size=(starts[-1], 2)) @ [1, 1j]) * (rng.random(starts[-1]) < 0.9)
    places = rng.normal(size=(frames, 3, 2)) @ [1, 1j]
    np.add.at(steps := np.zeros((frames, count), complex),
              (1 + np.repeat(np.arange(frames - 1), np.diff(starts)), knots), moved)
    every = np.concatenate([places, steps.cumsum(axis=0)], axis=1)[:, None]
    white = whiten_columns(times, pieces[:, None], every, ratio)[0][:, 0]
    folds = rng.integers(0, 2, frames)
    found = knot_products(times, pieces, np.ascontiguousarray(white[:, :3]), starts, knots, moved,
                          count, folds, 2, ratio)
    for fold in range(2):
        rows = white[folds == fold]
        np.testing.assert_allclose(
            found[fold], rows.real.T @ rows.real + rows.imag.T @ rows.imag, rtol=1e-9, atol=1e-9)


def test_times_must_ascend():
    with pytest.raises(ValueError, match='ascend'):
        whiten(np.zeros((3, 1, 1)), np.array([0.0, 0.1, 0.1]), Noise(1.0, 1.0))


@pytest.mark.parametrize(('sigma', 'exposure'), [(0.1e-6, 0.0), (0.02e-6, 0.0), (0.05e-6, 0.05)])
def test_noise_levels_come_out_within_their_spread(sigma, exposure):
    rng = np.random.default_rng(6)
    deviations = []
    for _ in range(24):
        z = diffuse(rng, 400, 3, 0.05, 1e-13, sigma, exposure)
        z[rng.random(z.shape) < 0.1] = np.nan
        found = fitted(z, np.arange(400) * 0.05).noise(exposure)
        deviations.append((found.diffusion - 1e-13) / found.diffusion_std)
        if sigma > 0.03e-6:
            assert found.localisation == pytest.approx(sigma, rel=0.25)
    # The mean of 24 unit deviates strays by 0.2, their spread by 0.14.
    assert abs(np.mean(deviations)) < 0.7
    assert 0.6 < np.std(deviations) < 1.5


def by_covariance(z, step):
    """D and σ by the covariance of neighbours (Vestergaard, Blainey and Flyvbjerg 2014)."""
    d = np.diff(z, axis=0)
    beside = np.mean((d[1:] * d[:-1].conj()).real) / 2
    return (np.mean(np.abs(d) ** 2) / 2 + 2 * beside) / (2 * step), np.sqrt(-beside)


def test_levels_are_those_of_the_covariance_estimator():
    rng = np.random.default_rng(4)
    z = diffuse(rng, 4000, 2, 0.05, 1e-13, 1e-7)
    found = fitted(z, np.arange(4000) * 0.05).noise()
    diffusion, localisation = by_covariance(z, 0.05)
    assert found.diffusion == pytest.approx(diffusion, rel=0.05)
    assert found.localisation == pytest.approx(localisation, rel=0.02)


def test_levels_of_many_short_tracks_are_not_biased():
    """As many speeds as 15 frames each allow: the restricted likelihood pays for them."""
    rng = np.random.default_rng(11)
    times, found = 0.05 * np.arange(15), []
    path = np.cumsum(np.exp(1j * np.repeat(rng.uniform(-3, 3, 3), 5))) * 0.05
    for _ in range(150):
        found.append(fitted(diffuse(rng, 15, 20, 0.05, 1e-13, 1e-7, parts=1), times, path).noise())
    diffusion, std = (np.array([getattr(n, name) for n in found])
                      for name in ('diffusion', 'diffusion_std'))
    # One estimate strays by 11 %, the mean of all by 1 %.
    assert diffusion.mean() == pytest.approx(1e-13, rel=0.04)
    assert np.mean(np.abs(diffusion - 1e-13) < 1.96 * std) > 0.88
    off = [abs(n.localisation - 1e-7) < 1.96 * n.localisation_std for n in found]
    assert np.mean(off) > 0.88


def test_gains_are_generalised_least_squares():
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.choice([0.05, 0.1], 60))
    noise = Noise(1e-13, 1e-7)
    path = np.cumsum(np.exp(1j * rng.uniform(-3, 3, 60))) * 0.05
    z = diffuse(rng, 60, 1, 0.05, 1e-13, 1e-7) + 4e-6j * path[:, None]
    fit = under(noise.ratio, z, times, path)
    inverse = np.linalg.inv(dense_covariance(times, noise))
    step, drive = np.diff(z[:, 0]), np.diff(path)
    expected = (np.conj(drive) @ inverse @ step) / (np.conj(drive) @ inverse @ drive)
    assert fit.velocity_phasor[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize('sigma', [2e-9, 0.1e-6, 3e-6])
def test_the_search_ends_at_the_maximum(sigma):
    from scipy.optimize import minimize_scalar

    rng = np.random.default_rng(8)
    found = fitted(diffuse(rng, 400, 3, 0.05, 1e-13, sigma), np.arange(400) * 0.05)
    best = minimize_scalar(
        lambda u: -found.with_noise_ratio(np.exp(u) - 0.05 / 3).restricted_log_likelihood,
        bounds=(np.log(0.05 * 0.05), np.log(1e5 * 0.05)), method='bounded',
        options={'xatol': 1e-6})
    assert found.restricted_log_likelihood == pytest.approx(-best.fun, abs=1e-3)
    expected = found.with_noise_ratio(np.exp(best.x) - 0.05 / 3)
    for level in ('diffusion', 'localisation'):
        spread = getattr(expected.noise(), f'{level}_std')
        off = getattr(found.noise(), level) - getattr(expected.noise(), level)
        assert abs(off) < 0.05 * spread


@pytest.mark.parametrize(('diffusion', 'said'), [
    (28e-12, '28 µm²/s, that of a sphere of 0.1 µm in water is 2.5: it is not thermal'),
    (2.4e-12, ''), (np.nan, ''), (np.inf, ''), (0.0, '')])
def test_diffusion_beyond_that_of_any_sphere_is_told_where_no_radius_is_stated(diffusion, said):
    told = implausible_diffusion(Conditions(), Noise(diffusion, 1e-7, 0.0, 1e-15))
    assert bool(told) == bool(said)
    assert said in ' '.join(told)


@pytest.mark.parametrize('diffusion', [np.nan, np.inf])
def test_a_diffusion_that_is_no_number_is_in_no_sentence(diffusion):
    known = Conditions(radius=10e-6, viscosity=1e-3)
    assert not implausible_diffusion(known, Noise(diffusion, 1e-7))
    assert implausible_diffusion(known, Noise(28e-12, 1e-7, 0.0, 1e-15))


@pytest.mark.parametrize('heading', [False, True])
@pytest.mark.parametrize('aspect', [0.5, 2 / 3, 2.0])
def test_the_least_noise_of_blur_has_a_likelihood_under_any_aspect(aspect, heading):
    """Blur correlates increments by less than −½ along both axes, however one is stretched."""
    rng, step = np.random.default_rng(12), 1 / 30
    times = step * np.arange(200)
    plain = under((SMALLEST - 1 / 3) * step, diffuse(rng, 200, 2, step, 1e-13, 1e-9), times)
    zero = np.zeros((199, 2))
    noise = replace(plain.whitening, stretch=(1.0, aspect), **(
        {'sensitivity': zero + 0j, 'retention': zero} if heading else {}))
    found = SessionFit.of(plain.session, noise, plain.expected)
    assert np.isfinite(found.log_det)
    assert np.isfinite(found.restricted_log_likelihood)


def test_a_review_that_another_model_began_is_not_continued(
        monkeypatch: pytest.MonkeyPatch) -> None:
    reviewed: list[Any] = []

    def review(_: Window, model: Any, *_rest: Any) -> Iterator[None]:
        while True:
            reviewed.append(model)
            yield None
    monkeypatch.setattr(Window, 'review', review)
    knowledge = SharedKnowledge(Noise(diffusion=1e-13, localisation=1e-8))

    def work(model: str, *seconds: float) -> set[str]:
        reviewed.clear()
        for t in seconds:
            knowledge.work(t, model, None, None)
        return {*reviewed}
    assert work('first', 0.0, 100.0) == {'first'}
    knowledge.forget_model()
    assert work('second', 1000.0, 2000.0) == {'second'}
