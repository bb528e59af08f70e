"""`microbot fit` and `microbot discover` say the same of the same session."""

from dataclasses import replace

import numpy as np
import pytest

from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.estimation.batch import fit
from microbot_ros.virtual_rig.record_session import Camera


def torn(session):
    """With jumps of one particle, another that is seen for a second only, and time of day."""
    tracks, commands = session.tracks, session.commands
    position = tracks.position.copy()
    for moment in (8.0, 8.2, 15.0):
        position[(tracks.particle == 0) & (tracks.t > moment)] += 30e-6
    session = replace(
        session, tracks=replace(tracks, t=tracks.t + 1.7e9, position=position),
        commands=replace(commands, t=commands.t + 1.7e9))
    early = session.tracks.t < 1.7e9 + 10.0
    return replace(session, tracks=session.tracks.rows(
        (tracks.particle != 1) | (early & (session.tracks.t > 1.7e9 + 9.0))))


def with_uneven_frames(session):
    """Frames that come 25 ms early, every fifth of them."""
    times = session.tracks.t
    early = np.rint(times * 20) % 5 == 0
    return replace(session, tracks=replace(session.tracks, t=times - 0.025 * early))


def without_field_for_a_while(session):
    """The command ends after 20 s: headings keep what noise does to them."""
    field = np.where((session.commands.t > 20)[:, None], 0.0, session.commands.field)
    return replace(session, commands=replace(session.commands, field=field))


CASES = {
    'plain': ({}, lambda session: session),
    'gaps': ({'camera': Camera(20.0, 0.0, 0.1e-6, missed=0.2, run=4.0, dropped=0.05)},
             lambda session: session),
    'blur': ({'camera': Camera(20.0, 1.0, 0.03e-6)}, lambda session: session),
    'torn': ({'camera': Camera(20.0, 0.0, 0.1e-6, missed=0.1, run=3.0)}, torn),
    'crowded': ({'count': 8, 'half_extent': 70e-6}, lambda session: session),
    'field off': ({}, without_field_for_a_while),
    'uneven': ({'camera': Camera(20.0, 1.0, 0.03e-6)}, with_uneven_frames),
    'rollers': ({'rolling': True}, lambda session: session),
}


@pytest.mark.parametrize('case', CASES)
@pytest.mark.parametrize('seed', [40, 41])
def test_fit_and_the_baseline_of_discover_are_one(film, case, seed):
    drawn, change = CASES[case]
    session = change(film(seed, duration=25.0, **drawn)[0])
    one = fit(session)
    part, = fit_first_order(check_sessions([session])[0]).session_fits
    speeds = part.polar().of(part.session.main)
    assert list(one.ids) == list(session.tracks.particles)
    np.testing.assert_allclose(one.polar.speed, speeds.speed, rtol=1e-12)
    np.testing.assert_allclose(one.polar.phi, speeds.phi, rtol=0, atol=1e-12)
    noise = part.noise()
    assert one.noise.diffusion == pytest.approx(noise.diffusion, rel=1e-12)
    assert one.noise.diffusion_std == pytest.approx(noise.diffusion_std, rel=1e-9)
    assert one.noise.localisation == pytest.approx(noise.localisation, rel=1e-12, abs=1e-15)


def test_what_is_written_is_the_same(film):
    session, _ = film(42)
    one, found = fit(session), discover([session])
    assert found.verdict == 'consistent'
    for n, particle in enumerate(found.baseline):
        assert particle.speed.value == pytest.approx(one.polar.speed[n], rel=1e-12)
        assert particle.phi.value == pytest.approx(one.polar.phi[n], abs=1e-12)
        assert particle.force.value == pytest.approx(one.force[n], rel=1e-12)
        assert particle.force.std == pytest.approx(one.force_std[n], rel=0.01)
    assert found.diffusion.value == pytest.approx(one.noise.diffusion, rel=1e-12)
    assert found.localisation.std == pytest.approx(one.noise.localisation_std, rel=1e-9)


def test_times_count_from_the_first_frame(film):
    """A lag-free session that begins at noon, or a minute late, is the same session."""
    session, _ = film(43, {'speed_decay': {'tau_s': 20.0}}, duration=20.0)
    known = []
    for late in (0.0, 60.0, 1.7e9):
        moved = replace(
            session, tracks=replace(session.tracks, t=session.tracks.t + late),
            commands=replace(session.commands, t=session.commands.t + late))
        known.append(fit(moved).polar.speed)
        prepared, = check_sessions([moved])[0]
        assert prepared.times[0] < 2.0
    np.testing.assert_allclose(known[1], known[0], rtol=1e-9)
    np.testing.assert_allclose(known[2], known[0], rtol=1e-3)
