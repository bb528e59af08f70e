"""Texts of topics in the cockpit are read strictly: a wrong one is reported, never acted on."""

from __future__ import annotations

from typing import Any

import pytest
from std_msgs.msg import String

from microbot_ros.nodes.base import messages
from microbot_ros.nodes.client.rig_view import RigView


class Node:
    """Stands in for the cockpit's node."""

    def subscribe(self, *_: Any) -> None:
        pass


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
