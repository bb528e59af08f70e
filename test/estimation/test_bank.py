"""The factorised complex filter against a textbook Kalman filter, and under hostile input."""

import numpy as np
import pytest

from microbot_ros.estimation.online.bank import PhasorBank
from microbot_ros.estimation.online.population import PACES


class Textbook:
    """Kalman filter on the real state (x, y, a, b), as in any book."""

    def __init__(self, z, p_var, phasor_var):
        self.state = np.array([z.real, z.imag, 0, 0])
        self.cov = np.diag([p_var, p_var, phasor_var, phasor_var])

    def predict(self, path, drift, diffused, wander):
        transition = np.eye(4)
        transition[:2, 2:] = [[path.real, -path.imag], [path.imag, path.real]]
        self.state = transition @ self.state + [drift.real, drift.imag, 0, 0]
        noise = np.diag([diffused, diffused, wander, wander])
        self.cov = transition @ self.cov @ transition.T + noise

    def update(self, z, noise):
        innovation = np.array([z.real, z.imag]) - self.state[:2]
        total = self.cov[:2, :2] + noise * np.eye(2)
        gain = self.cov[:, :2] @ np.linalg.inv(total)
        self.state = self.state + gain @ innovation
        self.cov = self.cov - gain @ self.cov[:2]


def test_one_hypothesis_is_the_textbook_filter():
    rng = np.random.default_rng(0)
    bank, book = PhasorBank(1), Textbook(1 + 2j, 0.3, 4.0)
    bank.add(np.array([1 + 2j]), np.array([0.3]), 4.0)
    for _ in range(200):
        path, drift, z = (complex(*rng.normal(size=2)) for _ in range(3))
        diffused, wander, noise = rng.exponential(size=3) * [0.1, 0.001, 0.2]
        bank.predict(np.array([path]), np.array([drift]), diffused, np.array([wander]))
        book.predict(path, drift, diffused, wander)
        if rng.random() < 0.7:
            bank.update(np.array([z]), np.array([noise]), np.array([True]))
            book.update(z, noise)
        found = bank.combined()
        np.testing.assert_allclose(
            np.concatenate([[z[0].real, z[0].imag] for z in (
                found.p, found.velocity_phasor)]), book.state, rtol=1e-8, atol=1e-10,
        )
        assert found.p_var[0] == pytest.approx(book.cov[0, 0], rel=1e-8)
        assert found.phasor_var[0] == pytest.approx(book.cov[2, 2], rel=1e-8)
        # E p̃ c̃* of a circular pair: twice (cov(x, a) + i cov(y, a)).
        assert found.cross[0] == pytest.approx(
            complex(book.cov[0, 2], book.cov[1, 2]), rel=1e-7, abs=1e-12)


def test_headings_that_stray_are_a_third_state_of_the_textbook_filter():
    rng = np.random.default_rng(4)
    bank = PhasorBank(1)
    bank.add(np.array([0j]), np.array([0.3]), 4.0)
    # The textbook: complex state (p, s, c), Hermitian covariance per axis.
    state, cov = np.zeros(3, complex), np.diag([0.3, 0.0, 4.0]).astype(complex)
    for _ in range(100):
        path, bend, z = (complex(*rng.normal(size=2)) for _ in range(3))
        kept, heading_noise, diffused, noise = rng.uniform(0.05, 1, 4)
        kicked = abs(state[2]) ** 2 * heading_noise / 2
        bank.predict_deviation(np.array([bend]), np.array([kept]), heading_noise)
        bank.predict(np.array([path]), np.zeros(1), diffused, np.zeros(1))
        transition = np.array([[1, -1j * bend, path], [0, kept, 0], [0, 0, 1]])
        state = transition @ state
        cov = transition @ cov @ transition.conj().T + np.diag([diffused, kicked, 0])
        bank.update(np.array([z]), np.array([noise]), np.array([True]))
        gain = cov[:, 0] / (cov[0, 0] + noise)
        state = state + gain * (z - state[0])
        cov = cov - np.outer(gain, cov[0])
        found = bank.combined()
        assert found.p[0] == pytest.approx(state[0], rel=1e-7)
        assert found.velocity_phasor[0] == pytest.approx(state[2], rel=1e-7)
        assert bank.s[0, 0] == pytest.approx(state[1], rel=1e-6, abs=1e-9)
        assert found.p_var[0] == pytest.approx(cov[0, 0].real, rel=1e-7)
        assert found.phasor_var[0] == pytest.approx(cov[2, 2].real, rel=1e-7)


