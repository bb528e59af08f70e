"""Lock-step: what holds a playback back, and in which order things were taken."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import Listed, small_session, vector

from microbot_ros.common.errors import InputError
from microbot_ros.session.as_messages import SessionMessages
from microbot_ros.session.lockstep import LockStep, frame_topic, header_stamp_ns
from microbot_ros.session.playback import Playback
from microbot_ros.session.recording import Message
from microbot_ros.session.replay_order import ReplayOrder

SOURCE = SessionMessages(small_session())
ALL = list(SOURCE.messages())
ANSWERS = ('/model/state', '/field/command')
VECTOR = 'geometry_msgs/msg/Vector3Stamped'


def lockstep(answers=ANSWERS):
    return LockStep(Playback(SOURCE, 0.0, rate=math.inf), '/particles', answers)


@given(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
@settings(max_examples=30)
def test_the_stamp_is_read_out_of_the_bytes(seconds, nanoseconds):
    t_ns = seconds * 10**9 + nanoseconds
    assert header_stamp_ns(vector(t_ns, 1.0, 2.0)) == t_ns
    big = b'\0\0\0\0' + struct.pack('>iI', seconds, nanoseconds)
    assert header_stamp_ns(big) == t_ns


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', bytes(11)])
def test_a_message_too_short_for_a_header_is_refused(data):
    with pytest.raises(InputError, match='expected a message with a header'):
        header_stamp_ns(data)


def test_the_next_frame_waits_for_every_answer_to_the_last():
    steps = lockstep()
    sent = []
    while not steps.finished:
        batch = list(steps.take(0.0))
        assert [m.topic for m in batch].count('/particles') <= 1
        sent += batch
        if batch[-1].topic != '/particles':
            break
        assert list(steps.take(0.0)) == []
        stamp = header_stamp_ns(batch[-1].data)
        assert steps.missing == dict.fromkeys(ANSWERS, stamp)
        steps.answer('/model/state', stamp - 1)
        steps.answer('/particles', stamp)
        steps.answer('/model/state', stamp)
        assert list(steps.take(0.0)) == []
        assert not steps.finished
        steps.answer('/field/command', stamp)
    assert sent == ALL
    assert steps.finished


def test_without_answers_nothing_is_held_back():
    assert list(lockstep(()).take(0.0)) == ALL


def test_a_step_is_one_message_and_none_while_an_answer_is_to_come():
    steps = lockstep()
    while not steps.missing:
        assert len(list(steps.step(0.0))) == 1
    assert list(steps.step(0.0)) == []


def test_what_else_is_waited_for_counts():
    steps = lockstep(())
    steps.expect('controller/set_parameters', 0)
    assert list(steps.take(0.0)) == []
    steps.answer('controller/set_parameters', 0)
    assert list(steps.take(0.0)) == ALL


def test_the_frame_is_what_stands_first_in_the_graph():
    assert frame_topic(['/a/particles', '/a/camera/image_raw']) == '/a/camera/image_raw'
    assert frame_topic(['/model/state', '/goals']) == '/model/state'
    assert frame_topic(['/goals']) == ''


@pytest.mark.parametrize(('answers', 'frame'), [
    (['/field/command'], '/model/state'),
    (['/model/state', '/field/command'], '/particles'),
    (['/coils/command'], '/particles'),
])
def test_the_frame_is_what_sets_the_first_node_going_not_what_it_takes_beside(answers, frame):
    assert frame_topic(['/particles', '/model/state', '/goals'], answers) == frame


def message(topic, t_ns, stamp_ns=0):
    return Message(topic, VECTOR, t_ns, vector(stamp_ns, 0.0, 0.0))


FRAMES = [message('/particles', t, t - 3) for t in (100, 200, 300)]
COMMANDS = [message('/field/command', t + 30, t - 3) for t in (100, 200, 300)]


@pytest.mark.parametrize(('told', 'taken'), [
    (90, 90), (110, 100), (130, 100), (131, 131), (150, 150), (215, 200), (400, 400)])
def test_a_goal_stands_before_the_frame_whose_answer_was_the_first_after_it(told, taken):
    goal = message('/goals', told)
    source = ReplayOrder(Listed([*FRAMES, *COMMANDS, goal]), '/particles', '/field/command')
    played = list(source.messages(['/particles', '/goals']))
    assert [m for m in played if m.topic == '/particles'] == FRAMES
    place = [m.topic for m in played].index('/goals')
    assert played[place].t_ns == taken
    assert all(m.t_ns < taken for m in played[:place])
    assert all(m.t_ns >= taken for m in played[place + 1:])


STATES = [message('/model/state', t + 20, t - 3) for t in (100, 200, 300)]


@pytest.mark.parametrize(('topic', 'told', 'taken'), [
    ('/goals', 119, 100), ('/particle_goals', 119, 100), ('/goals', 125, 125),
    ('/goals', 205, 200), ('/parameter_events', 125, 100), ('/parameter_events', 131, 131)])
def test_a_goal_that_came_while_the_controller_computed_waits_a_change_it_reports_does_not(
        topic, told, taken):
    source = Listed([*FRAMES, *STATES, *COMMANDS, message(topic, told)])
    ordered = ReplayOrder(source, '/particles', '/field/command')
    played = list(ordered.messages(['/particles', topic]))
    assert next(m.t_ns for m in played if m.topic == topic) == taken
    assert [m.t_ns for m in played] == sorted(m.t_ns for m in played)


def test_without_recorded_answers_everything_stays_where_it_was():
    goal = message('/goals', 115)
    source = Listed([*FRAMES, goal])
    assert list(ReplayOrder(source, '/particles', '/field/command').messages()) == source.listed
    plain = ReplayOrder(SOURCE, '/particles', '/field/command')
    assert list(plain.messages()) == ALL
    assert list(plain.messages(None, ALL[5].t_ns, ALL[9].t_ns)) == [
        m for m in ALL if ALL[5].t_ns <= m.t_ns < ALL[9].t_ns]
