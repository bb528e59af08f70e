"""A rig as the cockpit's pages operate it: its state, and its commands."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from datetime import datetime
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseArray
from nav_msgs.msg import Path
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from sensor_msgs.msg import Joy, PointCloud2
from std_msgs.msg import Empty, Header
from std_srvs.srv import SetBool

from microbot_ros.cockpit.rig import Answer, RefusedError
from microbot_ros.common.errors import InputError, RigError
from microbot_ros.common.patience import PATIENCE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import LATCHED, NEWEST, RigNode
from microbot_ros.nodes.base.topics import CHANGES
from microbot_ros.nodes.client import rig_client
from microbot_ros.nodes.client.described_parameters import Described
from microbot_ros.nodes.client.rig_client import RigClient, Steps, Taken
from microbot_ros.nodes.client.rig_view import RigView

_SERVICES: dict[str, type] = {
    'coil_driver/arm': SetBool, 'recorder/record': SetBool,
    'controller/list_parameters': ListParameters,
    'controller/describe_parameters': DescribeParameters,
    **{f'{node}/get_parameters': GetParameters for node in ('controller', 'tracker', 'recorder')},
    **{f'{node}/set_parameters': SetParameters for node in ('controller', 'recorder', 'tracker')}}
_LOOK_S, _LOOK_AROUND_S = 0.01, 1.0
"""Intervals [s] of checks for an answer, and for nodes that are not known yet. Choice: the first
is not felt by a person, the second is that of diagnostics."""
_CALIBRATION = ('pixel_size_um', 'rotation_deg', 'mirrored')

T = TypeVar('T')


class OperatedRig(RigView):
    """State of a rig and commands of its pages; the `Rig` of the server.

    All clients are made at the start, so that they are connected when they are needed. Coroutines
    run in the server's thread, callbacks of ROS in the executor's.

    Parameters
    ----------
    node : RigNode
        Node of the cockpit.
    """

    def __init__(self, node: RigNode) -> None:
        self._client = RigClient(node)
        super().__init__(node)
        self._client.services |= {name: node.client(kind, name)
                                  for name, kind in _SERVICES.items()}
        self._client.publishers |= {
            'goals': node.publisher(PoseArray, 'goals'),
            'particle_goals': node.publisher(PointCloud2, 'particle_goals'),
            'path': node.publisher(Path, 'path'),
            'tracker/like': node.publisher(PointStamped, 'tracker/like'),
            'tracker/unlike': node.publisher(PointStamped, 'tracker/unlike')}
        node.subscribe(DiagnosticStatus, 'tracker/taught', self._hear_taught, LATCHED)
        self._heartbeat = node.publisher(Empty, 'coil_driver/heartbeat')
        self._joy = node.publisher(Joy, 'joy', NEWEST)
        node.subscribe(ParameterEvent, CHANGES, self._on_changes)
        self._described: Described | None = None
        self._outdated = False
        self._handing_over, self._noting = asyncio.Lock(), asyncio.Lock()
        self._adding = asyncio.Lock()

    def _on_progress(self, message: DiagnosticStatus) -> None:
        super()._on_progress(message)
        self._client.hear({pair.key: pair.value for pair in message.values})

    def _on_changes(self, event: ParameterEvent) -> None:
        """Note changed parameters, and a new tracker; called in the executor's thread."""
        place = self._node.get_namespace().rstrip('/')
        if event.node == f'{place}/controller':
            self._outdated = True
        elif event.node == f'{place}/tracker' and event.new_parameters:
            self._camera = None  # it has started, perhaps with another calibration

    async def _perform(self, steps: Steps[T]) -> T:
        """Serve the event loop while the steps of a request wait; return their result."""
        try:
            true, seconds = next(steps)
            while True:
                deadline = time.monotonic() + seconds
                while not (came := bool(true())) and time.monotonic() < deadline:
                    await asyncio.sleep(_LOOK_S)
                true, seconds = steps.send(came)
        except StopIteration as end:
            answer: T = end.value
            return answer
        except rig_client.RefusedError as refused:
            raise RefusedError(refused.reason) from None
        except InputError as refused:
            raise RefusedError(refused.expected) from None
        except RigError as error:
            raise RefusedError(str(error)) from None
        finally:
            steps.close()

    # What the server asks -------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        controller = self.controller()
        if controller is not None and self._described is not None:
            controller['parameters'] = self._described.of(controller['name'])
        return {**super().state(), 'controller': controller}

    async def keep_up(self) -> None:
        while True:
            with suppress(RefusedError):
                await self._catch_up()
            await asyncio.sleep(rig_client.REPEAT_S if self._described else _LOOK_AROUND_S)

    async def _catch_up(self) -> None:
        if not self.progress('controller'):
            self._described = None  # gone; another may come
        elif self._described is None or self._outdated:
            self._outdated = False
            try:
                known = self._described or Described(
                    await self._perform(self._client.describe('controller')))
                values = await self._perform(self._client.get('controller', *known.names))
            except RefusedError:
                self._outdated = True
                raise
            self._described = known.with_values([*values.values()])
        if not self.calibrated:
            self.use_calibration(
                await self._perform(self._client.get('tracker', *_CALIBRATION)))

    async def stop(self) -> Answer:
        # Without checking first whether the driver is present.
        return await self._perform(self._client.stop(now=True))

    async def arm(self) -> Answer:
        # A driver that is not present is refused at once: otherwise STOP could come before it
        # was found.
        return await self._perform(self._client.arm(now=True))

    def attend(self) -> None:
        self._heartbeat.publish(Empty())

    def stick(self, x: float, y: float) -> None:
        now = self._node.get_clock().now().to_msg()
        self._joy.publish(Joy(header=Header(stamp=now, frame_id=messages.WORKSPACE), axes=[x, y]))

    async def goal(self, x_um: float, y_um: float, particle: int | None) -> Answer:
        async with self._adding:  # the goals of a request before must be among the present ones
            if self._taken_path:
                await self._hand_over(self._client.send_path([]))
            if particle is None:
                return await self._send_there(self._client.send_goals([_metres(x_um, y_um)]))
            goals = {goal['id']: _metres(goal['x_um'], goal['y_um'])
                     for goal in self.goals() if goal['id'] is not None}
            goals[particle] = _metres(x_um, y_um)
            return await self._send_there(self._client.send_goals([*goals.values()], [*goals]))

    async def clear_goals(self) -> Answer:
        await self._hand_over(self._client.send_path([]))
        return await self._hand_over(self._client.send_goals([]))

    async def path(self, points_um: list[tuple[float, float]]) -> Answer:
        if self.goals():
            await self._hand_over(self._client.send_goals([]))
        return await self._send_there(
            self._client.send_path([_metres(x, y) for x, y in points_um]))

    async def _hand_over(self, steps: Steps[Taken]) -> Answer:
        """Send one input after the other: the controller reports only the last one."""
        async with self._handing_over:
            return f'{(await self._perform(steps)).controller.replace("_", " ")} has it'

    async def _send_there(self, steps: Steps[Taken]) -> Answer:
        taken = await self._hand_over(steps)
        return taken if self.armed else f'{taken}; not armed: nothing moves until it is'

    async def switch_controller(self, name: str) -> Answer:
        await self._perform(self._client.set('controller', controller=name))
        return f'{name.replace("_", " ")} drives'

    async def set(self, name: str, value: Any) -> Answer:
        if self._described is None:
            raise RefusedError('the parameters of the controller are not known yet')
        try:
            value = self._described.converted(name, value)
        except ValueError as error:
            raise RefusedError(str(error)) from None
        await self._perform(self._client.set('controller', **{name: value}))
        return f'{name} is {value} now'

    async def teach(self, like: bool, x: float, y: float, kind: str | None, stamp: int) -> Answer:
        return await self._perform(self._client.teach(like, x, y, kind, stamp))

    def _hear_taught(self, message: DiagnosticStatus) -> None:
        self._client.taught = message

    async def record(self, on: bool, title: str) -> Answer:
        if on and not self._is_recording():
            await self._perform(self._client.set('recorder', title=title, notes=''))
        said = await self._perform(self._client.record(on))
        deadline = time.monotonic() + PATIENCE.take_s  # so that a note that follows is accepted
        while self._is_recording() != on and time.monotonic() < deadline:
            await asyncio.sleep(_LOOK_S)
        return said

    async def note(self, text: str) -> Answer:
        if not self._is_recording():
            raise RefusedError('nothing is being recorded')
        async with self._noting:
            before = (await self._perform(self._client.get('recorder', 'notes')))['notes']
            line = f'{datetime.now():%H:%M:%S} {text}'
            await self._perform(self._client.set(
                'recorder', notes='\n'.join(filter(None, [before, line]))))
        return 'it is in the recording'

    def _is_recording(self) -> bool:
        recording = self.recording()
        return bool(recording and recording['on'])


def _metres(x_um: float, y_um: float) -> tuple[float, float]:
    return 1e-6 * x_um, 1e-6 * y_um