def simulate(rng, bank, change_at=None, factor=1.0, seconds=20.0, step=0.05):
    """One particle at c = 4 under a field that turns every second; c seen after every frame."""
    c, place, seen = 4.0 + 0j, 0j, []
    bank.add(np.array([0j]), np.array([0.01]), 100.0)
    path = 1.0
    for k in range(int(seconds / step)):
        if k % 20 == 0:
            path = np.exp(1j * rng.uniform(-np.pi, np.pi))
        if change_at is not None and k == int(change_at / step):
            c = c * factor
        place += c * path * step + np.sqrt(2 * 0.04 * step) * complex(*rng.normal(size=2))
        bank.predict(np.array([path * step]), np.zeros(1), 2 * 0.04 * step, np.array([1e-6]))
        z = place + 0.05 * complex(*rng.normal(size=2))
        bank.update(np.array([z]), np.array([0.0025]), np.array([True]))
        if k % 5 == 4:
            bank.tick(1e-4, np.abs(bank.velocity_phasor[0]) ** 2 / 2, 100.0)
        seen.append(bank.combined())
    return c, seen


@pytest.mark.parametrize('paces', [(), PACES])
@pytest.mark.parametrize('factor', [0.5, np.exp(1j)])
def test_a_change_is_followed_within_seconds(factor, paces):
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(10):
        c, seen = simulate(rng, PhasorBank(7, paces), 15.0, factor)
        late = seen[int(18.0 / 0.05)]
        errors.append(abs(late.velocity_phasor[0] - c))
        assert abs(seen[int(14.9 / 0.05)].velocity_phasor[0] - 4) < 0.5
    # Three seconds of diffusion alone leave √(2·2D/T) = 0.23.
    assert np.sqrt(np.mean(np.square(errors))) < 0.35


@pytest.mark.parametrize('paces', [(), PACES])
def test_without_a_change_nothing_is_lost(paces):
    rng = np.random.default_rng(2)
    several, single = [], []
    for _ in range(12):
        state = rng.bit_generator.state
        several.append(abs(simulate(rng, PhasorBank(7, paces))[1][-1].velocity_phasor[0] - 4))
        rng.bit_generator.state = state
        single.append(abs(simulate(rng, Single())[1][-1].velocity_phasor[0] - 4))
    assert np.sqrt(np.mean(np.square(several))) < 1.05 * np.sqrt(np.mean(np.square(single)))


def test_what_wanders_is_followed_within_its_spread():
    """Two particles of which one wanders for a minute; both are constant for another."""
    rng, step, bank = np.random.default_rng(9), 0.05, PhasorBank(7, PACES)
    c, place, off, wide = np.array([4.0 + 0j, 4.0]), np.zeros(2, complex), [], []
    bank.add(place, np.full(2, 0.01), 100.0)
    for k in range(2400):
        if k % 20 == 0:
            path = step * np.exp(1j * rng.uniform(-np.pi, np.pi))
        c = c * (1 + (k < 1200) * np.array([0, 0.05 * np.sqrt(step)]) * rng.normal(size=2))
        place = place + c * path + np.sqrt(2 * 0.04 * step) * (rng.normal(size=(2, 2)) @ [1, 1j])
        bank.predict(np.array([path]), np.zeros(1), 2 * 0.04 * step, np.full(2, 1e-6 * 16 * step))
        bank.update(place + 0.05 * (rng.normal(size=(2, 2)) @ [1, 1j]), np.full(2, 0.0025),
                    np.full(2, True))
        if k % 5 == 4:
            bank.tick(1e-4, np.abs(bank.velocity_phasor[0]) ** 2 / 2, 100.0)
        known = bank.combined()
        wide.append(np.sqrt(known.phasor_var))
        off.append(np.abs(known.velocity_phasor - c) / wide[-1])
    assert (np.array(off)[400:] < 3).mean(axis=0) == pytest.approx([1, 1], abs=0.15)
    assert wide[1199][1] > 3 * wide[1199][0]
    assert abs(bank.velocity_phasor[0, 1] - c[1]) < 0.1 * abs(c[1])


