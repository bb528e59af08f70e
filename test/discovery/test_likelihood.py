"""The likelihood is that of the dense Gaussian, and the filters make noise white."""

import gc
from dataclasses import replace
from types import SimpleNamespace
from weakref import ref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from microbot_ros.estimation.likelihood.joint import Whitening, climb, inner, search_noise_ratio
from microbot_ros.estimation.likelihood.kernels import (
    filter_positions,
    joint_products,
    whiten_columns,
    whiten_with_heading,
    whitened_products_with_heading,
)
from microbot_ros.estimation.likelihood.model_fit import (
    evaluate,
    fit_noise,
    fit_with_noise,
    maximise,
)
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession, prepare
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model


def brownian(times, noise_ratio):
    """Covariance (T, T) of positions for D = 1 with a reading error of variance `noise_ratio`."""
    return 2 * np.minimum(times[:, None], times) + noise_ratio * np.eye(len(times))


def increments_of(count):
    return np.diff(np.eye(count), axis=0)


def test_likelihood_is_that_of_the_dense_gaussian(film):
    """Against generalised least squares with the whole covariance matrix; gaps included."""
    session, _ = film(0, count=2, duration=4.0)
    e = PreparedSession.of(session)
    seen = e.seen.copy()
    seen[10:14, 0] = seen[30, 1] = False
    e = replace(e, pieces=seen.astype(int))
    model = Model.baseline(session.conditions, session.commands)
    path = evaluate(model, [e], [Whitening(0.1)]).session_fits[0].expected.along[:, 0]
    values = []
    for noise_ratio in (0.02, 0.2):
        p = evaluate(model, [e], [Whitening(noise_ratio)]).session_fits[0]
        squares = log_det = free = 0.0
        for n in range(2):
            rows = seen[:, n]
            difference = increments_of(rows.sum())
            covariance = difference @ brownian(e.times[rows], noise_ratio) @ difference.T
            y, x = difference @ e.z[rows, n], difference @ path[rows]
            weight = np.linalg.inv(covariance)
            gain = (x.conj() @ weight @ y) / (x.conj() @ weight @ x)
            assert p.velocity_phasor[n] == pytest.approx(gain, rel=1e-6)
            left = y - gain * x
            squares += (left.conj() @ weight @ left).real
            log_det += np.linalg.slogdet(covariance)[1]
            free += 2 * (len(y) - 1)
        assert p.residual_sum_of_squares == pytest.approx(squares, rel=1e-6)
        assert p.log_det == pytest.approx(log_det, rel=1e-9)
        assert p.degrees_of_freedom == free
        values.append((p.log_likelihood, -free / 2 * np.log(squares / free) - log_det))
    assert np.diff(values, axis=0)[0, 0] == pytest.approx(np.diff(values, axis=0)[0, 1], rel=1e-6)


def test_the_filter_without_heading_noise_is_the_plain_one():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.02, 0.05, 40))
    columns = rng.normal(size=(40, 2, 3)) + 1j * rng.normal(size=(40, 2, 3))
    pieces = (rng.random((40, 2)) < 0.8).astype(int)
    sensitivity, retention = np.zeros((39, 2), complex), np.zeros((39, 2))
    plain = whiten_columns(times, pieces, columns, 0.05)
    noisy = whiten_with_heading(times, pieces, columns, 0.05, 0.05, 0.3, sensitivity, retention,
                                np.zeros((40, 2), complex), 0.0, retention, sensitivity)
    assert noisy[0] == pytest.approx(plain[0])
    assert noisy[1:3] == pytest.approx(plain[1:])


def integrated_heading(times, rate):
    """Covariance of ∫η dt from 0 to t and t', ∫∫ e^{−κ|s−u|}/κ, over D_r."""
    t, u = np.minimum(times[:, None], times), np.maximum(times[:, None], times)
    return (2 * t / rate + (np.exp(-rate * t) + np.exp(-rate * u) - 1
                            - np.exp(-rate * (u - t))) / rate**2) / rate


