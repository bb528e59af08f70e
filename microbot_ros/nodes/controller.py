"""Node `controller`: the direction of the field, by a controller that can be switched."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any, ClassVar

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseArray, PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Path
from sensor_msgs.msg import Joy, PointCloud2
from std_msgs.msg import Bool, Header, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from microbot_ros.common.errors import InputError, shown
from microbot_ros.common.settings import defaults
from microbot_ros.control.contract import FieldCommand, Goals, Input, Result, no_field
from microbot_ros.control.deadline_worker import DeadlineWorker
from microbot_ros.control.registry import controller_classes
from microbot_ros.loop.controller import ControllerParameters, ControllerStage
from microbot_ros.loop.points import GOAL, PLACE
from microbot_ros.model.io.model_file import read_model
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.core import Core
from microbot_ros.nodes.base.lifecycle import (
    CHANGES_IN,
    ERROR,
    LATCHED,
    NEWEST,
    OK,
    WARN,
    RigNode,
    status,
)
from microbot_ros.nodes.base.markers import markers
from microbot_ros.nodes.base.parameters import ParameterSet
from microbot_ros.session.replay.log import EXPIRE, LET_GO

_MARKERS_SECONDS = 0.2
"""Interval of the markers [s]. Choice: five a second suffice for a viewer."""


class ControllerCore(Core):
    """Core between `model/state`, goals and the field.

    It publishes `field/command`, or `field/rotating` for a rotating field.
    """

    Parameters: ClassVar[type] = ControllerParameters
    frame = 'model/state'

    def make_stage(self, values: Callable[[str, type], Any],
                   worker: Callable[[float], DeadlineWorker]) -> None:
        """Make the stage.

        Parameters
        ----------
        values : callable
            Function that returns the parameters of a controller by its name and class.
        worker : callable
            Function that makes, from a patience [s], the worker that calls controllers.

        Raises
        ------
        InputError
            If a controller refuses its parameters.
        """
        self.stage = ControllerStage(self.settings, worker)
        answer = self.stage.configure(self.settings, {
            name: values(name, kind.Parameters) for name, kind in self.stage.classes.items()})
        if not answer.ok:
            raise InputError('controller', answer.message)

    def take(self, changed: Mapping[str, Any], named: Collection[str]) -> str:
        # The active controller is restarted after a fault if `controller` is among `named`. No
        # frame waits longer than for a controller that computes.
        answer = self.stage.configure(
            changed.get('', self.settings),
            {prefix.removesuffix('.'): values for prefix, values in changed.items() if prefix},
            restart='controller' in named, seconds=self.settings.deadline_ms * 1e-3)
        self.switched(answer.message)
        return '' if answer.ok else answer.message

    @property
    def unrepeatable(self) -> str:  # type: ignore[override]
        """Why the active controller may answer the same inputs differently; '' if it does not."""
        return self.stage.unrepeatable

    def connect(self) -> None:
        self.stage.begin()
        self._goals_stamp = self._path_stamp = self._plan_stamp = 0.0
        self._refused = 0.0, ''
        self._commands = self.publisher(Vector3Stamped, 'field/command')
        self._markers = self.publisher(MarkerArray, 'markers')
        self._markers_due = 0.0
        self._rotating = self.publisher(TwistStamped, 'field/rotating')
        # Latched, for viewers that start later.
        self._goals_taken = self.publisher(PointCloud2, '~/goals', LATCHED)
        self._path_taken = self.publisher(Path, '~/path', LATCHED)
        self.subscribe(PointCloud2, 'model/state', self._on_state, NEWEST)
        self.subscribe(PoseArray, 'goals', self._on_goals)
        self.subscribe(PoseStamped, 'goal_pose', self._on_goal_pose)
        self.subscribe(PointCloud2, 'particle_goals', self._on_particle_goals)
        self.subscribe(Path, 'path', self._on_path)
        self.subscribe(JointTrajectory, 'field/plan', self._on_plan)
        self.subscribe(Joy, 'joy', self._on_joy, NEWEST)
        self.subscribe(Bool, 'coil_driver/armed', self._on_armed, CHANGES_IN)

    def expire(self) -> None:
        """Command zero once if poses have stopped arriving."""
        if self.stage.expire(self.now_s):
            self.act(EXPIRE)
            self._publish_zero()

    def tell(self) -> None:
        """Publish progress; called when goals, a path or a plan were accepted or refused."""

    def switched(self, message: str) -> None:
        """Report the result of a change of parameters.

        Parameters
        ----------
        message : str
            Text for people, '' for none.
        """

    def let_go(self) -> None:
        """Command zero once, if anything may flow; the next command starts from zero."""
        if self.stage.let_go():
            self._publish_zero()

    def _on_armed(self, message: Bool) -> None:
        (self._be_armed if message.data else self._be_disarmed)()

    def _be_armed(self) -> None:
        """Command zero first after arming, as the driver waits for it, and continue from zero."""
        self.stage.be_armed()
        self._publish_zero()

    def _be_disarmed(self) -> None:
        """Discard goals, path and plan when the coils are disarmed."""
        was_armed = self.stage.armed
        self.stage.be_disarmed()
        if was_armed:
            self._goals_stamp = self._path_stamp = self._plan_stamp = 0.0
            self._tell_goals(self.now_stamp())
            self._path_taken.publish(Path())
            self.tell()

    def _on_state(self, message: PointCloud2) -> None:
        estimates, stamp = messages.estimates(message), message.header.stamp
        silent = self.stage.joystick_remark
        outcome = self.stage.step(
            estimates, messages.to_seconds(stamp), self.now_s)
        if outcome.command is None:
            self.let_go()
        else:
            self._publish(outcome.command, stamp)
        if self.stage.joystick_remark and not silent:
            self.complain(self.stage.joystick_remark)
        if self._markers.get_subscription_count() and time.monotonic() > self._markers_due:
            self._markers_due = time.monotonic() + _MARKERS_SECONDS
            self._markers.publish(markers(estimates, self.stage.goals.position, stamp))

    def _on_goals(self, message: PoseArray) -> None:
        self._take_goals(message.header, [pose.position for pose in message.poses])

    def _on_goal_pose(self, message: PoseStamped) -> None:
        self._take_goals(message.header, [message.pose.position])

    def _on_particle_goals(self, message: PointCloud2) -> None:
        goals = messages.points(message, GOAL)
        self._take_goals(message.header, [Point(x=float(g['x']), y=float(g['y'])) for g in goals],
                         goals['id'].astype(int))

    def _takes(self, name: str) -> list[str]:
        """Return the inputs that a controller accepts, by the names of `Input`."""
        return [what.name.lower() for what in Input if self.stage.classes[name].accepts(what)]

    def _refuses(self, what: Input, header: Header) -> bool:
        """Return whether the active controller does not accept an input, and report that."""
        refusal = self.stage.refusal(what)
        if refusal:
            self._refused = messages.to_seconds(header.stamp), refusal
            self.complain(refusal)
            self.tell()  # at once, for waiting clients
        return bool(refusal)

    def _take_goals(self, header: Header, places: list[Point],
                    ids: np.ndarray | None = None) -> None:
        messages.in_workspace(header)
        # Cancelling is never refused.
        if places and self._refuses(Input.GOALS if ids is None else Input.PARTICLE_GOALS, header):
            return
        self._goals_stamp = messages.to_seconds(header.stamp)
        self.stage.go_to(Goals(np.array([(p.x, p.y) for p in places]).reshape(-1, 2), ids,
                               self._goals_stamp))
        self._tell_goals(header.stamp)
        self.tell()  # at once, for waiting clients

    def _tell_goals(self, stamp: Time) -> None:
        """Publish the present goals, with the stamp of their message."""
        goals = self.stage.goals
        points = np.zeros(len(goals), PLACE if goals.ids is None else GOAL)
        points['x'], points['y'] = goals.position.T
        if goals.ids is not None:
            points['id'] = goals.ids
        self._goals_taken.publish(messages.cloud(points, stamp))

    def _on_path(self, message: Path) -> None:
        messages.in_workspace(message.header)
        if message.poses and self._refuses(Input.PATH, message.header):
            return
        self.stage.follow(np.array([
            (p.pose.position.x, p.pose.position.y) for p in message.poses]).reshape(-1, 2))
        self._path_stamp = messages.to_seconds(message.header.stamp)
        self._path_taken.publish(message)
        self.tell()

    def _on_plan(self, message: JointTrajectory) -> None:
        stamp = messages.to_seconds(message.header.stamp)
        if stamp == self._plan_stamp:
            return  # a repeated message is not played twice
        if self._refuses(Input.PLAN, message.header):
            return
        try:
            self.stage.play(messages.plan_rows(message))
        except ValueError as error:
            raise messages.MessageError(f'field/plan: {error}') from None
        self._plan_stamp = stamp
        self.tell()

    def _on_joy(self, message: Joy) -> None:
        now = self.now_s
        # A driver may omit the stamp; a stamp in the future is replaced.
        t = min(messages.to_seconds(message.header.stamp) or now, now)
        try:
            self.stage.move_joystick(np.array(message.axes[:2], float), t)
        except ValueError as error:
            raise messages.MessageError(f'joy: {error}') from None

    def _publish_zero(self) -> None:
        self._publish(no_field(''), self.now_stamp())

    def _publish(self, command: FieldCommand, stamp: Time) -> None:
        if command.frequency > 0:
            self._rotating.publish(
                messages.rotating(command.field, command.angular_velocity, stamp))
        else:
            self._commands.publish(messages.field_vector(command.field, stamp))


class ControllerNode(RigNode, ControllerCore):
    """Node with a `ControllerCore`, its services and its topics for viewers."""

    @classmethod
    def known_parameters(cls) -> dict[str, tuple[type, str]]:
        known = super().known_parameters()
        for name, kind in controller_classes(required='hold').items():
            known |= {f'{name}.{field}': (kind.Parameters, field)
                      for field in defaults(kind.Parameters)}
        return known

    def declare_more(self) -> None:
        self.make_stage(lambda name, kind: ParameterSet(
            self, kind, prefix=f'{name}.', beside=self._parameters_of_node).values,
            self.log.worker)

    def veto(self, proposed: ControllerParameters) -> str:
        low_x, low_y, high_x, high_y = (*proposed.workspace_um, *4 * [math.nan])[:4]
        if not (low_x < high_x and low_y < high_y and len(proposed.workspace_um) == 4):
            return 'workspace_um must be left, bottom, right, top; received ' + shown(
                proposed.workspace_um)
        if proposed.model_file:
            try:
                read_model(proposed.model_file)
            except InputError as error:
                return str(error)
        return ''

    def setup(self) -> None:
        self.connect()
        summaries = {name: kind.summary for name, kind in self.stage.classes.items()}
        self.publisher(String, '~/controllers', LATCHED).publish(
            String(data=json.dumps(summaries, ensure_ascii=False)))
        self.every(0.05, self._watch)
        self.service(Trigger, '~/list_controllers', self._on_list)
        self._progress = self.publisher(DiagnosticStatus, '~/progress')
        self._tell_goals(Time())
        self._path_taken.publish(Path())
        self.every(0.2, self.tell)

    def stop(self) -> None:
        self.make_safe()

    def make_safe(self) -> None:
        """Command zero once, if anything may flow; the next command starts from zero."""
        if hasattr(self, '_commands'):
            self.act(LET_GO)
            self.let_go()

    def teardown(self) -> None:
        self.stage.manager.reset()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        outcome, name = self.stage.outcome, self.stage.manager.active
        values: dict[str, object] = {
            'controller': name, 'result': outcome.result.value, 'goals': len(self.stage.goals),
            'goals_stamp_s': repr(self._goals_stamp), 'path_stamp_s': repr(self._path_stamp),
            'plan_stamp_s': repr(self._plan_stamp), 'refused_stamp_s': repr(self._refused[0]),
            'refused': self._refused[1], 'takes': ', '.join(self._takes(name))}
        if outcome.command is not None:
            values['distance_um'] = outcome.command.progress.distance * 1e6
            values['done'] = outcome.command.progress.done
            if outcome.command.progress.goal is not None:
                values['goal'] = outcome.command.progress.goal
            driven = outcome.command.particles
            values['particles'] = ', '.join(map(str, () if driven is None else driven.tolist()))
        level = {Result.OK: OK, Result.FAULT: ERROR}.get(outcome.result, WARN)
        waits = 'not armed: starts when armed; ' * self.stage.waits
        return level, f'{name}: {waits}{outcome.message or "driving"}', values

    def _on_list(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        active = self.stage.manager.active
        answer.success = True
        answer.message = json.dumps([
            {'name': name, 'state': 'active' if name == active else 'inactive',
             'summary': kind.summary, 'takes': self._takes(name)}
            for name, kind in self.stage.classes.items()],
            ensure_ascii=False)
        return answer

    def _watch(self) -> None:
        """Command zero once if poses stop arriving, then stay silent and report the duration."""
        self.now_ns = self.get_clock().now().nanoseconds
        self.expire()

    def tell(self) -> None:
        self._progress.publish(status(self, *self.health()))

    def switched(self, message: str) -> None:
        if message:
            self.get_logger().info(message)
