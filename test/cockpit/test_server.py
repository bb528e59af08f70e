"""What pages are told and may have done: one has control, anyone may stop, nothing is repeated."""

from __future__ import annotations

import contextlib
import json
import math
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.cockpit import verbs
from microbot_ros.cockpit.stopping import EVERY_S

ORDERS: dict[str, dict[str, Any]] = {
    'arm': {'attended': False}, 'disarm': {}, 'goal': {'x_um': 1.0, 'y_um': -2, 'particle': 3},
    'clear_goals': {}, 'path': {'points_um': [[0, 0], [1.5, -2]]},
    'switch_controller': {'name': 'waypoint'}, 'set': {'name': 'delay_ms', 'value': 20},
    'teach': {'x_px': 1.25, 'y_px': 2, 'stamp': '17', 'example': 'like', 'particle_kind': None},
    'record': {'on': True, 'title': 'batch 7'}, 'note': {'text': '5 % peroxide'},
}
"""Every verb that is performed by the rig and needs control, as a page sends it."""


def test_a_verb_is_performed_and_answered_with_the_nodes_own_words(served: Any) -> None:
    expected = {
        'arm': ('arm', ()), 'goal': ('goal', (1.0, -2.0, 3)),
        'clear_goals': ('clear_goals', ()), 'path': ('path', ([(0.0, 0.0), (1.5, -2.0)],)),
        'switch_controller': ('switch_controller', ('waypoint',)),
        'set': ('set', ('delay_ms', 20)), 'teach': ('teach', (True, 1.25, 2.0, None, 17)),
        'record': ('record', (True, 'batch 7')), 'note': ('note', ('5 % peroxide',))}
    with served.page() as page:
        for verb, (done, arguments) in expected.items():
            what = ORDERS[verb]
            answer = page.ask(verb, **what)
            assert (answer['ok'], answer['reason']) == (True, f'{done} done'), verb
            assert served.rig.calls[-1][1:] == (done, arguments)
            served.rig.refusals[done] = f'no {done} today: the node says so'
            answer = page.ask(verb, **what)
            assert (answer['ok'], answer['reason']) == (False, served.rig.refusals[done]), verb


def test_only_one_page_has_control_and_anyone_may_stop(served: Any) -> None:
    with served.page() as first, served.page() as second:
        for verb, what in ORDERS.items():
            answer = second.ask(verb, **what)
            assert (answer['ok'], answer['reason']) == (False, 'another page has control')
        second.say('stick', x=1.0, y=0.0)
        assert second.ask('discover', on=True, minutes=5)['ok'] is False
        assert served.rig.calls == []
        assert second.ask('stop')['ok']
        assert served.rig.asked('stop') == [()]
        assert first.ask('goal', x_um=0, y_um=0)['ok']


def test_taking_control_makes_the_other_a_viewer_at_once(served: Any) -> None:
    with served.page() as first, served.page() as second:
        first.becomes('control', {'mine': True, 'holder': 1, 'pages': 2})
        second.becomes('control', {'mine': False, 'holder': 1, 'pages': 2})
        assert second.ask('take_control')['ok']
        first.say('stick', x=1.0, y=0.0)
        assert first.ask('goal', x_um=0, y_um=0)['ok'] is False
        assert second.ask('goal', x_um=0, y_um=0)['ok']
        assert served.rig.asked('stick') == []
        first.becomes('control', {'mine': False, 'holder': 2, 'pages': 2})


def test_control_of_a_page_that_goes_is_nobodys_until_it_is_taken(served: Any) -> None:
    with served.page() as viewer_to_be:
        with served.page() as other:
            assert other.ask('take_control')['ok']
        viewer_to_be.becomes('control', {'mine': False, 'holder': None, 'pages': 1})
        assert viewer_to_be.ask('goal', x_um=0, y_um=0)['ok'] is False
        with served.page() as new:
            assert new.ask('goal', x_um=0, y_um=0)['ok']


