"""Bad input is told in a sentence that says what would be enough."""

from dataclasses import replace

import numpy as np
import pytest

from microbot_ros.discovery.screen import screen
from microbot_ros.errors import InputError


def moved(session, change):
    tracks = session.tracks
    return replace(session, tracks=replace(tracks, position=change(tracks.position.copy())))


def test_too_short(film):
    session, _ = film(0, duration=2.0)
    with pytest.raises(InputError, match=r'at least 50 frames.*found 4\d.*a minute'):
        screen([session])


def test_no_commands(film):
    session, _ = film(0, duration=5.0)
    commands = replace(session.commands, field=np.zeros_like(session.commands.field))
    with pytest.raises(InputError, match='commands with a field that is not zero'):
        screen([replace(session, commands=commands)])


def test_no_motion(film):
    session, _ = film(0, duration=5.0)
    with pytest.raises(InputError, match='particles that move'):
        screen([moved(session, lambda p: np.ones_like(p))])


def test_units_a_thousand_times_too_large(film):
    session, _ = film(0, duration=5.0)
    with pytest.raises(InputError, match='positions in µm'):
        screen([moved(session, lambda p: 1e3 * p)])


def test_the_same_session_twice(film):
    session, _ = film(0, duration=5.0)
    with pytest.raises(InputError, match='counted twice'):
        screen([session, session])


def test_two_kinds_of_propulsion(film):
    with pytest.raises(InputError, match='one kind of propulsion'):
        screen([film(0, duration=5.0)[0], film(1, duration=5.0, rolling=True)[0]])


def test_one_particle_and_a_constant_command_are_remarked(film):
    session, _ = film(0, count=1, duration=5.0, dwell=(6.0, 7.0))
    _, remarks = screen([session])
    assert any('one particle' in remark for remark in remarks)
    assert any('never turned' in remark for remark in remarks)
    _, none = screen([film(0, duration=10.0)[0]])
    assert none == ()


def test_confused_tracks_are_cut_and_told(film):
    """Two tracks exchanged half-way: each jumps, and goes on as another piece of the track."""
    session, _ = film(3, count=2, duration=10.0)
    tracks = session.tracks
    particle = np.where(tracks.t > 5.0, 1 - tracks.particle, tracks.particle)
    order = np.lexsort((particle, tracks.t))
    swapped = replace(tracks, particle=particle[order], position=tracks.position[order])
    (evidence,), remarks = screen([replace(session, tracks=swapped)])
    assert evidence.jumps == 2
    assert evidence.z.shape[1] == 4
    assert list(evidence.owner) == [0, 0, 1, 1]
    assert any('longer than any motion' in remark for remark in remarks)


def test_frames_before_the_first_field_are_left_out(film):
    session, _ = film(4, duration=10.0)
    late = replace(session.commands, t=session.commands.t + 3.0)
    (evidence,), _ = screen([replace(session, commands=late)])
    assert evidence.times[0] >= 3.0


def test_times_of_day_are_counted_from_the_first_frame(film):
    session, _ = film(4, duration=10.0)
    today = 1.7e9
    tracks = replace(session.tracks, t=session.tracks.t + today)
    commands = replace(session.commands, t=session.commands.t + today)
    (evidence,), _ = screen([replace(session, tracks=tracks, commands=commands)])
    assert 0 <= evidence.times[0] < 0.1


def test_spheres_in_contact_are_cut(film):
    """They push each other; what is left never comes nearer than contact."""
    session, _ = film(5, count=6, duration=60.0, half_extent=40e-6)
    (evidence,), _ = screen([session])
    z = np.where(evidence.seen, evidence.z, np.nan)
    apart = np.abs(z[:, :, None] - z[:, None, :])
    assert np.nanmin(np.where(apart > 0, apart, np.nan)) > 2 * 4.6e-6
    assert len(evidence.ids) > 6