class Single(PhasorBank):
    """A bank that never considers a change."""

    def __init__(self):
        super().__init__(1)

    def tick(self, *_):
        return np.zeros(self.p.shape[1])


@pytest.mark.parametrize('paces', [(), PACES])
@pytest.mark.parametrize('lags', [False, True])
def test_state_stays_finite_and_covariance_positive_over_millions_of_hostile_steps(lags, paces):
    rng = np.random.default_rng(3)
    count, steps = 2000, 300
    bank = PhasorBank(7, paces)
    scale = 10.0 ** rng.uniform(-9, 2, count)
    bank.add(scale * rng.normal(size=count), scale**2, 1.0)
    for k in range(steps):
        path = 10.0 ** rng.uniform(-9, 3) * np.exp(1j * rng.uniform(-3, 3, count))
        if lags:
            bank.predict_deviation(
                path, 10.0 ** rng.uniform(-6, 0.3, count), 10.0 ** rng.uniform(-12, 0))
            assert (bank.s_var >= 0).all()
            assert (np.abs(bank.ps) ** 2 <= bank.p_var * bank.s_var * (1 + 1e-9)).all()
        bank.predict(path * (rng.random() < 0.8), rng.normal(size=count) * 1e-3,
                     10.0 ** rng.uniform(-18, 2), 10.0 ** rng.uniform(-18, 0, count))
        noise = 10.0 ** rng.uniform(-20, 4, count)
        z = rng.normal(size=count) * 10.0 ** rng.uniform(-9, 6, count)
        bank.update(z, noise, rng.random(count) < 0.7)
        if k % 3 == 0:
            bank.tick(1e-5, np.abs(bank.velocity_phasor[0]) ** 2 / 2 + 1e-12, 1e3)
        if k % 40 == 0:
            rows = np.flatnonzero(rng.random(count) < 0.01)
            bank.restart(rows, z[rows], noise[rows], 1.0)
        assert np.isfinite(bank.p).all()
        assert np.isfinite(bank.velocity_phasor).all()
        # The factors of the covariance: positive means positive definite.
        assert (bank.p_var > 0).all()
        assert (bank.phasor_var > 0).all()
        assert np.isfinite(bank.g).all()
    weights = bank.weights()
    np.testing.assert_allclose(weights.sum(axis=0), 1)


@pytest.mark.parametrize('after', [4.0, -1.0 + 2.0j, 0.0])
def test_begun_anew_it_keeps_what_it_knew_or_learns_another_velocity(after):
    rng = np.random.default_rng(6)
    bank, step = PhasorBank(7, PACES), 0.05
    simulate(rng, bank)
    before = bank.combined()
    bank.restart(np.array([0]), np.array([30 - 20j]), np.array([0.0025]), 100.0)
    begun = bank.combined()
    assert begun.p[0] == 30 - 20j
    assert begun.p_var[0] == pytest.approx(0.0025)
    assert begun.phasor_var[0] > 40
    place = 30 - 20j
    for _ in range(100):
        path = step * np.exp(1j * rng.uniform(-np.pi, np.pi))
        place += after * path + np.sqrt(2 * 0.04 * step) * complex(*rng.normal(size=2))
        bank.predict(np.array([path]), np.zeros(1), 2 * 0.04 * step, np.array([1e-6]))
        z = place + 0.05 * complex(*rng.normal(size=2))
        bank.update(np.array([z]), np.array([0.0025]), np.array([True]))
    found = bank.combined()
    assert abs(found.velocity_phasor[0] - after) < 4 * np.sqrt(found.phasor_var[0])
    if after == 4.0:
        assert found.phasor_var[0] < 1.1 * before.phasor_var[0]