@pytest.mark.rig
def test_a_stick_is_told_once_for_each_message_and_never_again(served: Any) -> None:
    with served.page() as page:
        page.say('stick', x=0.5, y=-1.0)
        page.say('stick', x=1, y=0)
        page.ask('stop')
        page.drain(0.5)
        assert served.rig.asked('stick') == [(0.5, -1.0), (1.0, 0.0)]


def test_a_stick_that_was_silent_must_come_back_to_neutral(served: Any) -> None:
    with served.page() as page:
        page.say('stick', x=0.5, y=0.0)
        page.ask('stop')
        served.now_s += 0.6
        page.say('stick', x=0.6, y=0.0)
        page.say('stick', x=0.0, y=0.0)
        page.say('stick', x=0.7, y=0.0)
        page.ask('stop')
    assert served.rig.asked('stick') == [(0.5, 0.0), (0.0, 0.0), (0.7, 0.0)]


@pytest.mark.rig
def test_what_waited_while_the_server_stood_still_is_not_done_but_stop(serve: Any) -> None:
    served = serve(clock=time.monotonic)
    with served.page() as page:
        page.ask('clear_goals')
        served.server._loop.call_soon_threadsafe(time.sleep, 1.2)
        time.sleep(0.1)
        page.say('stick', x=1.0, y=0.0)
        page.say('goal', id=101, x_um=0, y_um=0)
        page.say('arm', id=102, attended=False)
        page.say('stop', id=103)
        assert page.answer(103)['ok']
        assert [one['to'] for one in page.told
                if one.get('kind') == 'answer' and 'was blocked' in one['reason']] == [101, 102]
        page.drain(0.7)
        assert page.ask('goal', x_um=1, y_um=0)['ok']
    assert served.rig.asked('stick') == served.rig.asked('arm') == []
    assert len(served.rig.asked('goal')) == 1


@pytest.mark.rig
def test_what_a_page_sent_before_it_was_killed_is_not_repeated(served: Any) -> None:
    with served.page() as page:
        page.say('stick', x=1.0, y=0.0)
        page.ask('clear_goals')
        page.socket.socket.close()
    time.sleep(0.3)
    assert served.rig.asked('stick') == [(1.0, 0.0)]