def test_the_filter_expects_the_heading_that_the_readings_so_far_imply():
    """Against the expectation under the covariance of headings and readings, in closed form."""
    rng, count, h, rate, ratio, noise_ratio = np.random.default_rng(5), 12, 0.05, 4.0, 3.0, 0.02
    times, speed = h * np.arange(count), 0.7 - 0.4j
    z = 0.3 * (rng.normal(size=count) + 1j * rng.normal(size=count))
    calm, steady = np.zeros((count, 1), complex), np.zeros((count - 1, 1))
    *_, factors = whiten_with_heading(
        times, np.ones((count, 1), int), z[:, None, None], noise_ratio, noise_ratio, ratio,
        np.full((count - 1, 1), speed * (1 - np.exp(-rate * h)) / rate),
        np.full((count - 1, 1), np.exp(-rate * h)), calm, 0.0, steady, steady.astype(complex))
    v, since = np.array([speed.real, speed.imag]), times[-1] - times
    covariance = np.kron(np.outer(v, v), ratio * integrated_heading(times, rate))
    covariance += np.kron(np.eye(2), brownian(times, noise_ratio))
    with_heading = np.kron(v, ratio / rate**2 * (np.exp(-rate * since) - np.exp(-rate * since[0])))
    # The first reading says where it is, and nothing of the heading.
    steps = np.kron(np.eye(2), np.eye(count)[1:] - np.eye(count)[0])
    known = steps @ np.concatenate([z.real, z.imag])
    expected = steps @ with_heading @ np.linalg.solve(steps @ covariance @ steps.T, known)
    assert factors[-1, 0, 3] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize('size', [0.0, 0.6])
def test_the_filter_whitens_heading_noise(size):
    """Against the covariance of an Ornstein–Uhlenbeck heading, integrated in closed form.

    Also where, by `size`, readings scatter along directions of their own, the direction deviates
    beside the speed, and steps are uneven in any direction and along the way.
    """
    count, h, rate, ratio, noise_ratio, speed = 30, 0.05, 4.0, 3.0, 0.02, 0.7 - 0.4j
    times = h * np.arange(count)
    retention = np.full((count - 1, 1), np.exp(-rate * h))
    sensitivity = np.full((count - 1, 1), speed * (1 - np.exp(-rate * h)) / rate)
    swing = size * np.exp(0.3j * np.arange(count))[:, None]
    wander, kick = size, size * h * (1 + np.arange(count - 1) % 5)[:, None]
    stride = 0.1 * size * np.exp(0.4j * np.arange(count - 1))[:, None]

    def whiten(columns):
        pieces = np.ones((count, 1), int)
        return whiten_with_heading(times, pieces, columns, noise_ratio, noise_ratio, ratio,
                                   sensitivity, retention, swing, wander, kick, stride)[0]

    path = ratio * integrated_heading(times, rate)
    v = np.array([speed.real, speed.imag])
    across = np.array([-speed.imag, speed.real])
    walked = np.tri(count, count - 1, -1)
    covariance = (np.kron(np.outer(v, v) + wander * np.outer(across, across), path)
                  + np.kron(np.eye(2), brownian(times, noise_ratio) + walked * kick.T @ walked.T))
    steps = np.concatenate([walked * stride.real.T, walked * stride.imag.T])
    covariance += steps @ steps.T
    along = np.concatenate([np.diag(swing.real[:, 0]), np.diag(swing.imag[:, 0])])
    covariance += along @ along.T
    units = np.concatenate([np.eye(count), 1j * np.eye(count)], axis=1)[:, None, :]
    white = whiten(units)[1:, 0]
    white = np.concatenate([white.real, white.imag])
    assert white @ covariance @ white.T == pytest.approx(np.eye(2 * count - 2), abs=1e-8)


def test_products_are_those_of_what_is_white():
    """Of particles that forget unlike each other, with gaps, and one that shares its path."""
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.02, 0.05, 40))
    pieces = (rng.random((40, 3)) < 0.8).astype(int)
    pieces[20:] *= 2
    z, offset, along = (rng.normal(size=(40, 2)) @ [1, 1j] for _ in range(3))
    z = z[:, None] * np.array([1.0, 2.0, 3j])
    sensitivity = rng.normal(size=(39, 3)) + 1j * rng.normal(size=(39, 3))
    retention = rng.uniform(0, 1, (39, 3))
    retention[:, 1] = retention[:, 0]
    swing = 0.2 * (rng.normal(size=(40, 3)) + 1j * rng.normal(size=(40, 3)))
    kick, stride = rng.uniform(0, 0.1, (39, 3)), 0.1 * rng.normal(size=(39, 3)) * (1 + 2j)
    noise = 0.05, 0.3, sensitivity, retention, swing, 0.4, kick, stride
    columns = np.stack([z - offset[:, None], *(
        np.broadcast_to(part * along[:, None], z.shape) for part in (1, 1j))], axis=-1)
    white, log_det, used, _ = whiten_with_heading(times, pieces, columns, 0.05, *noise)
    found = whitened_products_with_heading(
        times, pieces, z, offset[:, None], along[:, None], *noise)
    assert found[0] == pytest.approx(inner(white), rel=1e-9)
    together = np.concatenate([2 * white, white**2], axis=-1)
    assert joint_products(white, white**2, 2.0) == pytest.approx(inner(together), rel=1e-9)
    assert joint_products(white, white[..., :0], 1.0) == pytest.approx(inner(white), rel=1e-9)
    assert found[1:] == (pytest.approx(log_det, rel=1e-12), used)


