"""What an answer was made from: as a node says, as a recording shows it, and what stays open."""

import json
import math
import struct

import pytest
from recordings import Listed, vector

from microbot_ros.common.errors import InputError
from microbot_ros.session.accounts import (
    HEALED_NS,
    Doubt,
    Taken,
    kept_turns,
    lasting,
    likely_turns,
    unjudgeable,
)
from microbot_ros.session.inputs import Inputs
from microbot_ros.session.recording import Message

VECTOR = 'geometry_msgs/msg/Vector3Stamped'
MS = 1_000_000


def heard(topic, t_ms, stamp_ms, x=0.0):
    return Message(topic, VECTOR, t_ms * MS, vector(stamp_ms * MS, x, 0.0))


def account(t_ms, turn, *taken):
    text = json.dumps({'turn': turn, 'taken': taken}).encode() + b'\0'
    return Message('/model/account', 'std_msgs/msg/String', t_ms * MS,
                   b'\0\1\0\0' + struct.pack('<I', len(text)) + text)


def frame(stamp, *verdicts):
    return ['particles', stamp, stamp + 5, *verdicts]


def turns(*messages):
    return list(kept_turns(Listed(messages), '/model/account', 'model', 'particles'))


def test_an_account_lists_what_was_taken_for_each_frame():
    first, second = turns(account(1, 1, ['field/applied', 7, 9], frame(10)),
                          account(2, 2, frame(20, 'tl')))
    assert first.taken == (Taken('field/applied', 7, 9), Taken('particles', 10, 15))
    assert second.taken == (Taken('particles', 20, 25, 'tl'),)
    assert (first.stamp_ns, second.stamp_ns) == (10, 20)
    assert first.doubts == second.doubts == ()


def test_what_was_taken_while_no_frame_came_belongs_to_the_next():
    [turn] = turns(account(1, 0, ['field/applied', 1, 2]), account(2, 1, frame(10)))
    assert [taken.stamp_ns for taken in turn.taken] == [1, 10]
    assert turn.doubts == ()


@pytest.mark.parametrize(('accounts', 'place', 'reason'), [
    ([account(1, 5, frame(10)), account(2, 6, frame(20))], 0, 'before the recording began'),
    ([account(1, 1, frame(10)), account(2, 3, frame(20))], 1, 'of which no account was kept'),
    ([account(1, 1, frame(10)), account(2, 1, frame(20))], 1, 'was started again'),
    ([account(1, 2, frame(10)), account(2, 1, frame(20))], 1, 'was started again'),
    ([account(1, 1, frame(10)), account(2, 2, ['calls', 0, 3], frame(20))], 1, 'refused'),
])
def test_what_a_node_knew_before_and_nobody_kept_is_in_doubt(accounts, place, reason):
    found = turns(*accounts)[place]
    assert any(reason in doubt.reason for doubt in found.doubts)
    assert all(doubt.last_ns == math.inf for doubt in found.doubts)


@pytest.mark.parametrize('text', [b'steam\0', b'{}\0', b'{"turn": 1, "taken": []}\0',
                                  b'{"turn": 1, "taken": [["particles"]]}\0'])
def test_what_is_no_account_is_refused(text):
    data = b'\0\1\0\0' + struct.pack('<I', len(text)) + text
    with pytest.raises(InputError, match='expected the account of a node'):
        turns(Message('/model/account', 'std_msgs/msg/String', 1, data))


@pytest.mark.parametrize(('came', 'doubtful'), [
    (96, []), (98, [100]), (104, [100]), (119, [100]), (121, []), (198, [200])])
def test_without_accounts_an_order_that_may_have_been_another_is_in_doubt(came, doubtful):
    source = Listed([*(heard('/particles', t, t) for t in (100, 200, 300)),
                     *(heard('/model/state', t + 20, t) for t in (100, 200, 300)),
                     heard('/field/applied', came, came - 1)])
    found = list(likely_turns(source, '/particles', '/model/state',
                              {'/field/applied': 'field/applied'}))
    assert [turn.stamp_ns // MS for turn in found] == [100, 200, 300]
    assert [turn.stamp_ns // MS for turn in found if turn.doubts] == doubtful
    assert all(doubt.reason == 'the order of field/applied and the frame is not known'
               for turn in found for doubt in turn.doubts)
    assert sum(len(turn.taken) for turn in found) == 4


def test_without_accounts_a_frame_without_an_answer_leaves_the_rest_in_doubt():
    source = Listed([*(heard('/particles', t, t) for t in (100, 200, 300)),
                     heard('/model/state', 120, 100), heard('/model/state', 320, 300)])
    found = list(likely_turns(source, '/particles', '/model/state', {}))
    assert [bool(turn.doubts) for turn in found] == [False, True, False]
    assert found[1].doubts[0].last_ns == math.inf


def test_a_doubt_explains_what_differs_from_it_on_and_nothing_before():
    same = {10: True, 20: False, 30: True, 40: False, 50: False, 60: True, 70: False}
    assert unjudgeable(same, []) == {}
    assert unjudgeable(same, [Doubt(40, 40, 'order')]) == {40: 'order', 50: 'order'}
    assert unjudgeable(same, [Doubt(50, 50, 'order')]) == {}
    assert unjudgeable(same, [lasting(30, 'lost')]) == dict.fromkeys([40, 50, 70], 'lost')


def test_an_order_explains_no_difference_that_stays():
    short = {0: False, HEALED_NS // 2: False, HEALED_NS: False, HEALED_NS + 1: True}
    assert len(unjudgeable(short, [Doubt(0, 0, 'order')])) == 3
    assert unjudgeable({**short, HEALED_NS + 1: False}, [Doubt(0, 0, 'order')]) == {}


def test_inputs_are_found_by_stamp_in_whatever_order_they_came():
    source = Listed([heard('/goals', 900, 5, x) for x in (1.0,)]
                    + [heard('/a', t, s) for t, s in ((100, 1), (130, 2), (90, 3))])
    inputs = Inputs(source, {'a': '/a', 'goals': '/goals'})
    assert [inputs.find('a', s * MS, 100 * MS) for s in (1, 2, 3)] == [
        vector(s * MS, 0.0, 0.0) for s in (1, 2, 3)]
    assert inputs.find('a', 1 * MS, 100 * MS) is None
    assert inputs.find('goals', 5 * MS, 100 * MS) == vector(5 * MS, 1.0, 0.0)


def test_of_messages_with_one_stamp_each_is_the_nearest():
    source = Listed([heard('/goals', 100 * k, 0, float(k)) for k in range(1, 6)])
    inputs = Inputs(source, {'goals': '/goals'})
    assert inputs.find('goals', 0, 310 * MS) == vector(0, 3.0, 0.0)
    assert inputs.find('goals', 0, 420 * MS) == vector(0, 4.0, 0.0)
    assert inputs.find('joy', 0, 420 * MS) is None


def test_a_change_is_the_last_that_the_node_had_reported_however_late_it_was_recorded():
    source = Listed([heard('/parameter_events', t, s) for t, s in ((100, 90), (290, 200))])
    inputs = Inputs(source, {'parameters': '/parameter_events'})
    assert inputs.find('parameters', 0, 201 * MS) == vector(200 * MS, 0.0, 0.0)
