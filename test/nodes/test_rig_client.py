"""How often a rig is asked, and what its answers mean; no time goes by here."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rclpy.task import Future

from microbot_ros.common.errors import InputError, RigError
from microbot_ros.control.controller_thread import AGAIN
from microbot_ros.nodes.client.rig_client import RefusedError, RigClient


class Service:
    """A service that answers from its `replies`, None for silence; it keeps what it was asked."""

    def __init__(self, *replies: Any, seen: bool = True) -> None:
        self.replies, self.asked, self.pending = [*replies], [], 0
        self.service_is_ready: Callable[[], bool] = lambda: seen

    def call_async(self, request: Any) -> Future:
        self.asked.append(request)
        self.pending += 1
        future = Future()
        if self.replies and (reply := self.replies.pop(0)) is not None:
            future.set_result(reply)
        return future

    def remove_pending_request(self, _: Future) -> None:
        self.pending -= 1


def client(name: str, service: Service) -> RigClient:
    """A client of that service alone."""
    node: Any = SimpleNamespace(get_namespace=lambda: '/',
                                get_node_names_and_namespaces=list)
    made = RigClient(node)
    made.services[name] = service  # type: ignore[assignment]
    return made


def performed(steps: Any) -> Any:
    """What it ends with where every wait lasts as long as it may."""
    try:
        true, _ = next(steps)
        while True:
            true, _ = steps.send(bool(true()))
    except StopIteration as end:
        return end.value


def said(message: str, success: bool = True) -> Any:
    """An answer as most services give it."""
    return SimpleNamespace(message=message, success=success)


def test_arming_is_asked_for_once_and_then_ended() -> None:
    service = Service(None, None, said('zero, confirmed by a reading'))
    with pytest.raises(RigError, match=r'^coil_driver did not answer within 12 s; disarmed: zero, '
                                       'confirmed by a reading$'):
        performed(client('coil_driver/arm', service).arm())
    assert [request.data for request in service.asked] == [True, False, False]
    assert service.pending == 0


def test_arming_that_is_given_up_is_ended() -> None:
    """As by Ctrl-C while the driver checks its coils."""
    service = Service(None)
    steps = client('coil_driver/arm', service).arm()
    next(steps)
    steps.send(True)
    assert [request.data for request in service.asked] == [True]
    steps.close()
    assert [request.data for request in service.asked] == [True, False]


def test_a_stop_is_repeated_and_says_that_the_driver_is_not_reachable() -> None:
    service = Service(seen=False)
    with pytest.raises(RigError, match=r'^not reachable: coil_driver did not answer within 3 s; '):
        performed(client('coil_driver/arm', service).stop(now=True))
    assert [request.data for request in service.asked] == 4 * [False]
    assert service.pending == 0


def test_a_zero_that_is_not_confirmed_is_refused_in_the_drivers_words() -> None:
    service = Service(said('zero sent, not confirmed', success=False))
    with pytest.raises(RefusedError) as refused:
        performed(client('coil_driver/arm', service).stop())
    assert refused.value.reason == 'zero sent, not confirmed'
    assert str(refused.value) == 'coil_driver: zero sent, not confirmed'


@pytest.mark.parametrize('now', [True, False])
def test_a_driver_that_is_not_seen_is_not_asked_to_arm(now: bool) -> None:
    service = Service(said('armed'), seen=False)
    with pytest.raises(RigError, match='coil_driver was not found in the namespace /'):
        performed(client('coil_driver/arm', service).arm(now))
    assert service.asked == []


@pytest.mark.parametrize(('begin', 'refusal', 'done'), [
    (True, 'already recording to run', 'recording to run'),
    (False, 'not recording', 'the recording has ended')])
def test_a_recorder_refuses_what_it_has_done_where_its_answer_was_lost(
        begin: bool, refusal: str, done: str) -> None:
    refused = said(refusal, success=False)
    lost = client('recorder/record', Service(None, refused))
    assert performed(lost.record(begin)) == done
    with pytest.raises(RefusedError, match=refusal):
        performed(client('recorder/record', Service(refused)).record(begin))


def test_parameters_are_set_again_while_they_are_taken_aside() -> None:
    def answer(reason: str) -> Any:
        return SimpleNamespace(results=[SimpleNamespace(successful=not reason, reason=reason)])
    name = 'controller/set_parameters'
    service = Service(answer(f'is being configured: {AGAIN}'), answer(''))
    performed(client(name, service).set('controller', controller='waypoint'))
    assert len(service.asked) == 2


@pytest.mark.parametrize(('parameter', 'told'), [
    ('controller', r'controller: no$'),
    ('controler', "controller: expected the name of a parameter, received 'controler'; known are: "
                  'controller, speed$')])
def test_a_refusal_is_the_nodes_unless_it_has_no_such_parameter(parameter: str, told: str) -> None:
    names = ['controller', 'speed']
    asked = client('controller/set_parameters', Service(SimpleNamespace(
        results=[SimpleNamespace(successful=False, reason='no')])))
    asked.services['controller/list_parameters'] = Service(  # type: ignore[assignment]
        SimpleNamespace(result=SimpleNamespace(names=names)))
    asked.services['controller/describe_parameters'] = Service(  # type: ignore[assignment]
        SimpleNamespace(descriptors=[SimpleNamespace(name=name) for name in names]))
    with pytest.raises(InputError, match=told):
        performed(asked.set('controller', **{parameter: 'steam'}))


def test_goals_wait_for_a_recorder_that_is_discovered_after_the_controller() -> None:
    seen, sent = ['controller'], []

    def ends(_: str) -> list[Any]:
        return [SimpleNamespace(node_name=name, node_namespace='/') for name in seen]

    def publisher(*_: Any) -> Any:
        return SimpleNamespace(get_subscription_count=lambda: len(seen),
                               publish=lambda _: sent.append(seen.copy()))
    node: Any = SimpleNamespace(
        get_namespace=lambda: '/', get_subscriptions_info_by_topic=ends,
        create_publisher=publisher, get_clock=lambda: SimpleNamespace(
            now=lambda: SimpleNamespace(to_msg=lambda: Time(sec=5))))
    rig = RigClient(node)
    steps = rig.send_goals([(1e-6, 2e-6)])
    true, _ = next(steps)
    assert true()
    true, _ = steps.send(True)
    assert not true()
    seen.append('recorder')
    assert true()
    true, _ = steps.send(True)
    assert true()
    assert sent == []
    steps.send(True)
    assert sent == [['controller', 'recorder']]