def test_a_heading_that_the_field_holds_is_one_that_hardly_turns():
    """Before, within and after a spell without a field, in which it turns as it likes."""
    rng = np.random.default_rng(2)
    times = np.arange(60) * 0.03
    columns = rng.normal(size=(60, 2, 3)) + 1j * rng.normal(size=(60, 2, 3))
    pieces = np.ones((60, 2), int)
    free = (np.arange(59) > 20) & (np.arange(59) < 30)
    sensitivity = np.where(free[:, None], [0.3 + 0.1j, -0.2j], 0)
    held = np.where(free[:, None], [1.0, 1.0], 0.0)
    for ratios in ((0.05, 0.05), (0.05, 0.08)):
        still, hardly = (
            whiten_with_heading(times, pieces, columns, *ratios, 2.0, sensitivity, retention,
                                np.zeros((60, 2), complex), 0.0, np.zeros((59, 2)),
                                np.zeros((59, 2), complex))
            for retention in (held, np.maximum(held, 1e-10)))
        assert still[0] == pytest.approx(hardly[0], rel=1e-9)
        assert still[1:3] == pytest.approx(hardly[1:3], rel=1e-9)


@given(st.floats(0, 10), st.floats(0, 10), st.floats(0.3, 3))
def test_uphill_from_anywhere_is_where_the_whole_range_has_its_maximum(peak, near, width):
    def at(u):
        return SimpleNamespace(restricted_log_likelihood=-((u - peak) / width) ** 2, u=u)

    for start in (None, near):
        *waiting, found = climb(at, 0.0, 10.0, start)
        assert waiting == [None] * len(waiting)
        assert len(waiting) < 25
        assert found.u == pytest.approx(peak, abs=1e-6 if 0.1 < peak < 9.9 else 0.1)


def test_noise_that_is_near_is_found_in_a_few_looks(film):
    session, _ = film(0)
    model = Model.baseline(session.conditions, session.commands)
    fit, = fit_noise(evaluate(model, [prepare(session)], [Whitening(0.1)])).session_fits
    *looks, again = search_noise_ratio(fit, near=True)
    assert len(looks) == 3
    assert again.restricted_log_likelihood == pytest.approx(
        fit.restricted_log_likelihood, abs=1e-3)


def test_a_lag_is_not_led_astray_by_filters_of_another(film):
    """Under filters with much noise in the headings, τ alone would go anywhere."""
    session, _ = film(2, {'alignment_lag': {'tau_s': 0.4}}, count=2)
    session = replace(session, conditions=replace(session.conditions, radius=None))
    lag = EFFECTS['alignment_lag']
    model = Model.baseline(session.conditions, session.commands)
    for tau in (0.1, 0.4, 2.0):
        start = fit_noise(evaluate(
            model.with_effect(lag(tau)), [prepare(session)], [Whitening(0.05)]))
        fit = fit_with_noise(start)
        assert fit.model.effect('alignment_lag').tau == pytest.approx(0.4, abs=0.1)


