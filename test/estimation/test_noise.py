"""Whitening and noise levels against dense linear algebra and simulated diffusion."""

import numpy as np
import pytest

from microbot_ros.estimation.noise import (
    GainLikelihood,
    Noise,
    covariance_estimate,
    fit_noise,
    whiten,
)


def dense_covariance(times, noise):
    """Covariance of increments written down entry by entry."""
    n = len(times) - 1
    blur = noise.diffusion * noise.exposure / 3
    cov = np.diag(2 * noise.diffusion * np.diff(times) + 2 * noise.localisation**2 - 2 * blur)
    beside = -noise.localisation**2 + blur
    return cov + np.diag([beside] * (n - 1), 1) + np.diag([beside] * (n - 1), -1)


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
    rows = white.columns[1:, 0]
    cov = dense_covariance(times, noise)
    steps = np.diff(columns[:, 0], axis=0)
    np.testing.assert_allclose(rows.T @ rows, steps.T @ np.linalg.solve(cov, steps), rtol=1e-9)
    assert white.log_det == pytest.approx(np.linalg.slogdet(cov)[1] / 2, rel=1e-12)
    assert white.count == 39
    assert not white.columns[0].any()


def test_rows_that_are_missing_are_rows_not_used():
    rng = np.random.default_rng(1)
    times = np.arange(30) * 0.05
    z = rng.normal(size=(30, 1, 1))
    seen = rng.random((30, 1)) < 0.6
    noise = Noise(1.0, 0.5)
    gappy = whiten(np.where(seen[..., None], z, np.nan), times, noise)
    kept = seen[:, 0]
    whole = whiten(z[kept], times[kept], noise)
    np.testing.assert_allclose(gappy.columns[kept], whole.columns)
    assert not gappy.columns[~kept].any()
    assert gappy.log_det == pytest.approx(whole.log_det)


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
        found = fit_noise(z, np.arange(400) * 0.05, exposure)
        deviations.append((found.diffusion - 1e-13) / found.diffusion_std)
        if sigma > 0.03e-6:
            assert found.localisation == pytest.approx(sigma, rel=0.25)
    # The mean of 24 unit deviates strays by 0.2, their spread by 0.14.
    assert abs(np.mean(deviations)) < 0.7
    assert 0.6 < np.std(deviations) < 1.5


def test_two_axes_may_be_given_as_vectors():
    rng = np.random.default_rng(3)
    times = np.arange(200) * 0.05
    z = diffuse(rng, 200, 2, 0.05, 1e-13, 1e-7)
    as_complex = fit_noise(z, times)
    as_vectors = fit_noise(np.stack([z.real, z.imag], axis=-1), times)
    assert as_vectors == as_complex


def test_starting_values_stand_a_jump():
    rng = np.random.default_rng(4)
    times = np.arange(600) * 0.05
    z = diffuse(rng, 600, 2, 0.05, 1e-13, 1e-7)
    z[300:] += 50e-6
    found = covariance_estimate(z, times)
    assert found.diffusion == pytest.approx(1e-13, rel=0.4)
    assert found.localisation == pytest.approx(1e-7, rel=0.2)


def test_gains_are_generalised_least_squares():
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.choice([0.05, 0.1], 60))
    noise = Noise(1e-13, 1e-7)
    path = np.cumsum(np.exp(1j * rng.uniform(-3, 3, 60))) * 0.05
    z = diffuse(rng, 60, 1, 0.05, 1e-13, 1e-7) + 4e-6j * path[:, None]
    fit = GainLikelihood(times, z, path).at(noise.localisation**2 / noise.diffusion)
    inverse = np.linalg.inv(dense_covariance(times, noise))
    step, drive = np.diff(z[:, 0]), np.diff(path)
    expected = (np.conj(drive) @ inverse @ step) / (np.conj(drive) @ inverse @ drive)
    assert fit.gain[0] == pytest.approx(expected, rel=1e-9)


def test_too_little_to_fit_is_said():
    with pytest.raises(ValueError, match='increments'):
        GainLikelihood(np.arange(3.0), np.zeros((3, 1), complex), np.zeros(3, complex))


@pytest.mark.parametrize('sigma', [2e-9, 0.1e-6, 3e-6])
def test_the_search_in_slices_ends_at_the_same_maximum(sigma):
    rng = np.random.default_rng(8)
    likelihood = GainLikelihood(
        np.arange(400) * 0.05, diffuse(rng, 400, 3, 0.05, 1e-13, sigma), np.zeros(400, complex))
    *waiting, found = likelihood.maximum_in_slices()
    assert waiting == [None] * len(waiting)
    assert len(waiting) < 25
    expected = likelihood.maximum()
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, abs=0.01)
    for level in ('diffusion', 'localisation'):
        spread = getattr(expected.noise, f'{level}_std')
        assert abs(getattr(found.noise, level) - getattr(expected.noise, level)) < 0.1 * spread
