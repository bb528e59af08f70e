"""What the page asks of a rig, by an object that has no graph: no time goes by here."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from rcl_interfaces.msg import Parameter, ParameterEvent

from microbot_ros.cockpit.rig import RefusedError
from microbot_ros.common.errors import RigError
from microbot_ros.nodes.client.operated_rig import OperatedRig
from microbot_ros.nodes.client.rig_client import Taken


class Client:
    """A controller and a tracker that answer at once, from what they have."""

    def __init__(self) -> None:
        self.goals: dict[int, tuple[float, float]] = {}
        self.calibration = {'pixel_size_um': 0.5, 'rotation_deg': 0.0, 'mirrored': False}
        self.silent = False

    def send_goals(self, positions: Any, particles: Any) -> Any:
        yield (lambda: False), 0.02
        self.goals = dict(zip(particles, positions, strict=True))
        return Taken(1.0, 'ensemble')

    def describe(self, node: str) -> Any:
        yield from ()
        return []

    def get(self, node: str, *names: str) -> Any:
        yield from ()
        if self.silent:
            raise RigError(f'{node} did not answer')
        return {name: self.calibration[name] for name in names}


class Rig(OperatedRig):
    """A rig of that client."""

    def __init__(self) -> None:
        publisher = SimpleNamespace(get_subscription_count=lambda: 1)
        super().__init__(SimpleNamespace(  # type: ignore[arg-type]
            get_namespace=lambda: '/', subscribe=lambda *_, **__: None,
            client=lambda *_: None, publisher=lambda *_: publisher))
        self._client: Any = Client()
        self._size = (640, 480)

    def goals(self) -> list[dict[str, Any]]:
        return [{'id': name, 'x_um': 1e6 * x, 'y_um': 1e6 * y}
                for name, (x, y) in self._client.goals.items()]

    def progress(self, node: str) -> Any:
        return {'controller': 'ensemble'}

    @property
    def armed(self) -> bool:
        return True


def test_two_goals_at_once_are_both_there() -> None:
    rig = Rig()

    async def both() -> None:
        await asyncio.gather(rig.goal(10.0, 0.0, 1), rig.goal(20.0, 5.0, 2))
    asyncio.run(both())
    assert set(rig._client.goals) == {1, 2}


def test_a_tracker_that_starts_anew_is_asked_for_its_calibration() -> None:
    rig = Rig()
    asyncio.run(rig._catch_up())
    assert rig.camera()['to_um'][0][0] == 0.5
    rig._client.calibration['pixel_size_um'] = 0.25
    rig._on_changes(ParameterEvent(node='/tracker', new_parameters=[Parameter()]))
    asyncio.run(rig._catch_up())
    assert rig.camera()['to_um'][0][0] == 0.25


def test_parameters_that_were_not_told_are_asked_for_again() -> None:
    rig = Rig()
    asyncio.run(rig._catch_up())
    rig._on_changes(ParameterEvent(node='/controller'))
    rig._client.silent = True
    with pytest.raises(RefusedError):
        asyncio.run(rig._catch_up())
    assert rig._outdated