class TestNumbers:
    """Nothing that is no number, or no rig has, gets as far as the rig."""

    numbers = ('NaN', 'Infinity', '-Infinity', '1e999', '-1e999', '1e300', '"1"', 'null', 'true',
               '[1]', '1e18', '')

    @pytest.mark.parametrize('number', numbers)
    def test_in_every_place_for_a_number(self, served: Any, number: str) -> None:
        places = [('goal', 'x_um'), ('goal', 'y_um'), ('path', 'points_um'), ('teach', 'x_px'),
                  ('teach', 'y_px'), ('stick', 'x'), ('stick', 'y'), ('discover', 'minutes'),
                  ('set', 'value'), ('goal', 'particle')]
        allowed = {('goal', 'particle'): ('null',),
                   ('set', 'value'): ('"1"', 'true', '[1]', '1e300', '1e18')}
        with served.page() as page:
            for verb, name in places:
                if number in allowed.get((verb, name), ()):
                    continue
                what = {**ORDERS.get(verb, {}), **({'x': 0, 'y': 0} if verb == 'stick' else {}),
                        **({'on': True} if verb == 'discover' else {}), name: '@'}
                here = f'[[0, 0], [{number}, 1]]' if name == 'points_um' else number
                text = json.dumps({'verb': verb, 'id': 7, **what}).replace('"@"', here)
                page.socket.send(text)
                answer = page.until(lambda message: message['kind'] == 'answer')
                assert answer['ok'] is False, text
                assert answer['reason']
            assert served.rig.calls == []

    @pytest.mark.parametrize(('x', 'sent'), [
        (1.0, True), (-1.0, True), (0, True), (1.0000001, False), (-1.0000001, False)])
    def test_a_stick_ends_at_one(self, served: Any, x: float, sent: bool) -> None:
        with served.page() as page:
            page.say('stick', x=x, y=0)
            page.ask('stop')
            assert served.rig.asked('stick') == ([(float(x), 0.0)] if sent else [])

    @pytest.mark.parametrize(('x_um', 'taken'), [
        (1e7, True), (-1e7, True), (1.0000001e7, False), (-1.0000001e7, False)])
    def test_a_goal_is_within_what_a_rig_can_have(
            self, served: Any, x_um: float, taken: bool) -> None:
        with served.page() as page:
            assert page.ask('goal', x_um=x_um, y_um=0)['ok'] is taken

    def test_lists_and_texts_end_somewhere(self, served: Any) -> None:
        with served.page() as page:
            assert page.ask('path', points_um=[[0, 0]] * 2000)['ok']
            for verb, what in (
                    ('path', {'points_um': [[0, 0]] * 2001}), ('path', {'points_um': [[0, 0]]}),
                    ('path', {'points_um': [[0, 0, 0], [1, 1, 1]]}),
                    ('note', {'text': 'x' * 2001}), ('note', {'text': ''}),
                    ('set', {'name': 'a', 'value': [0] * 1001}),
                    ('set', {'name': 'a b', 'value': 0}), ('set', {'name': '', 'value': 0}),
                    ('teach', {**ORDERS['teach'], 'particle_kind': 'a,b'}),
                    ('teach', {**ORDERS['teach'], 'particle_kind': 'a@5'}),
                    ('teach', {**ORDERS['teach'], 'stamp': '-1'}),
                    ('teach', {**ORDERS['teach'], 'example': 'forget'}),
                    ('switch_controller', {'name': 'a\nb'}), ('record', {'on': 1}),
                    ('arm', {}), ('arm', {'attended': 'false'}),
                    ('arm', {'attended': False, 'force': True}), ('goal', {'x_um': 0})):
                before = len(served.rig.calls)
                assert page.ask(verb, **what)['ok'] is False, (verb, what)
                assert len(served.rig.calls) == before

    def test_line_breaks_do_not_pass_into_what_is_noted(self, served: Any) -> None:
        with served.page() as page:
            assert page.ask('note', text='a\nb\x1b[2J')['ok']
        assert served.rig.asked('note') == [('a\\nb\\x1b[2J',)]


@given(st.text(max_size=200) | st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
        st.sampled_from(['verb', 'id', 'x', 'y', 'name', 'value', 'stop', 'x_um']), inner,
        max_size=4), max_leaves=8).map(json.dumps))
def test_whatever_a_page_sends_is_a_verb_or_one_sentence(text: str) -> None:
    try:
        said = verbs.read_verb(text).verb
    except verbs.VerbError as error:
        said = str(error)
    assert said
    assert said.isprintable()
    assert len(said) < 600


def test_what_is_no_text_ends_the_page_and_no_other(served: Any) -> None:
    with served.page() as good:
        with served.page() as bad:
            bad.socket.send(b'\0\1')
            with pytest.raises(Exception):  # noqa: B017, PT011 - closed, in one way or another
                bad.until(lambda _: False)
        with served.page() as long:
            long.socket.send('x' * 200_000)
            with pytest.raises(Exception):  # noqa: B017, PT011
                long.until(lambda _: False)
        assert good.ask('clear_goals')['ok']


@pytest.mark.rig
def test_stop_waits_behind_nothing(served: Any) -> None:
    served.rig.slow_s = {'arm': 5.0, 'goal': 5.0}
    with served.page() as page:
        page.say('arm', id=1000, attended=False)
        for k in range(20):
            page.say('goal', id=2000 + k, x_um=0, y_um=0)
        begin = time.monotonic()
        assert page.ask('stop')['ok']
        assert time.monotonic() - begin < 1.0
        assert len(served.rig.asked('goal')) == 7, 'eight verbs at most are in work'


