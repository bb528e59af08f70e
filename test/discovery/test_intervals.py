"""Intervals: by curvature where that is the truth, by profile where it is not."""

import numpy as np
import pytest
from scipy.stats import chi2

from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.hypotheses import consider, fit_first_order
from microbot_ros.discovery.intervals import ROOT, Intervals, _follow
from microbot_ros.discovery.search import fit_candidate
from microbot_ros.estimation.likelihood.model_fit import fit_sessions, maximise


def fitted(session, name):
    sessions, _ = check_sessions([session])
    return fit_sessions(fit_candidate(fit_first_order(sessions), name).fit.model, sessions)


@pytest.fixture(scope='module')
def drifting(film):
    session, truth = film(60, {'uniform_drift': {'wx_um_s': 0.5, 'wy_um_s': -0.3}})
    return fitted(session, 'uniform_drift'), truth


@pytest.fixture(scope='module')
def saturating(film):
    """Fields far below the scale: v and the scale can hardly be told apart."""
    session, truth = film(65, {'incomplete_alignment': {'field_scale_mT': 4.0}}, duration=40.0,
                          levels=(1e-3, 2e-3, 5e-3))
    return fitted(session, 'incomplete_alignment'), truth


def test_root_is_that_of_chi_square():
    assert pytest.approx(chi2.ppf(0.95, 1), abs=2e-3) == ROOT**2


def test_what_is_linear_needs_no_profile(drifting):
    fit, _ = drifting
    known = Intervals(fit)
    for estimate in known.effect('uniform_drift').values():
        assert estimate.low == pytest.approx(estimate.value - ROOT * estimate.std, rel=1e-9)
        assert estimate.is_even


def test_models_within_reach_widen_intervals_by_their_probability(drifting):
    fit, _ = drifting
    moved = fit.under(fit.model.with_vector(fit.model.vector() + 0.2))
    sure, unsure = Intervals(fit), Intervals(fit, others=[(moved, 0.25)])
    for name, one in sure.effect('uniform_drift').items():
        other = unsure.effect('uniform_drift')[name]
        assert other.value == one.value
        variance = 0.25 * (0.2 * 1e-6) ** 2
        assert other.std == pytest.approx(np.hypot(one.std, np.sqrt(variance)), rel=1e-6)
        assert other.high - other.value == pytest.approx(ROOT * other.std, rel=1e-6)
        assert other.value - other.low == pytest.approx(ROOT * other.std, rel=1e-6)
    for one, other in zip(sure.particles(), unsure.particles(), strict=True):
        assert other.speed.std > one.speed.std
        assert other.phi.high - other.phi.low > one.phi.high - one.phi.low
        assert other.force.high - other.force.low > one.force.high - one.force.low


def test_models_within_reach_are_rivals_and_what_may_be_besides(film):
    session, _ = film(66, {'command_delay': {'delay_s': 0.03}}, duration=20.0)
    known = consider(check_sessions([session])[0])
    reach = known.within_reach()
    assert 0 <= sum(p for _, p in reach) < 1
    assert all(p > 0.01 for _, p in reach)
    names = [{effect.id for effect in fit.model.effects} for fit, _ in reach]
    rivals = {one.id for slot in known.slots for one in slot.within_reach}
    assert all(any(rival in one for one in names) for rival in rivals)


def test_v_and_phi_hold_what_is_not_known_of_a_drift(drifting):
    """Against least squares of everything at once, v, φ and drift together."""
    fit, _ = drifting
    part, jacobian = fit.session_fits[0], fit.jacobian[0]
    count, width = len(part.session.ids), 2 * len(part.session.ids)
    design = np.zeros((*part.session.z.shape, width + 2), complex)
    for n in range(count):
        design[:, n, 2 * n:2 * n + 2] = part.white[:, n, 1:] / np.sqrt(part.diffusion)
    design[..., width:] = jacobian
    real = design.reshape(-1, width + 2)
    real = np.concatenate([real.real, real.imag])
    covariance = np.linalg.inv(real.T @ real)
    for n, polar in enumerate(zip(*[getattr(fit.polars()[0], of) for of in (
            'speed', 'speed_std', 'phi_std')], strict=True)):
        c = part.velocity_phasor[n]
        own = covariance[2 * n:2 * n + 2, 2 * n:2 * n + 2]
        along = np.array([c.real, c.imag]) / abs(c)
        across = np.array([-along[1], along[0]])
        assert polar[1] == pytest.approx(np.sqrt(along @ own @ along), rel=0.02)
        assert polar[2] == pytest.approx(np.sqrt(across @ own @ across) / abs(c), rel=0.02)


def test_a_profile_of_what_is_linear_tells_the_same(drifting, monkeypatch):
    fit, _ = drifting
    monkeypatch.setattr('microbot_ros.discovery.intervals.BENT', 1e-9)
    std = float(np.sqrt(fit.covariance[0, 0]))
    profile = _follow(fit, 0, std, fit.model.parameters[0][1])
    x = fit.model.vector()[0]
    assert profile.ends() == pytest.approx((x - ROOT * std, x + ROOT * std), rel=0.02)
    polar, = fit.polars()
    low, high = profile.hull(0, 'speed')
    assert low == pytest.approx(polar.speed - ROOT * polar.speed_std, rel=0.01)
    assert high == pytest.approx(polar.speed + ROOT * polar.speed_std, rel=0.01)


def test_an_end_of_a_profile_is_where_the_likelihood_has_fallen(saturating):
    fit, _ = saturating
    scale = Intervals(fit).effect('incomplete_alignment')['field_scale_mT']
    assert not scale.is_even
    parameter = fit.model.parameters[0][1]
    fallen = []
    for end in (scale.low, scale.high):
        vector = fit.model.vector()
        vector[0] = parameter.to_fit(end)
        held = maximise(fit.under(fit.model.with_vector(vector)), held=0)
        fallen.append(np.sqrt(held.cost - fit.cost))
    assert fallen[0] == pytest.approx(ROOT, abs=0.15)
    # Ever larger scales explain it nearly as well: the bound is where the interval ends.
    assert fallen[1] < ROOT
    assert scale.high == parameter.high


def test_v_follows_a_scale_that_is_hardly_known(saturating):
    fit, truth = saturating
    known = Intervals(fit)
    scale = known.effect('incomplete_alignment')['field_scale_mT']
    assert scale.low < 4e-3 < scale.high
    for particle, body in zip(known.particles(), truth, strict=True):
        assert particle.speed.low < body['speed'] < particle.speed.high
        assert particle.phi.low < body['phi'] < particle.phi.high or abs(
            abs(particle.phi.value - body['phi']) - 2 * np.pi) < 0.2


def test_a_fit_that_leaves_something_is_not_followed(saturating):
    fit, _ = saturating
    scale = Intervals(fit, complete=False).effect('incomplete_alignment')['field_scale_mT']
    assert scale.is_even