@pytest.mark.parametrize('heading', [False, True])
def test_a_stretched_picture_is_whitened_along_each_axis(heading):
    """Diffusion looks larger along an axis, the error of reading does not."""
    count, noise_ratio, stretch = 12, 0.03, (0.8, 1.3)
    times = np.cumsum(np.linspace(0.02, 0.08, count))
    still = (np.zeros((count - 1, 1), complex), np.zeros((count - 1, 1))) if heading else ()
    whitening = Whitening(noise_ratio, 0.1, *(still or (None, None)), stretch=stretch)
    rows = SimpleNamespace(times=times, pieces=np.ones((count, 1), int))
    units = np.concatenate([np.eye(count), 1j * np.eye(count)], axis=1)[:, None, :]
    white, log_det, used = whitening.apply(rows, units.astype(complex))
    white = np.concatenate([white.real, white.imag])[:, 0]
    covariance = np.zeros((2 * count, 2 * count))
    for axis, factor in enumerate(stretch):
        own = slice(axis * count, (axis + 1) * count)
        covariance[own, own] = factor**2 * brownian(times, noise_ratio / factor**2)
    known = np.delete(np.arange(2 * count), [0, count])
    assert (white @ covariance @ white.T)[np.ix_(known, known)] == pytest.approx(
        np.eye(2 * count - 2), abs=1e-9)
    steps = np.kron(np.eye(2), np.diff(np.eye(count), axis=0))
    # Steps of the first row carry what its own reading had: the filter starts from it as given.
    assert log_det == pytest.approx(
        np.linalg.slogdet(steps @ covariance @ steps.T)[1] / 2, abs=1e-9)
    assert used == count - 1


def test_a_white_column_is_remembered_for_its_own_session_alone(film):
    """One whitening serves many sessions, of which some are gone when others are made."""
    whitening = Whitening(0.1)
    model = Model.baseline(film(0, duration=4.0)[0].conditions, film(0, duration=4.0)[0].commands)

    def remembered(seed):
        session = prepare(film(seed, duration=4.0)[0])
        part, = evaluate(model, [session], [whitening]).session_fits
        column = session.z * np.arange(len(session.times))[:, None]
        plain, = part.white_columns([(None, lambda: column)]).T
        # What is remembered, and what is not beside it.
        first, again = (part.white_columns([(None, lambda: -column), ('one', lambda: column)])
                        for _ in range(2))
        np.testing.assert_array_equal(first, again)
        return again[..., 1].T, plain, ref(session)

    for seed in range(4):
        kept, plain, session = remembered(seed)
        np.testing.assert_array_equal(kept, plain)
        # Were it forgotten, another could be given its id, and with it its column.
        gc.collect()
        assert session() is not None


def test_belief_is_the_kalman_filter_of_a_random_walk():
    times, z = np.arange(3) * 0.5, np.array([[1.0], [2.0], [9.0]], complex)
    pieces = np.array([[1], [1], [0]])
    belief = filter_positions(times, pieces, z, 1.0)
    # Variance 1 before, 1 + 2·½ ahead, gain 2/3.
    assert belief[:, 0] == pytest.approx([1.0, 1 + 2 / 3, 1 + 2 / 3])
    assert np.isnan(filter_positions(times, pieces[::-1].copy(), z, 1.0)[0, 0])


def test_fit_stays_within_bounds_and_never_gets_worse(film):
    session, _ = film(3)
    e = PreparedSession.of(session)
    model = Model.baseline(session.conditions, session.commands)
    base = fit_noise(evaluate(model, [e], [Whitening(0.05)]))
    start = evaluate(model.with_effect(EFFECTS['command_delay'](0.3)), [e],
                     [base.session_fits[0].whitening])
    best = maximise(start)
    assert best.cost <= start.cost
    assert 0 <= best.model.effect('command_delay').delay < 0.05


@pytest.mark.parametrize(
    'name', ['uniform_drift', 'background_field', 'heading_slip', 'coil_gain_mismatch'])
def test_no_step_that_is_left_out_would_gain_anything(film, name):
    """Against a search by another method, from where the first one ended."""
    session, _ = film(5)
    e = PreparedSession.of(session)
    model = Model.baseline(session.conditions, session.commands)
    base = fit_noise(evaluate(model, [e], [Whitening(0.05)]))
    best = maximise(base.under(model.with_effect(EFFECTS[name].null())))
    again = minimize(lambda x: base.under(best.model.with_vector(x)).cost, best.model.vector(),
                     method='Nelder-Mead', options={'xatol': 1e-4, 'fatol': 1e-6})
    assert best.cost < again.fun + 2e-3


def test_parameter_that_v_absorbs_is_not_visible(film):
    """Incomplete alignment at one field strength only scales the speeds."""
    session, _ = film(4)
    e = PreparedSession.of(session)
    model = Model.baseline(session.conditions, session.commands)
    fit = evaluate(model.with_effect(EFFECTS['incomplete_alignment'](1e-3)), [e],
                   [Whitening(0.05)])
    assert np.isinf(fit.covariance).all()