@pytest.mark.rig
class TestPictures:
    """Two are owed, and the newest replaces what waits."""

    def test_two_and_then_the_newest(self, served: Any) -> None:
        with served.page() as page:
            for stamp in range(1, 11):
                served.rig.picture(stamp, b'jpeg')
                page.drain(0.03)
            assert page.pictures == [1, 2]
            page.say('seen', stamp='1')
            page.drain(0.2)
            assert page.pictures == [1, 2, 10]
            page.say('seen', stamp='10')
            served.rig.picture(11, b'jpeg')
            served.rig.picture(12, b'jpeg')
            page.drain(0.2)
            assert page.pictures[3:] in ([11, 12], [12])

    def test_who_has_seen_what_it_was_not_sent_gets_no_more(self, served: Any) -> None:
        with served.page() as page:
            for stamp in range(1, 6):
                served.rig.picture(stamp, b'jpeg')
                page.say('seen', stamp='999')
                page.drain(0.03)
            assert page.pictures == [1, 2]

    def test_particles_follow_their_picture_and_wait_with_it(self, served: Any) -> None:
        with served.page() as page:
            for stamp in (1, 2, 3):
                served.rig.picture(stamp, b'jpeg')
                served.rig.particles({'kind': 'particles', 'stamp': str(stamp), 'particles': []})
                page.drain(0.05)
            page.say('seen', stamp='2')
            page.drain(0.2)
            told = [one['stamp'] for one in page.told if one['kind'] == 'particles']
            assert page.pictures == [1, 2, 3]
            assert told == ['1', '2', '3']

    def test_a_page_that_reads_nothing_holds_nobody_up_and_is_shown_no_past(
            self, served: Any) -> None:
        picture = b'x' * 50_000
        with served.page() as frozen, served.page() as other:
            begin = time.monotonic()
            for stamp in range(1, 200):
                served.rig.picture(stamp, picture)
                served.rig.particles({'kind': 'particles', 'stamp': str(stamp), 'particles': []})
                other.say('seen', stamp=str(other.pictures[-1] if other.pictures else 0))
                other.drain(0.005)
            assert len(other.pictures) > 50
            other.drain(max(0.0, 2.5 - (time.monotonic() - begin)))
            frozen.drain(0.5)
            states = [one for one in frozen.told if one['kind'] == 'state']
            assert len(frozen.pictures) == 2
            assert len(states) <= 10, 'one a second while it owes, and a few before it did'


_STALE = ('disarmed, stale command (command_timeout_ms): none for 0.081 s; zero, confirmed by a '
          'reading')


class TestEvents:
    """Who did what, and what the nodes said."""

    def _events(self, page: Any, text: str) -> dict[str, Any]:
        told = page.until(lambda message: message['kind'] == 'events' and any(
            text in one['text'] for one in message['events']))
        return next(one for one in told['events'] if text in one['text'])

    def test_what_a_page_asks_is_an_event_of_every_page(self, served: Any) -> None:
        with served.page() as page, served.page() as other:
            page.say('set', id=1, name='waypoint.field_mT', value=5.0)
            event = self._events(other, 'Set waypoint.field_mT to 5.0')
            assert (event['origin'], event['level']) == ('page 1', 'ok')
            other.say('stop', id=1)
            event = self._events(page, 'STOP: zero, confirmed by a reading')
            assert event['origin'] == 'page 2'
            other.say('take_control', id=2)
            assert self._events(page, 'Took control')['origin'] == 'page 2'
            served.rig.refusals['arm'] = 'no measured currents for 0.2 s'
            other.say('arm', id=3, attended=True)
            event = self._events(page, 'Arm, attended: no measured currents')
            assert event['level'] == 'refused'
            assert 'amplifier' in event['cure']

    def test_a_fault_is_one_with_cause_and_cure_and_a_new_page_is_told_of_it(
            self, served: Any) -> None:
        served.rig.parts = {**served.rig.parts, 'rig': 'armed'}
        with served.page() as page:
            page.becomes('rig', 'armed')
            served.rig.parts = {**served.rig.parts, 'rig': 'fault', 'sentence': _STALE}
            event = self._events(page, 'stale command')
            assert (event['origin'], event['level']) == ('coil_driver', 'error')
            assert event['cause']
            assert 'Then arm again' in event['cure']
        with served.page() as later:
            assert self._events(later, 'stale command') == event

    def test_what_a_node_says_is_wrong_begins_and_ends(self, served: Any) -> None:
        def health(level: str, sentence: str) -> None:
            served.rig.parts = {**served.rig.parts, 'health': [
                {'name': 'tracker', 'level': level, 'sentence': sentence}]}

        with served.page() as page:
            health('warn', 'no particles for 4 s')
            event = self._events(page, 'no particles')
            assert (event['origin'], event['level']) == ('tracker', 'warning')
            assert event['cure'] == 'Look at the overlay.'
            health('ok', '3 particles')
            assert self._events(page, 'Well again: 3 particles')['level'] == 'ok'


