"""Node `controller`: which way the field is to point, by a controller that can be switched."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import yaml
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseArray, PoseStamped, Vector3Stamped
from nav_msgs.msg import Path
from sensor_msgs.msg import Joy, PointCloud2
from std_msgs.msg import Header, String
from visualization_msgs.msg import MarkerArray

from microbot_ros.control.contract import (
    ControllerInput,
    FieldCommand,
    Goals,
    Limits,
    Result,
    Workspace,
    no_field,
)
from microbot_ros.control.controller_manager import ControllerManager, Outcome
from microbot_ros.control.registry import PluginError, controller_classes
from microbot_ros.errors import InputError
from microbot_ros.model.model import Model
from microbot_ros.model.model_file import read_model
from microbot_ros.nodes import messages
from microbot_ros.nodes.lifecycle import ERROR, LATCHED, NEWEST, OK, WARN, RigNode, status
from microbot_ros.nodes.markers import markers
from microbot_ros.nodes.parameters import ParameterSet
from microbot_ros.settings import defaults, setting

_MARKERS_SECONDS = 0.2


@dataclass(frozen=True)
class ControllerParameters:
    """Parameters of the node `controller`; each controller has its own under its name."""

    controller: str = setting('hold', 'The controller that drives; see `~/controllers`.')
    max_field_mT: float = setting(5.0, 'Strongest field a controller may ask for.', lower=0.0,
                                  upper=100.0, read_only=True)
    slew_mT_per_s: float = setting(1000.0, 'Fastest change of the field.', lower=1.0, upper=1e6,
                                   read_only=True)
    max_frequency_hz: float = setting(100.0, 'Fastest rotation of a rolling field.', lower=0.0,
                                      upper=1000.0, read_only=True)
    pose_timeout_ms: float = setting(
        200.0, 'Age of the poses beyond which nothing is commanded.', lower=10.0, upper=5000.0,
        read_only=True, formerly='stale_ms')
    joy_timeout_ms: float = setting(
        250.0, 'Age of the joystick beyond which it counts as centred; its driver must repeat.',
        lower=20.0, upper=2000.0, read_only=True)
    deadline_ms: float = setting(10.0, 'How long a controller may think.', lower=1.0,
                                 upper=1000.0, read_only=True)
    workspace_um: list[float] = setting(
        [-140.0, -104.0, 140.0, 104.0], 'Left, bottom, right, top of where particles may go.',
        lower=-1e5, upper=1e5, read_only=True)
    border_s: float = setting(
        0.5, 'A driven particle that would be out of the workspace within this time turns the '
        'field; 0: never.', lower=0.0, upper=60.0, read_only=True)
    delay_ms: float = setting(
        25.0, 'From exposure until a command given now acts; 0 for none.', lower=0.0,
        upper=2000.0)
    model_file: str = setting('', 'model.yaml with the effects that controllers may use.')


class ControllerNode(RigNode):
    """`model/state`, goals → `field/command`. A shell around the controller manager."""

    Parameters: ClassVar[type] = ControllerParameters
    accounts_for = 'model/state'

    @classmethod
    def known_parameters(cls) -> dict[str, tuple[type, str]]:
        known = super().known_parameters()
        for name, kind in controller_classes(required='hold').items():
            known |= {f'{name}.{field}': (kind.Parameters, field)
                      for field in defaults(kind.Parameters)}
        return known

    def declare_more(self) -> None:
        values: ControllerParameters = self.settings
        try:
            classes = controller_classes(required=values.controller)
        except PluginError as error:
            raise InputError(self.get_name(), str(error)) from None
        self._repeatable = {name for name, kind in classes.items() if kind.repeatable}
        self._summaries = {name: kind.summary for name, kind in classes.items()}
        self._manager = ControllerManager(
            {name: kind() for name, kind in classes.items()}, active=values.controller,
            deadline=values.deadline_ms * 1e-3, pose_timeout=values.pose_timeout_ms * 1e-3,
            border=values.border_s, worker=self.account.worker)
        answer = self._manager.change({
            name: ParameterSet(self, kind.Parameters, prefix=f'{name}.',
                               beside=self._parameters_of_node).values
            for name, kind in classes.items()})
        if not answer.ok:
            raise InputError(self.get_name(), answer.message)

    def veto(self, proposed: ControllerParameters) -> str:
        low_x, low_y, high_x, high_y = (*proposed.workspace_um, *4 * [math.nan])[:4]
        if not (low_x < high_x and low_y < high_y and len(proposed.workspace_um) == 4):
            return 'workspace_um must be left, bottom, right, top; received ' + str(
                proposed.workspace_um)
        if proposed.model_file:
            try:
                read_model(proposed.model_file)
            except InputError as error:
                return str(error)
        return ''

    def take(self, changed: Mapping[str, Any], named: Collection[str]) -> str:
        """Configure what `changed`, then switch. To have `named` the controller that drives
        restarts it after a fault.
        """
        manager, wanted = self._manager, changed.get('', self.settings).controller
        switch = 'controller' in named and (wanted != manager.active or manager.fault)
        answer = manager.change(
            {prefix.removesuffix('.'): values for prefix, values in changed.items() if prefix},
            wanted if switch else '')
        if answer.message:
            self.get_logger().info(answer.message)
        return '' if answer.ok else answer.message

    @property
    def unrepeatable(self) -> str:  # type: ignore[override]
        """Of the controller that drives."""
        name = self._manager.active
        return '' if name in self._repeatable else f'{name} thinks for as long as it may'

    def setup(self) -> None:
        self._goals, self._path = Goals(), np.empty((0, 2))
        self._goals_stamp = self._path_stamp = 0.0
        self._joystick, self._joystick_t, self._joystick_silent = np.zeros(2), -math.inf, ''
        self._last_t = -math.inf
        self._driving = self._rolling = False
        self._outcome = Outcome(None, Result.STALE, 'no poses yet')
        self._model: tuple[str, Model | None] = ('', None)
        self._commands = self.publisher(Vector3Stamped, 'field/command')
        self._markers = self.publisher(MarkerArray, 'markers')
        self._markers_due = 0.0
        self._rotations = self.publisher(Vector3Stamped, 'field/rotation')
        self.publisher(String, '~/controllers', LATCHED).publish(
            String(data=yaml.safe_dump(self._summaries, sort_keys=False)))
        self.subscribe(PointCloud2, 'model/state', self._on_state, NEWEST)
        self.subscribe(PoseArray, 'goals', self._on_goals)
        self.subscribe(PoseStamped, 'goal_pose', self._on_goal_pose)
        self.subscribe(PointCloud2, 'particle_goals', self._on_particle_goals)
        self.subscribe(Path, 'path', self._on_path)
        self.subscribe(Joy, 'joy', self._on_joy, NEWEST)
        self.every(0.05, self._watch)
        self._progress = self.publisher(DiagnosticStatus, '~/progress')
        self.every(0.2, self._tell)

    def stop(self) -> None:
        self.make_safe()

    def make_safe(self) -> None:
        """Let go: zero once, if anything may flow, and the next command starts from there."""
        self._manager.let_go()
        if getattr(self, '_driving', False):
            self._driving = False
            self._publish(no_field(''), self.get_clock().now().to_msg())
            if self._outcome.result is Result.OK:
                self._outcome = Outcome(None, Result.STALE, 'no poses since the field was let go')

    def teardown(self) -> None:
        if hasattr(self, '_manager'):
            self._manager.reset()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        outcome, name = self._outcome, self._manager.active
        values: dict[str, object] = {
            'controller': name, 'result': outcome.result.value, 'goals': len(self._goals),
            'goals_stamp_s': repr(self._goals_stamp), 'path_stamp_s': repr(self._path_stamp)}
        if outcome.command is not None:
            values['distance_um'] = outcome.command.progress.distance * 1e6
            values['done'] = outcome.command.progress.done
        level = {Result.OK: OK, Result.FAULT: ERROR}.get(outcome.result, WARN)
        return level, f'{name}: {outcome.message or "driving"}', values

    def _on_state(self, message: PointCloud2) -> None:
        points = messages.estimates(message)
        stamp = messages.to_seconds(message.header.stamp)
        self._tick(self._controller_input(points, stamp), message.header.stamp)
        if self._markers.get_subscription_count() and time.monotonic() > self._markers_due:
            self._markers_due = time.monotonic() + _MARKERS_SECONDS
            self._markers.publish(markers(points, self._goals.position, message.header.stamp))

    def _on_goals(self, message: PoseArray) -> None:
        self._take_goals(message.header, [pose.position for pose in message.poses])

    def _on_goal_pose(self, message: PoseStamped) -> None:
        self._take_goals(message.header, [message.pose.position])

    def _on_particle_goals(self, message: PointCloud2) -> None:
        goals = messages.points(message, messages.GOAL)
        self._take_goals(message.header, [Point(x=float(g['x']), y=float(g['y'])) for g in goals],
                         goals['id'].astype(int))

    def _take_goals(self, header: Header, places: list[Point],
                    ids: np.ndarray | None = None) -> None:
        messages.in_workspace(header)
        self._goals = Goals(np.array([(p.x, p.y) for p in places]).reshape(-1, 2), ids)
        self._goals_stamp = messages.to_seconds(header.stamp)
        self._answer()

    def _on_path(self, message: Path) -> None:
        messages.in_workspace(message.header)
        self._path = np.array([
            (p.pose.position.x, p.pose.position.y) for p in message.poses]).reshape(-1, 2)
        self._path_stamp = messages.to_seconds(message.header.stamp)
        self._answer()

    def _answer(self) -> None:
        """Say at once what was taken; what came of the places before says nothing of these."""
        self._outcome = Outcome(None, Result.STALE, 'no poses since it was told where to go')
        self._tell()

    def _on_joy(self, message: Joy) -> None:
        axes, now = np.array(message.axes[:2], float), self.seconds()
        self._joystick = np.zeros(2)
        if not (len(axes) == 2 and np.isfinite(axes).all()):
            raise messages.MessageError(
                f'joy: expected two finite axes; received {axes.tolist()}: counted as centred')
        self._joystick = axes / max(1.0, float(np.hypot(*axes)))
        # A driver may leave the stamp out; one that is ahead of its time is not believed.
        self._joystick_t = min(messages.to_seconds(message.header.stamp) or now, now)

    def _joystick_at(self, t: float) -> np.ndarray:
        """The stick (2,) at an exposure `t` [s]: centred where it was silent for too long.

        A frame may be exposed before the stick moved, but no longer than poses may be old.
        """
        values, age = self.settings, t - self._joystick_t
        fresh = -values.pose_timeout_ms * 1e-3 <= age <= values.joy_timeout_ms * 1e-3
        before, self._joystick_silent = self._joystick_silent, ''
        if fresh or not self._joystick.any():
            return self._joystick
        since = (f'has been silent for {age:.2f} s' if age > 0 else
                 f'is stamped {-age:.2f} s after the frame')
        self._joystick_silent = f'the joystick {since}: counted as centred'
        if not before:
            self.complain(self._joystick_silent)
        return np.zeros(2)

    def _watch(self) -> None:
        """Poses that stop coming: let go once, then stay silent, and say for how long."""
        age = self.seconds() - self._last_t
        if math.isinf(age) or abs(age) <= self.settings.pose_timeout_ms * 1e-3:
            return
        if self._driving:
            self.account.act('_watch')
        self.make_safe()
        if not self._manager.fault:
            self._outcome = Outcome(None, Result.STALE, f'poses are {age:.2f} s old')

    def _tell(self) -> None:
        self._progress.publish(status(self.get_name(), *self.health()))

    def _controller_input(self, points: np.ndarray, stamp: float) -> ControllerInput:
        """All at the moment of exposure: the same poses give the same command, live or replayed.

        When they arrive decides only whether they are too old for any. Time goes by from the
        newest: frames that overtake each other give none, unless the clock was set back.
        """
        values: ControllerParameters = self.settings
        stale = values.pose_timeout_ms * 1e-3
        dt = stamp - self._last_t
        if not -stale <= dt <= 0:
            self._last_t = stamp
        age = self.account.taken_s - stamp
        fresh = abs(age) <= stale
        known = np.isfinite(points['speed_std'])
        return ControllerInput(
            t=stamp, dt=dt if math.isfinite(dt) else 0.0, age=0.0 if fresh else age,
            ids=points['id'].astype(int),
            position=np.stack([points['x'], points['y']], axis=1).astype(float),
            sigma=points['x_std'].astype(float),
            theta=points['theta'].astype(float),
            speed=points['speed'].astype(float), phi=points['phi'].astype(float),
            speed_std=np.where(known, points['speed_std'], math.inf).astype(float),
            phi_std=np.where(known, points['phi_std'], math.inf).astype(float),
            limits=Limits(values.max_field_mT * 1e-3, values.slew_mT_per_s * 1e-3,
                          values.max_frequency_hz),
            workspace=Workspace(np.array(values.workspace_um[:2]) * 1e-6,
                                np.array(values.workspace_um[2:]) * 1e-6),
            delay=values.delay_ms * 1e-3, goals=self._goals, path=self._path,
            joystick=self._joystick_at(stamp), model=self._present_model())

    def _tick(self, inputs: ControllerInput, stamp: Time) -> None:
        outcome = self._manager.tick(inputs)
        said = '; '.join(filter(None, [outcome.message, self._joystick_silent]))
        self._outcome = dataclasses.replace(outcome, message=said)
        if outcome.command is None:
            self.make_safe()
        else:
            self._driving = True
            self._publish(outcome.command, stamp)

    def _publish(self, command: FieldCommand, stamp: Time) -> None:
        self._commands.publish(messages.field_vector(command.field, stamp))
        rolling = command.frequency > 0
        if rolling or self._rolling:
            # The angular velocity ω for which ω̂ × ẑ is the rolling direction; zero once at rest.
            strength = np.hypot(*command.field) or 1.0
            x, y = command.field / strength * math.tau * command.frequency
            self._rotations.publish(messages.field_vector(np.array([-y, x]), stamp))
        self._rolling = rolling

    def _present_model(self) -> Model | None:
        file = self.settings.model_file
        if file != self._model[0]:
            self._model = (file, read_model(file)[0] if file else None)
        return self._model[1]
