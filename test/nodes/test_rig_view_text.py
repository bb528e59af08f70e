"""Texts of topics in the cockpit are read strictly: a wrong one is reported, never acted on."""

from __future__ import annotations

from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Bool, String

from microbot_ros.nodes.base import messages
from microbot_ros.nodes.client.rig_view import RigView


class Node:
    """Stands in for the cockpit's node."""

    def subscribe(self, *_: Any) -> None:
        pass

    def get_namespace(self) -> str:
        return '/'

    def get_name(self) -> str:
        return 'cockpit'


@pytest.mark.parametrize('text', [
    'a: &a [x, x, x, x, x, x, x, x, x]\n' + ''.join(
        f'{name}: &{name} [{", ".join(9 * [f"*{before}"])}]\n'
        for before, name in zip('abcdefgh', 'bcdefghi', strict=True)),
    'hold: a\nhold: b\n', '[1, 2]', 'hold: !!python/object/apply:os.getpid []', '{' * 5000])
def test_controllers_that_are_no_plain_yaml_are_refused(text: str) -> None:
    view = RigView(Node())  # type: ignore[arg-type]
    with pytest.raises(messages.MessageError, match='controller/controllers'):
        view._on_controllers(String(data=text))
    assert view._available == []


@pytest.mark.parametrize('text', ['{', '[1]', '{"a": 1}', '[' * 100_000])
def test_kinds_that_are_no_names_are_refused(text: str) -> None:
    view = RigView(Node())  # type: ignore[arg-type]
    with pytest.raises(messages.MessageError, match='tracker/kinds'):
        view._on_kinds(String(data=text))
    assert view.kinds == []


def _report(view: RigView, name: str, level: bytes, text: str, **values: str) -> None:
    view._on_diagnostics(DiagnosticArray(status=[DiagnosticStatus(
        name=f'{name}: state', level=level, message=text,
        values=[KeyValue(key=key, value=value) for key, value in values.items()])]))


def test_reason_and_detail_of_a_fault_are_fields_of_the_state() -> None:
    view = RigView(Node())  # type: ignore[arg-type]
    _report(view, 'coil_driver', b'\2', 'disarmed, coil heat: a; zero, confirmed by a reading',
            armed='False', fault_reason='coil heat', fault_detail='a: b; c',
            zero='zero, confirmed by a reading')
    state = view.state()
    assert (state['rig'], state['zero']) == ('fault', 'confirmed')
    assert state['fault'] == {'reason': 'coil heat', 'detail': 'a: b; c'}
    _report(view, 'coil_driver', b'\2', 'amplifier lost at /dev/x, reconnecting; not reachable')
    assert view.state()['fault'] is None
    _report(view, 'coil_driver', b'\0', 'disarmed; zero, confirmed by a reading')
    assert view.state()['fault'] is None


def test_the_frame_rate_comes_from_two_reports_of_the_camera(
        monkeypatch: pytest.MonkeyPatch) -> None:
    view, now = RigView(Node()), [100.0]  # type: ignore[arg-type]
    monkeypatch.setattr('time.monotonic', lambda: now[0])
    _report(view, 'camera', b'\0', 'publishing', frames_published='50', exposure_ms='2.5')
    assert view.state()['frames'] is None
    now[0] += 2.0
    _report(view, 'camera', b'\0', 'publishing', frames_published='170', exposure_ms='2.5')
    assert view.state()['frames'] == {'rate_hz': 60.0, 'exposure_ms': 2.5}
    now[0] += 4.0
    assert view.state()['frames'] is None


def test_a_zero_from_before_the_rig_was_armed_is_none_of_now() -> None:
    view, zero = RigView(Node()), 'zero, confirmed by a reading'  # type: ignore[arg-type]
    _report(view, 'coil_driver', b'\0', f'disarmed; {zero}', armed='False', zero=zero)
    assert view.state()['zero'] == 'confirmed'
    for armed in (True, False):
        view._on_armed(Bool(data=armed))
    assert (view.state()['rig'], view.state()['zero']) == ('disarmed', None)
    _report(view, 'coil_driver', b'\0', f'disarmed; {zero}', armed='False', zero=zero)
    assert view.state()['zero'] == 'confirmed'