class TestHistory:
    """The last minute of the estimates, for a page that comes later."""

    def test_a_page_that_is_reloaded_has_the_curves(self, served: Any) -> None:
        served.rig.parts = {**served.rig.parts, 'estimates': [{
            'id': 3, 'v_um_s': 4.1, 'v_std_um_s': 0.1, 'phi_deg': 24.0, 'phi_std_deg': 1.0}]}
        with served.page() as page:
            page.drain(1.0)
        with served.page() as again:
            told = again.until(lambda message: message['kind'] == 'history')
        rows = told['curves']['3']
        assert len(rows) >= 3
        assert rows[0][1:] == [4.1, 0.1, 24.0, 1.0]
        assert -30 < rows[0][0] < rows[-1][0] <= 0


class TestState:
    """Parts that are new, ten times a second."""

    def test_parts_are_told_when_they_change(self, served: Any) -> None:
        with served.page() as page:
            first = page.until(lambda message: message['kind'] == 'state')
            assert {'rig', 'sentence', 'attended', 'discovery', 'control'} <= set(first)
            assert set(page.until(lambda message: message['kind'] == 'state')) == {'kind'}
            served.rig.parts = {**served.rig.parts, 'rig': 'fault', 'sentence': _STALE}
            changed = page.until(lambda message: message['kind'] == 'state' and len(message) > 1)
            assert set(changed) == {'kind', 'rig', 'sentence', 'why'}
            assert 'command_timeout_ms' in changed['why']['cause']
            assert 'arm again' in changed['why']['cure']

    def test_a_new_page_is_told_all(self, served: Any) -> None:
        with served.page() as page:
            page.becomes('rig', 'disarmed')
        with served.page() as again:
            again.becomes('rig', 'disarmed')

    def test_nobody_looks_where_no_page_is(self, served: Any) -> None:
        assert not served.rig.looking
        with served.page() as page:
            page.ask('clear_goals')
            assert served.rig.looking
        deadline = time.monotonic() + 30.0
        while served.rig.looking:
            assert time.monotonic() < deadline
            time.sleep(0.01)


class TestAttended:
    """Armed on condition that somebody is there: heartbeats for the driver, which judges."""

    def test_heartbeats_of_the_page_in_control_go_to_the_driver(self, served: Any) -> None:
        with contextlib.ExitStack() as pages:
            page = pages.enter_context(served.page())
            page.until(lambda message: message['kind'] == 'state')  # and so in control
            viewer = pages.enter_context(served.page())
            page.say('heartbeat')
            assert page.ask('arm', attended=True)['ok']
            assert [name for _, name, _ in served.rig.calls] == ['attend', 'arm']
            for _ in range(3):
                viewer.say('heartbeat')
                page.say('heartbeat')
            page.ask('clear_goals')
            assert viewer.ask('stop')['ok']
            assert len(served.rig.asked('attend')) == 4
            page.say('heartbeat')
            page.ask('clear_goals')
            assert len(served.rig.asked('attend')) == 4, 'after a STOP nobody attends'

    @pytest.mark.parametrize(('attended', 'refusals'), [
        (False, {}), (True, {'arm': 'a coil is open'}), (True, {'stop': 'not reachable'})])
    def test_unattended_refused_or_stopped_attends_nothing(
            self, served: Any, attended: bool, refusals: dict[str, str]) -> None:
        served.rig.refusals = refusals
        with served.page() as page:
            page.ask('arm', attended=attended)
            if 'stop' in refusals:
                assert not page.ask('stop')['ok']
            before = len(served.rig.asked('attend'))
            page.say('heartbeat')
            page.ask('clear_goals')
            assert len(served.rig.asked('attend')) == before
            page.becomes('attended', False)

    def test_a_rig_that_trips_is_attended_no_more(self, served: Any) -> None:
        with served.page() as page:
            assert page.ask('arm', attended=True)['ok']
            served.rig.parts = {**served.rig.parts, 'rig': 'armed'}
            page.becomes('rig', 'armed')
            page.becomes('attended', True)
            served.rig.parts = {**served.rig.parts, 'rig': 'fault'}
            page.becomes('attended', False)


