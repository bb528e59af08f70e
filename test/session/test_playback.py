"""Playing a session: what is due when, driven by a clock of the test's own."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import record, small_session

from microbot_ros.common.errors import InputError
from microbot_ros.session import write_session
from microbot_ros.session.replay.as_messages import SessionMessages
from microbot_ros.session.replay.playback import Playback, open_source

SOURCE = SessionMessages(small_session())
ALL = list(SOURCE.messages())
LENGTH = (SOURCE.end_ns - SOURCE.start_ns) / 1e9


def drain(playback: Playback, now: float, most: int = 10**6) -> list:
    taken = []
    while len(taken) < most and (message := playback.take(now)) is not None:
        taken.append(message)
    return taken


def run(playback: Playback, now: float = 0.0, until: float = 1e9) -> list:
    """(time, message) pairs as an ideal caller would send them."""
    sent = []
    while (wait := playback.wait(now)) < math.inf and now + wait <= until:
        now += wait
        sent += [(now, message) for message in drain(playback, now)]
    return sent


@pytest.mark.parametrize('rate', [0.1, 1.0, 7.5, 100.0])
def test_every_message_is_sent_once_in_order_at_its_time(rate):
    sent = run(Playback(SOURCE, 50.0, rate=rate), 50.0)
    assert [message for _, message in sent] == ALL
    due = [50 + (m.t_ns - SOURCE.start_ns) / 1e9 / rate for m in ALL]
    np.testing.assert_allclose([now for now, _ in sent], due, atol=1e-9)


def test_as_fast_as_it_goes_everything_is_due_at_once():
    playback = Playback(SOURCE, 0.0, rate=math.inf)
    assert playback.take(0.0) == ALL[0]
    assert playback.clock_ns(0.0) == ALL[0].t_ns
    assert drain(playback, 0.0) == ALL[1:]
    assert playback.finished
    assert playback.wait(0.0) == math.inf


def test_the_clock_runs_at_the_rate_but_never_past_a_message_not_yet_taken():
    playback = Playback(SOURCE, 0.0, rate=2.0)
    assert playback.clock_ns(0.0) == SOURCE.start_ns
    following = ALL[len(drain(playback, 0.0))].t_ns
    assert following > SOURCE.start_ns
    assert playback.clock_ns(1e-3) == SOURCE.start_ns + 2_000_000
    assert playback.clock_ns(5.0) == following
    drain(playback, 1e3)
    assert playback.finished
    assert playback.clock_ns(1e3) == SOURCE.end_ns


def test_start_end_and_topics_choose():
    playback = Playback(SOURCE, 0.0, start=0.5, end=1.5, topics=['particles'])
    low, high = SOURCE.start_ns + 500_000_000, SOURCE.start_ns + 1_500_000_000
    expected = [m for m in ALL if m.topic == '/particles' and low <= m.t_ns <= high]
    sent = run(playback)
    assert [message for _, message in sent] == expected
    assert sent[0][0] == pytest.approx((expected[0].t_ns - low) / 1e9)


def test_a_loop_starts_again_and_its_clock_jumps_back():
    playback = Playback(SOURCE, 0.0, rate=10.0, start=1.0, loop=True)
    once = [m for m in ALL if m.t_ns >= SOURCE.start_ns + 10**9]
    sent = [message for _, message in run(playback, until=3.2 * (LENGTH - 1) / 10)]
    assert len(sent) > 3 * len(once)
    assert sent[:3 * len(once)] == once * 3
    assert not playback.finished


def test_paused_nothing_is_due_and_the_clock_stands():
    playback = Playback(SOURCE, 0.0)
    drain(playback, 0.5)
    playback.pause(0.5)
    stood = playback.clock_ns(0.5)
    assert playback.paused
    assert drain(playback, 99.0) == []
    assert playback.wait(99.0) == math.inf
    assert playback.clock_ns(99.0) == stood
    playback.resume(100.0)
    rest = run(playback, 100.0)
    assert [m for _, m in rest] == [m for m in ALL if m.t_ns > SOURCE.start_ns + 500_000_000]
    assert rest[-1][0] == pytest.approx(100 + LENGTH - 0.5, abs=1e-6)


def test_a_step_hands_out_one_message_or_one_frame():
    playback = Playback(SOURCE, 0.0)
    assert list(playback.step(0.0)) == ALL[:1]
    assert playback.clock_ns(0.0) == ALL[0].t_ns
    frames = [i for i, m in enumerate(ALL) if m.topic == '/particles']
    assert list(playback.step(0.0, 'particles')) == ALL[1:frames[0] + 1]
    assert list(playback.step(0.0, 'particles')) == ALL[frames[0] + 1:frames[1] + 1]
    assert playback.paused
    while list(playback.step(0.0, 'particles')):
        pass
    assert playback.finished


def test_seeking_goes_both_ways_and_stays_within_the_limits():
    playback = Playback(SOURCE, 0.0, start=0.25)
    drain(playback, 1.0)
    playback.seek(0.5, 1.0)
    assert playback.clock_ns(1.0) == SOURCE.start_ns + 500_000_000
    rest = run(playback, 1.0)
    assert [m for _, m in rest] == [m for m in ALL if m.t_ns >= SOURCE.start_ns + 500_000_000]
    assert playback.finished
    playback.seek(0.25, 9.0)
    assert not playback.finished
    for bad in (0.2, LENGTH + 1, math.nan, math.inf):
        with pytest.raises(InputError, match=r'0\.25 to'):
            playback.seek(bad, 9.0)


def test_the_rate_changes_without_a_jump():
    playback = Playback(SOURCE, 0.0)
    drain(playback, 0.6)
    before = playback.clock_ns(0.6)
    playback.set_rate(50.0, 0.6)
    assert playback.clock_ns(0.6) == before
    sent = run(playback, 0.6)
    assert sent[-1][0] == pytest.approx(0.6 + (LENGTH - 0.6) / 50, abs=1e-6)
    assert len(sent) == sum(m.t_ns > before for m in ALL)


@settings(max_examples=40)
@given(st.lists(st.tuples(
    st.sampled_from(['wait', 'pause', 'resume', 'rate', 'step']), st.floats(0, 0.4)), max_size=30))
def test_whatever_is_done_on_the_way_nothing_is_lost_doubled_or_early(actions):
    playback, now, sent = Playback(SOURCE, 0.0), 0.0, []
    for action, amount in actions:
        now += amount
        taken = drain(playback, now)
        assert all(m.t_ns <= playback.clock_ns(now) for m in taken)
        sent += taken
        if action == 'pause':
            playback.pause(now)
        elif action == 'resume':
            playback.resume(now)
        elif action == 'rate':
            playback.set_rate(0.1 + 20 * amount, now)
        elif action == 'step':
            sent += playback.step(now)
    assert sent == ALL[:len(sent)]


@pytest.mark.parametrize(('options', 'said'), [
    ({'rate': 0.0}, 'rate'), ({'rate': math.nan}, 'rate'), ({'rate': -1.0}, 'rate'),
    ({'rate': 101.0}, 'rate'), ({'start': -0.1}, 'start'), ({'start': math.nan}, 'start'),
    ({'start': 1e3}, 'start'), ({'end': math.nan}, 'end'), ({'start': 1.0, 'end': 0.5}, 'end'),
    ({'topics': ['partciles']}, '/field/command, /particles'),
])
def test_options_out_of_range_are_refused(options, said):
    with pytest.raises(InputError, match=said):
        Playback(SOURCE, 0.0, **options)


def test_both_kinds_of_session_open_for_playing(tmp_path):
    write_session(tmp_path / 'csv', small_session())
    record(tmp_path / 'run', small_session())
    for path in (tmp_path / 'csv', tmp_path / 'run'):
        with open_source(path) as source:
            assert [m for _, m in run(Playback(source, 0.0))] == ALL
    with pytest.raises(InputError, match='found nothing'), open_source(tmp_path / 'nowhere'):
        pass
