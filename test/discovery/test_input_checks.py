"""Bad input is told in a sentence that says what would be enough."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Conditions, Session
from microbot_ros.discovery.check.input_checks import at_a_wall, check_sessions
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.session.spreadsheets.assemble import import_session
from microbot_ros.session.spreadsheets.sheets import Answers
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

SHARED = Path(__file__).parents[2].parent / 'shared' / 'data' / 'speed_vs_frequency'


def test_too_brief(film):
    session, _ = film(0, duration=2.4, camera=Camera(60.0, 0.0, 0.1e-6))
    with pytest.raises(InputError, match=r'at least 2\.5 s.*found 2\.4 s'):
        check_sessions([session])


def test_particles_that_may_always_touch(film):
    session, _ = film(0, count=2, duration=8.0)
    tracks = session.tracks
    own = tracks.position[tracks.particle == 0]
    beside = np.stack([own, own + np.array([9e-6, 0.0])], axis=1).reshape(-1, 2)
    with pytest.raises(InputError, match='apart from each other'):
        check_sessions([replace(session, tracks=replace(tracks, position=beside))])


def moved(session, change):
    tracks = session.tracks
    return replace(session, tracks=replace(tracks, position=change(tracks.position.copy())))


def test_too_short(film):
    session, _ = film(0, duration=2.0)
    with pytest.raises(InputError, match=r'at least 50 frames.*found 4\d.*a minute'):
        check_sessions([session])


@pytest.mark.parametrize(('part', 'name', 'change', 'said'), [
    ('tracks', 'position', np.ones_like, 'particles that move'),
    ('tracks', 'position', lambda x: 1e3 * x, 'positions in µm'),
    ('tracks', 'position', lambda x: 1e-6 * x, 'which no microscope resolves: metres'),
    ('commands', 'field', np.zeros_like, 'commands with a nonzero field'),
    ('commands', 't', lambda t: t + 4.0, 'at least 50 frames'),
])
def test_what_nothing_can_be_found_in_is_named(film, part, name, change, said):
    session, _ = film(0, duration=5.0)
    of = getattr(session, part)
    with pytest.raises(InputError, match=said):
        check_sessions([replace(
            session, **{part: replace(of, **{name: change(getattr(of, name))})})])


def test_rollers_that_never_roll(film):
    session, _ = film(0, duration=5.0, rolling=True)
    still = replace(session.commands, frequency=np.zeros(len(session.commands.t)))
    with pytest.raises(InputError, match='a rotating field; found a frequency of 0 Hz'):
        check_sessions([replace(session, commands=still)])


@pytest.mark.parametrize('factor', [1000.0, 1 / 3600])
def test_times_in_another_unit(film, factor):
    session, _ = film(0, duration=5.0)
    late = replace(
        session, tracks=replace(session.tracks, t=session.tracks.t * factor),
        commands=replace(session.commands, t=session.commands.t * factor))
    with pytest.raises(InputError, match='expected times in s'):
        check_sessions([late])


def shaken(session, particles, seed=1):
    """Some particles lie where they are, read with an error of 0.1 µm."""
    rng = np.random.default_rng(seed)
    tracks = session.tracks

    def lie(position):
        for n in particles:
            rows = tracks.particle == n
            position[rows] = position[rows][0] + rng.normal(0, 1e-7, (rows.sum(), 2))
        return position
    return moved(session, lie)


def test_particles_that_are_stuck(film):
    session, _ = film(0, duration=10.0)
    with pytest.raises(InputError, match=r'within 0\.3 µm of their place'):
        check_sessions([shaken(session, (0, 1, 2))])
    _, remarks = check_sessions([shaken(session, (1,))])
    assert [r for r in remarks if 'stuck' in r] == [
        'film-0: stuck, as the position does not change: particle 1. It contradicts any effect '
        'that moves the others; leave it out.']


def test_particles_that_follow_no_command(film):
    session, _ = film(0, duration=10.0)
    rng = np.random.default_rng(2)

    def wander(position):
        for n in session.tracks.particles:
            rows = session.tracks.particle == n
            position[rows] = rng.normal(0, 1e-7, (rows.sum(), 2)).cumsum(axis=0) + 5e-5 * n
        return position
    _, remarks = check_sessions([moved(session, wander)])
    assert any('no particle follows the commands' in remark for remark in remarks)


def test_fields_in_tesla_and_commands_on_another_clock_are_remarked(film):
    session, _ = film(0, duration=10.0)
    commands = session.commands
    weak = replace(commands, field=1e-3 * commands.field)
    _, remarks = check_sessions([replace(session, commands=weak)])
    assert any('are the commands in mT?' in remark for remark in remarks)
    early = replace(commands, t=commands.t - 1000)
    _, remarks = check_sessions([replace(session, commands=early)])
    assert any('are both on one clock?' in remark for remark in remarks)


@pytest.mark.parametrize('change', [
    lambda tracks: tracks,
    lambda tracks: replace(tracks, position=tracks.position + np.array([1e-5, -3e-6])),
    lambda tracks: replace(tracks, t=tracks.t + 3.0),
    lambda tracks: tracks.rows(tracks.t > 3),
], ids=['same', 'elsewhere', 'later', 'part'])
def test_the_same_session_twice(film, change):
    session, _ = film(0, duration=6.0)
    again = replace(session, tracks=change(session.tracks))
    with pytest.raises(InputError, match='counted twice'):
        check_sessions([session, again])


def test_sessions_whose_steps_are_alike_by_chance_are_different(film):
    """A tracker that rounds to 0.1 µm."""
    rounded = [moved(film(seed, duration=6.0)[0], lambda p: np.round(p, 7)) for seed in (0, 1)]
    assert len(check_sessions(rounded)[0]) == 2


def test_two_kinds_of_propulsion(film):
    with pytest.raises(InputError, match='rolling beside catalytic in film-0: analyse each'):
        check_sessions([film(0, duration=5.0)[0], film(1, duration=5.0, rolling=True)[0]])


@pytest.mark.parametrize('rolling', [False, True])
def test_commands_for_another_kind_of_propulsion(film, rolling):
    session, _ = film(0, duration=5.0, rolling=rolling)
    other = replace(
        session.conditions, propulsion='catalytic' if rolling else 'rolling')
    with pytest.raises(InputError, match='expected commands of'):
        check_sessions([replace(session, conditions=other)])


def test_different_reference_fields_are_remarked(film):
    sessions = [film(seed, duration=5.0)[0] for seed in (0, 1)]
    assert check_sessions(sessions)[1] == ()
    sessions[1] = replace(
        sessions[1], conditions=replace(sessions[1].conditions, reference_field=2.5e-3))
    remark, = check_sessions(sessions)[1]
    assert remark.endswith('(5 mT, 2.5 mT); alignment times are those at 5 mT.')


def test_one_particle_and_a_constant_command_are_remarked(film):
    session, _ = film(0, count=1, duration=5.0, dwell=(6.0, 7.0))
    _, remarks = check_sessions([session])
    assert any('one particle' in remark for remark in remarks)
    assert any('never turned' in remark for remark in remarks)
    _, none = check_sessions([film(0, duration=10.0)[0]])
    assert none == ()


def exchanged(session, at_s):
    """Tracks of two particles confused from a time on."""
    tracks = session.tracks
    particle = np.where(tracks.t > at_s, 1 - tracks.particle, tracks.particle)
    order = np.lexsort((particle, tracks.t))
    return replace(session, tracks=replace(
        tracks, particle=particle[order], position=tracks.position[order]))


def test_exchanged_tracks_are_exchanged_back_and_told(film):
    session, _ = film(3, count=2, duration=10.0)
    (prepared,), remarks = check_sessions([exchanged(session, 5.0)])
    whole, = check_sessions([session])[0]
    assert prepared.jumps.sum() == 0
    np.testing.assert_array_equal(prepared.z, whole.z)
    told, = (remark for remark in remarks if 'swapped' in remark)
    assert 'particles 0 and 1 exchange places at 5.05 s' in told
    # Once more, and all is as it was.
    twice, = check_sessions([exchanged(exchanged(session, 5.0), 7.0)])[0]
    np.testing.assert_array_equal(twice.z, whole.z)
    # Experiments that were joined hold other particles.
    first, second = exchanged(session, 5.0), session
    at = session.tracks.t[-1] + 1.0
    both = replace(first, breaks=np.array([at - 0.5]), tracks=type(session.tracks)(*(
        np.concatenate([getattr(first.tracks, name), getattr(second.tracks, name) + at * (
            name == 't')]) for name in ('t', 'particle', 'position', 'theta', 'sigma'))))
    apart, = check_sessions([both])[0]
    rows = apart.seen.any(axis=1)
    np.testing.assert_array_equal(apart.z[rows][-len(whole.z):], whole.z)
    _, remarks = check_sessions([replace(exchanged(session, 5.0), breaks=np.array([5.02]))])
    assert not any('swapped' in one for one in remarks)


def test_tracks_that_jump_far_are_cut_and_go_on_as_others(film):
    session, _ = film(3, count=2, duration=10.0)
    tracks = session.tracks
    away = np.array([[5e-5, 0.0], [0.0, 5e-5]])[tracks.particle] * (tracks.t > 5.0)[:, None]
    (prepared,), remarks = check_sessions(
        [replace(session, tracks=replace(tracks, position=tracks.position + away))])
    assert prepared.jumps.sum() == 2
    assert list(prepared.ids) == [0, 0, 1, 1]
    assert (prepared.seen.sum(axis=0) > 90).all()
    assert any('2 steps are longer than the motion' in remark for remark in remarks)


def broken(session, gap_s, at_s=(4.0, 5.0, 6.0)):
    """Each track gets a new name after a gap."""
    tracks = session.tracks
    at = np.array(at_s)[tracks.particle]
    later = tracks.t >= at + gap_s
    kept = (tracks.t < at) | later
    named = replace(tracks, particle=np.where(later, tracks.particle + 10, tracks.particle))
    order = np.lexsort((named.particle[kept], named.t[kept]))
    return replace(session, tracks=named.rows(kept).rows(order))


def test_broken_tracks_are_joined_and_told(film):
    session, _ = film(3, count=3, duration=10.0)
    (prepared,), remarks = check_sessions([broken(session, 0.3)])
    assert list(prepared.ids) == [0, 1, 2]
    assert any('3 tracks begin where another ended at most 1 s before, with no other near: joined '
               '(10 to 0, 11 to 1, 12 to 2)' in remark for remark in remarks)
    whole, = check_sessions([session])[0]
    seen = prepared.seen
    np.testing.assert_array_equal(prepared.z[seen], whole.z[seen])
    assert np.isnan(prepared.causal_positions[~seen]).all()


@pytest.mark.parametrize('change', ['too late', 'elsewhere', 'another near', 'another experiment'])
def test_tracks_are_not_joined_where_there_is_doubt(film, change):
    session, _ = film(3, count=3, duration=10.0)
    session = broken(session, 1.1 if change == 'too late' else 0.3)
    tracks, away = session.tracks, np.zeros(2)
    if change == 'elsewhere':
        away = np.array([3e-5, 0.0])
    if change == 'another near':  # a second one begins beside each
        late = tracks.rows(tracks.particle >= 10)
        joined = [np.concatenate([getattr(tracks, name), getattr(late, name)])
                  for name in ('t', 'particle', 'position', 'theta', 'sigma')]
        joined[1][len(tracks.t):] += 10
        joined[2][len(tracks.t):] += 3e-6
        tracks = type(tracks)(*joined).rows(np.lexsort((joined[1], joined[0])))
    moved_tracks = replace(
        tracks, position=tracks.position + away * (tracks.particle >= 10)[:, None])
    breaks = np.array([4.05, 5.05, 6.05] if change == 'another experiment' else [])
    (prepared,), remarks = check_sessions([replace(session, tracks=moved_tracks, breaks=breaks)])
    assert {0, 1, 2, 10, 11, 12} <= set(prepared.ids.tolist())
    assert not any('joined' in one for one in remarks)


def test_frames_that_are_lost_part_no_track(film):
    """In 1.5 s particles go thirty times as far as in a frame."""
    session, _ = film(3, count=3, duration=10.0)
    lost = (session.tracks.t > 4.0) & (session.tracks.t < 5.5)
    prepared, = check_sessions([replace(session, tracks=session.tracks.rows(~lost))])[0]
    assert list(prepared.ids) == [0, 1, 2]


def disturbed(session, size, seed=5):
    """A tracker that slips in a hundredth of the frames, and a stage that is touched twice."""
    rng = np.random.default_rng(seed)
    tracks = session.tracks
    slipped = rng.random(len(tracks.t)) < 0.01
    away = size * np.exp(1j * rng.uniform(-np.pi, np.pi, slipped.sum()))
    touched = (tracks.t > 7.0) * np.array([[size], [0]]) - (tracks.t > 15.0) * size

    def change(position):
        position[slipped] += np.stack([away.real, away.imag], axis=1)
        return position + touched.T
    return moved(session, change), int(slipped.sum()), 2 * len(tracks.particles)


@pytest.mark.parametrize('size', [2e-6, 3e-6, 10e-6])
def test_slips_and_steps_are_cut_and_counted(film, size):
    """Particles stay the same ones, but where a step is too large for any motion at all."""
    session, slips, steps = disturbed(film(6, duration=20.0)[0], size)
    (prepared,), remarks = check_sessions([session])
    assert prepared.jumps.sum() == pytest.approx(slips + steps, abs=0.2 * (slips + steps))
    assert prepared.seen.sum() > 0.95 * len(session.tracks.t)
    assert any(f'{prepared.jumps.sum()} steps are longer than the motion' in r for r in remarks)


@pytest.mark.parametrize('hidden', [
    {}, {'alignment_lag': {'tau_s': 0.1}}, {'alignment_lag': {'tau_s': 0.3}},
    {'command_delay': {'delay_s': 0.1}}, {'amplifier_deadband': {'deadband_mT': 1.0}},
    {'hot_spot': {'x_um': 0.0, 'y_um': 0.0, 'speed_um_s': 10.0, 'width_um': 15.0}}],
    ids=lambda hidden: '-'.join(hidden) or 'nothing')
@pytest.mark.parametrize('rolling', [False, True])
def test_motion_is_never_cut(film, hidden, rolling):
    """However sharply it turns, and at any speed."""
    for seed in range(4):
        (prepared,), _ = check_sessions([film(60 + seed, hidden, rolling=rolling)[0]])
        assert prepared.jumps.sum() == 0


def test_a_body_that_leaps_with_every_turn_is_not_cut(film):
    """That is how it moves."""
    session, _ = film(7, duration=20.0)
    tracks = session.tracks
    leaps = np.floor(2.0 * tracks.t)[:, None] * np.array([3e-6, 0.0])
    (prepared,), _ = check_sessions([moved(session, lambda position: position + leaps)])
    assert prepared.jumps.sum() == 0


def test_frames_before_the_first_field_are_left_out(film):
    session, _ = film(4, duration=10.0)
    late = replace(session.commands, t=session.commands.t + 3.0)
    (prepared,), _ = check_sessions([replace(session, commands=late)])
    assert prepared.times[0] >= 3.0


def test_spheres_in_contact_are_cut(film):
    """They push each other; what is left never comes nearer than contact."""
    session, _ = film(5, count=6, duration=60.0, half_extent=40e-6)
    (prepared,), _ = check_sessions([session])
    z = np.where(prepared.seen, prepared.z, np.nan)
    apart = np.abs(z[:, :, None] - z[:, None, :])
    assert np.nanmin(np.where(apart > 0, apart, np.nan)) > 2 * 4.6e-6
    assert prepared.pieces.max() > 1


def walled(seed, spread, starts=(0.0, -80.0, -160.0), duration=30.0):
    """Swimmers [µm from a wall at x = 0], who swim into it, but for turns of up to `spread`."""
    rng = np.random.default_rng(seed)
    made = draw_swarm(rng, len(starts), Fluid(1.245e-3), 5e-3, aligns_in=2e-5)
    wall = 200e-6
    made['x'], made['y'] = wall + 1e-6 * np.array(starts), 60e-6 * np.arange(len(starts))
    t = np.cumsum(rng.uniform(1.0, 3.0, 30)) - 3.0
    angle = -made['phi'][0] + rng.uniform(-spread, spread, 30)
    commands = Commands(t, 5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    known = Conditions(radius=4.6e-6, viscosity=1.245e-3, reference_field=5e-3)
    world = World(made, rng, half_extent=(wall, np.inf))
    session, _ = record_session(world, commands, Camera(20.0, 0.0, 0.1e-6), duration, rng, known)
    return Session(session.tracks, session.commands, session.conditions, f'walled-{seed}')


@pytest.mark.parametrize('spread', [0.5, 1.0, 1.5, 2.0])
@pytest.mark.parametrize('turn', [0.0, 0.7, 2.0])
def test_particles_pressed_against_a_wall_are_left_out(spread, turn):
    session = walled(3, spread)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    session = moved(session, lambda p: p @ rotation)
    prepared, remarks = check_sessions([session])
    assert list(prepared[0].ids) == [1, 2]
    assert [r for r in remarks if 'wall' in r] == [
        'walled-3: pressed against a wall or the edge of the dish: particle 0. Left out: the '
        'force that holds it acts on no other particle.']


def test_a_broken_track_at_a_wall_is_left_out_whole():
    session = walled(3, 1.0)
    (prepared,), remarks = check_sessions([broken(session, 0.3, (12.0, 13.0, 14.0))])
    assert list(prepared.ids) == [1, 2]
    assert any('dish: particle 0. Left out' in remark for remark in remarks)


def test_where_a_wall_holds_all_that_is_told():
    with pytest.raises(InputError, match='all pressed against a wall'):
        check_sessions([walled(4, 1.0, starts=(0.0,))])


@pytest.mark.soak
def test_free_particles_are_never_taken_for_pressed(film):
    """Also where they are carried along, held together or turned late."""
    hidden = [{}, {'uniform_drift': {'wx_um_s': 1.0, 'wy_um_s': -1.0}},
              {'alignment_lag': {'tau_s': 0.5}},
              {'background_field': {'bx_mT': 1.0, 'by_mT': 0.0}},
              {'linear_flow': {'gxx_per_s': -0.05, 'gxy_per_s': 0.0, 'gyx_per_s': 0.0,
                               'gyy_per_s': -0.05}}]
    alarms = [seed for seed in range(100) if at_a_wall(PreparedSession.of(
        film(seed, hidden[seed % len(hidden)], duration=10.0 + seed % 3 * 10.0)[0])).any()]
    assert not alarms


@pytest.mark.skipif(not SHARED.is_dir(), reason='needs shared/data')
def test_a_roller_that_keeps_to_one_line_is_free():
    """The motion along a border hardly says how far commands push towards it."""
    dimer, _ = import_session(SHARED / 'dimers_20um' / '20umDimer4.xlsx', Answers())
    travelled = np.abs(np.diff(PreparedSession.of(dimer).z[:, 0])).sum()
    assert 15e-3 < travelled < 16e-3
    assert not at_a_wall(PreparedSession.of(dimer)).any()