class TestStop:
    """Its answer says which of three holds; no cap of the server holds it back."""

    @pytest.mark.parametrize(('said', 'refused', 'zero'), [
        ('zero, confirmed by a reading', False, 'confirmed'),
        ('zero sent, not confirmed: the amplifier measures no currents', False, 'sent'),
        ('zero sent, not confirmed', True, 'sent'),
        ('not reachable: /dev/ttyUSB0; these coils may carry current', True, 'unreachable'),
        ('current is commanded', True, None)])
    @pytest.mark.parametrize('verb', ['stop', 'disarm'])
    def test_the_answer_tells_which_of_three_holds(
            self, served: Any, verb: str, said: str, refused: bool, zero: str | None) -> None:
        served.rig.says['stop'] = said
        served.rig.refusals = {'stop': said} if refused else {}
        with served.page() as page:
            answer = page.ask(verb)
        assert (answer['ok'], answer['reason'], answer['zero']) == (not refused, said, zero)

    @pytest.mark.rig
    def test_every_one_is_sent_though_others_wait_for_their_answers(self, served: Any) -> None:
        served.rig.slow_s = {'stop': 30.0}
        with served.page() as page:
            for k in range(40):
                page.say('stop', id=1000 + k)
            page.ask('clear_goals')
            before = len(served.rig.asked('stop'))
            assert before >= 1
            page.say('stop', id=2000)
            answer = page.answer(2000)
            assert (answer['ok'], 'sent' in answer['reason']) == (False, True)
            page.drain(2.5 * EVERY_S)
            assert before < len(served.rig.asked('stop')) < 10

    @pytest.mark.rig
    def test_a_page_that_floods_delays_no_other(self, served: Any) -> None:
        with served.page() as flood, served.page() as page:
            for k in range(2000):
                flood.say('stop', id=1000 + k)
            begin = time.monotonic()
            assert page.ask('stop')['ok']
            assert time.monotonic() - begin < 2.0
            spent = time.monotonic() - begin
            assert len(served.rig.asked('stop')) <= 3 + spent / EVERY_S


@pytest.mark.parametrize('attended', [False, True])
def test_the_end_of_the_server_asks_the_rig_for_nothing_but_what_it_watches_over(
        serve: Any, attended: bool) -> None:
    served = serve()
    with served.page() as page:
        assert page.ask('arm', attended=attended)['ok']
        served.server.stop()
    assert [name for _, name, _ in served.rig.calls if name != 'attend'] == [
        'arm', 'stop'][:1 + attended]


def test_a_number_that_is_none_leaves_the_rest_of_the_state(served: Any) -> None:
    with served.page() as page:
        served.rig.parts |= {'latency_ms': math.nan, 'field': {'wanted_mT': [math.inf, 0.0]}}
        page.until(lambda message: 'latency_ms' in message)
        assert (page.known['latency_ms'], page.known['field']) == (None, None)
        assert page.known['rig'] == 'disarmed'


@pytest.mark.rig
def test_what_fails_in_the_rig_is_tried_again(served: Any) -> None:
    with served.page() as page:
        page.becomes('rig', 'disarmed')
        good, served.rig.parts = served.rig.parts, 7  # no state at all
        page.drain(0.3)
        served.rig.parts = {**good, 'rig': 'armed'}
        page.becomes('rig', 'armed')
