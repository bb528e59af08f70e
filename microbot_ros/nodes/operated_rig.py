"""A rig as the cockpit's pages work it: each verb by topic or service, ended by a node's word."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from datetime import datetime
from typing import Any

import numpy as np
from diagnostic_msgs.srv import AddDiagnostics
from geometry_msgs.msg import PoseArray, PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.client import Client
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.publisher import Publisher
from rclpy.task import Future
from sensor_msgs.msg import Joy, PointCloud2
from std_msgs.msg import Empty, Header
from std_srvs.srv import SetBool

from microbot_ros.cockpit.rig import Answer, RefusedError
from microbot_ros.control.controller_thread import AGAIN, CONFIGURING
from microbot_ros.drive.amplifier import BY_HAND, Zero
from microbot_ros.loop.points import GOAL
from microbot_ros.nodes import messages
from microbot_ros.nodes.described_parameters import Described
from microbot_ros.nodes.lifecycle import NEWEST, RigNode
from microbot_ros.nodes.rig_view import RigView
from microbot_ros.nodes.topics import CHANGES

_STOPS_S = (0.3, 0.7, 1.0, 1.0)
"""A request to stop is sent again after each of these [s] without an answer. The driver sends zero
when it takes the request, and answers once that is read back, within `READ_BACK_S`."""
_ARM_S = 12.0
_FIND_S = 3.0
"""So long a node may take to be seen by a cockpit that has just started."""
_ANSWER_S = 5.0
_TAKE_S, _REPEAT_S, _LOOK_S = 3.0, 0.3, 0.01
"""So long a controller may take to have goals; how often they are sent, and its word is
looked for."""
_LOOK_AROUND_S = 1.0
_CALIBRATION = ('pixel_size_um', 'rotation_deg', 'mirrored')


class _SilentError(RefusedError):
    """Nobody knows whether it was done."""


class OperatedRig(RigView):
    """What a `node` hears of its rig, and what pages may have done; the `Rig` of the server.

    All clients are made at the start, so that they are matched when they are needed. Coroutines
    run in the server's thread, callbacks of ROS in the executor's.
    """

    def __init__(self, node: RigNode) -> None:
        super().__init__(node)
        self._arm = node.client(SetBool, 'coil_driver/arm')
        self._switch = node.client(AddDiagnostics, 'controller/switch_controller')
        self._teach = node.client(AddDiagnostics, 'tracker/teach')
        self._record = node.client(SetBool, 'recorder/record')
        self._list = node.client(ListParameters, 'controller/list_parameters')
        self._describe = node.client(DescribeParameters, 'controller/describe_parameters')
        self._get = node.client(GetParameters, 'controller/get_parameters')
        self._set = node.client(SetParameters, 'controller/set_parameters')
        self._get_tracker = node.client(GetParameters, 'tracker/get_parameters')
        self._get_recorder = node.client(GetParameters, 'recorder/get_parameters')
        self._set_recorder = node.client(SetParameters, 'recorder/set_parameters')
        self._heartbeat = node.publisher(Empty, 'coil_driver/heartbeat')
        self._joy = node.publisher(Joy, 'joy', NEWEST)
        self._goals_out = node.publisher(PoseArray, 'goals')
        self._particle_goals_out = node.publisher(PointCloud2, 'particle_goals')
        self._path_out = node.publisher(Path, 'path')
        node.subscribe(ParameterEvent, CHANGES, self._on_changes)
        self._described: Described | None = None
        self._outdated = False
        self._handing_over, self._noting = asyncio.Lock(), asyncio.Lock()

    def _on_changes(self, event: ParameterEvent) -> None:
        """In the executor's thread: a parameter of some node is another."""
        place = self._node.get_namespace().rstrip('/')
        if event.node == f'{place}/controller':
            self._outdated = True

    # What the server asks -------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """All that is known: a part by its name; None for what is not."""
        controller = self.controller()
        if controller is not None and self._described is not None:
            controller['parameters'] = self._described.of(controller['name'])
        return {**super().state(), 'controller': controller}

    async def keep_up(self) -> None:
        """Ask for parameters where they are not known, or not any more, for ever."""
        while True:
            with suppress(RefusedError):
                await self._catch_up()
            await asyncio.sleep(_REPEAT_S if self._described else _LOOK_AROUND_S)

    async def _catch_up(self) -> None:
        if not self.progress('controller'):
            self._described = None  # gone; another may come
        elif self._described is None or self._outdated:
            self._outdated = False
            self._described = await self._ask_parameters(self._described)
        if not self.calibrated:
            answer = await self._ask(
                self._get_tracker, GetParameters.Request(names=list(_CALIBRATION)), _ANSWER_S)
            values = [parameter_value_to_python(value) for value in answer.values]
            self.use_calibration(dict(zip(_CALIBRATION, values, strict=True)))

    async def _ask_parameters(self, known: Described | None) -> Described:
        """The controller's parameters as they are now; `known` before, where they were."""
        if known is None:
            names = (await self._ask(self._list, ListParameters.Request(), _ANSWER_S)).result.names
            answer = await self._ask(
                self._describe, DescribeParameters.Request(names=names), _ANSWER_S)
            known = Described(answer.descriptors)
        names = known.names
        answer = await self._ask(self._get, GetParameters.Request(names=names), _ANSWER_S)
        return known.with_values([parameter_value_to_python(v) for v in answer.values])

    async def stop(self) -> Answer:
        """Zero the coils and disarm. It does not ask whether the driver is there first.

        Repeated until the driver answers; the answer to any of the requests counts.
        """
        asked: set[asyncio.Task[Any]] = set()
        try:
            for wait_s in _STOPS_S:
                asked.add(asyncio.create_task(self._ask(
                    self._arm, SetBool.Request(data=False), sum(_STOPS_S) + 1, find_s=None)))
                answered, _ = await asyncio.wait(
                    asked, timeout=wait_s, return_when=asyncio.FIRST_COMPLETED)
                if answered:
                    return _told(answered.pop().result())
        finally:
            for one in asked:
                one.cancel()
        raise RefusedError(
            f'{Zero.UNREACHABLE}: coil_driver did not answer within {sum(_STOPS_S):g} s; coils '
            f'may carry current, {BY_HAND}')

    async def arm(self) -> Answer:
        """Let currents flow. The request is sent once; without an answer the driver is disarmed.

        The driver is there already, or refused: else STOP could come before it was found.
        """
        try:
            return _told(await self._ask(
                self._arm, SetBool.Request(data=True), _ARM_S, find_s=0.0))
        except _SilentError as silence:
            try:
                disarmed = f'disarmed: {await self.stop()}'
            except RefusedError as refusal:
                disarmed = f'asked to disarm: {refusal}'
            raise RefusedError(f'{silence}; {disarmed}') from None

    def attend(self) -> None:
        """Tell the driver that an operator is there."""
        self._heartbeat.publish(Empty())

    def stick(self, x: float, y: float) -> None:
        """Say once where the stick is, `x` and `y` of −1 to 1."""
        self._joy.publish(Joy(header=self._header(), axes=[x, y]))

    async def goal(self, x_um: float, y_um: float, particle: int | None) -> Answer:
        """One goal at `x_um`, `y_um`, in place of those there are; or that of one `particle`
        beside the others'."""
        if particle is None:
            place = np.array([[x_um, y_um]]) * 1e-6
            return await self._hand_over(
                self._goals_out, messages.poses(place, np.zeros(1), self._now()), 'goals')
        goals = {goal['id']: (goal['x_um'], goal['y_um']) for goal in self.goals()
                 if goal['id'] is not None}
        goals[particle] = (x_um, y_um)
        points = np.zeros(len(goals), GOAL)
        points['id'] = list(goals)
        points['x'], points['y'] = 1e-6 * np.array(list(goals.values())).T
        return await self._hand_over(
            self._particle_goals_out, messages.cloud(points, self._now()), 'goals')

    async def clear_goals(self) -> Answer:
        """No goal, and no path."""
        none = np.empty((0, 2))
        await self._hand_over(
            self._path_out, self._path(none), 'path')
        return await self._hand_over(
            self._goals_out, messages.poses(none, np.empty(0), self._now()), 'goals')

    async def path(self, points_um: list[tuple[float, float]]) -> Answer:
        """A path to follow, through `points_um`."""
        return await self._hand_over(
            self._path_out, self._path(1e-6 * np.array(points_um)), 'path')

    async def switch_controller(self, name: str) -> Answer:
        """Let the controller of that `name` drive."""
        return _told(await self._ask(
            self._switch, AddDiagnostics.Request(load_namespace=name), _ANSWER_S))

    async def set(self, name: str, value: Any) -> Answer:
        """Change the parameter of that `name`, one that the page was told of, to a `value`."""
        if self._described is None:
            raise RefusedError('the parameters of the controller are not known yet')
        try:
            return await self._change(self._set, name, self._described.converted(name, value))
        except ValueError as error:
            raise RefusedError(str(error)) from None

    async def teach(self, order: str) -> Answer:
        """Show the tracker an example, by an `order` as its service takes it."""
        return _told(await self._ask(
            self._teach, AddDiagnostics.Request(load_namespace=order), _ANSWER_S))

    async def record(self, on: bool, title: str) -> Answer:
        """Begin a recording under a `title` if it is to be `on`, or end it."""
        if on and not self._is_recording():
            await self._change(self._set_recorder, 'title', title)
            await self._change(self._set_recorder, 'notes', '')
        said = _told(await self._ask(self._record, SetBool.Request(data=on), _ARM_S))
        deadline = time.monotonic() + _TAKE_S  # whoever notes now is to be believed
        while self._is_recording() != on and time.monotonic() < deadline:
            await asyncio.sleep(_LOOK_S)
        return said

    async def note(self, text: str) -> Answer:
        """A line of `text` more, with the time of day."""
        if not self._is_recording():
            raise RefusedError('nothing is being recorded')
        async with self._noting:
            answer = await self._ask(
                self._get_recorder, GetParameters.Request(names=['notes']), _ANSWER_S)
            before = parameter_value_to_python(answer.values[0])
            line = f'{datetime.now():%H:%M:%S} {text}'
            return await self._change(
                self._set_recorder, 'notes', '\n'.join(filter(None, [before, line])))

    # How ----------------------------------------------------------------------------------

    def _is_recording(self) -> bool:
        recording = self.recording()
        return bool(recording and recording['on'])

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()

    def _header(self) -> Header:
        return Header(stamp=self._now(), frame_id=messages.WORKSPACE)

    def _path(self, points: np.ndarray) -> Path:
        array = messages.poses(points, np.zeros(len(points)), self._now())
        return Path(header=array.header, poses=[
            PoseStamped(header=array.header, pose=pose) for pose in array.poses])

    async def _hand_over(self, publisher: Publisher, message: Any, what: str) -> Answer:
        """Publish to the controller, again and again, until it says that it has this stamp."""
        stamp = messages.to_seconds(message.header.stamp)

        def taken() -> bool:
            return float(self.progress(f'{what}_stamp_s') or 'nan') == stamp
        async with self._handing_over:
            deadline = time.monotonic() + _TAKE_S
            while time.monotonic() < deadline:
                publisher.publish(message)
                again = time.monotonic() + _REPEAT_S
                while time.monotonic() < again:
                    if taken():
                        return f'{self.progress("controller")} has it'
                    if float(self.progress('refused_stamp_s') or 'nan') == stamp:
                        raise RefusedError(self.progress('refused'))
                    await asyncio.sleep(_LOOK_S)
        said = ('it answers, but not to these' if self.progress('controller') else
                'it says nothing; is it running?')
        raise RefusedError(f'controller did not take the {what} within {_TAKE_S:g} s: {said}')

    async def _change(self, client: Client, name: str, value: Any) -> Answer:
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        deadline = time.monotonic() + CONFIGURING
        while (result := (await self._ask(client, request, _ANSWER_S)).results[0]
               ).reason.endswith(AGAIN) and time.monotonic() < deadline:
            await asyncio.sleep(_REPEAT_S)
        if not result.successful:
            raise RefusedError(result.reason or f'{name} was refused')
        return f'{name} is set'

    async def _ask(self, client: Client, request: Any, seconds: float,
                   find_s: float | None = _FIND_S) -> Any:
        """What a service answers within so many `seconds`; RefusedError where it is not there.

        It has `find_s` to be found; with None it is asked though nobody may be there, as far as
        is known.
        """
        name = self._node.resolve_service_name(client.srv_name)
        node, _, service = name.removeprefix('/').rpartition('/')
        deadline = time.monotonic() + (find_s or 0.0)
        while find_s is not None and not client.service_is_ready():
            if time.monotonic() >= deadline:
                raise RefusedError(f'{node} has no service {service}: is it running?')
            await asyncio.sleep(_LOOK_S)
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def hand_over(future: Future) -> None:
            if not answered.done():
                answered.set_result(future.result())

        def heard(future: Future) -> None:
            with suppress(RuntimeError):  # the server is gone
                loop.call_soon_threadsafe(hand_over, future)
        asked = client.call_async(request)
        asked.add_done_callback(heard)
        try:
            return await asyncio.wait_for(answered, seconds)
        except asyncio.CancelledError:
            client.remove_pending_request(asked)
            raise
        except TimeoutError:
            client.remove_pending_request(asked)
            raise _SilentError(f'{node} did not answer within {seconds:g} s') from None


def _told(answer: Any) -> Answer:
    """What a service said that it has done; RefusedError with its reason where it has not."""
    if not answer.success:
        raise RefusedError(answer.message or 'refused, without a reason')
    return str(answer.message)
