"""The controller node: switched by a parameter, silent when poses stop, safe when it fails."""

from __future__ import annotations

import math
import re
import time
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseArray, PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Path
from numpy.lib.recfunctions import repack_fields
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from schemas import conforming
from sensor_msgs.msg import Joy, PointCloud2
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from microbot_ros.common.records import Commands
from microbot_ros.control.contract import no_field
from microbot_ros.control.plugins.open_loop import OpenLoop
from microbot_ros.loop.points import ESTIMATE, GOAL
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import LATCHED


class Loop:
    """A controller node, and a model that says what the test wants."""

    def __init__(self, ros: Any, **parameters: Any) -> None:
        self.graph = ros({'controller': {
            name.replace('__', '.'): value for name, value in parameters.items()}})
        self.node = self.graph.add('controller')
        assert self.node.active, self.node.fault
        self.fields = self.graph.hear(Vector3Stamped, 'field/command')
        self._state = self.graph.probe.create_publisher(PointCloud2, 'model/state', 10)
        self._goals = self.graph.probe.create_publisher(PoseArray, 'goals', 10)
        self._next_frame = 0.0
        self.graph.until(lambda: self._state.get_subscription_count() == 1)

    def see(self, x: float = 0.0, y: float = 0.0, age: float = 0.0, phi: float = 0.5) -> None:
        """One particle, whose v and φ are known."""
        point = np.zeros(1, ESTIMATE)
        point['x'], point['y'], point['speed'], point['phi'] = x, y, 4e-6, phi
        for name in ('x_std', 'y_std', 'speed_std', 'phi_std'):
            point[name] = 1e-8
        self._state.publish(messages.cloud(point, messages.to_stamp(self.node.seconds() - age)))

    def keep_seeing(self) -> None:
        """The particle at rest, as often as a camera would show it."""
        if time.monotonic() > self._next_frame:
            self._next_frame = time.monotonic() + 0.02
            self.see()

    def go(self, *places: tuple[float, float]) -> None:
        """Goals."""
        xy = np.array(places).reshape(-1, 2)
        self._goals.publish(messages.poses(xy, np.zeros(len(xy)), messages.to_stamp(1.0)))

    def set(self, **values: Any) -> Any:
        """The answer to setting parameters."""
        request = SetParameters.Request(parameters=[
            Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
            for name, value in values.items()])
        return self.graph.call(SetParameters, 'controller/set_parameters', request).results[0]

    def strength(self) -> float:
        """Of the last field [T]."""
        last = self.fields[-1].vector
        return math.hypot(last.x, last.y)


def values(told: list[DiagnosticStatus]) -> dict[str, str]:
    """Of the last report of progress; none before the first."""
    return {pair.key: pair.value for pair in told[-1].values} if told else {}


def test_hold_commands_zero_with_the_stamp_of_the_exposure(ros: Any) -> None:
    loop = Loop(ros)
    loop.see(age=0.05)
    loop.graph.until(lambda: loop.fields)
    assert loop.strength() == 0
    age = loop.node.seconds() - messages.to_seconds(loop.fields[0].header.stamp)
    assert 0.05 <= age < 5


def test_a_swap_takes_effect_and_an_unknown_one_says_what_there_is(ros: Any) -> None:
    loop = Loop(ros)
    loop.see()
    loop.graph.until(lambda: loop.fields)
    refused = loop.set(controller='steam')
    assert not refused.successful
    assert "no controller 'steam'; there are: " in refused.reason
    assert loop.node.settings.controller == 'hold'
    assert loop.set(controller='open_loop').successful
    loop.graph.until(lambda: loop.see() or loop.strength() > 4.9e-3)


def test_waypoint_steers_by_what_the_model_knows(ros: Any) -> None:
    loop = Loop(ros, controller='waypoint', delay_ms=0.0)
    loop.go((50e-6, 0.0))
    loop.graph.until(lambda: len(loop.node.stage.goals) == 1)
    loop.graph.until(lambda: loop.see(phi=0.5) or (loop.fields and loop.strength() > 4.9e-3))
    last = loop.fields[-1].vector
    assert math.atan2(last.y, last.x) == pytest.approx(-0.5, abs=0.05)


def test_poses_that_stop_mean_one_zero_and_silence(ros: Any) -> None:
    loop = Loop(ros, controller='open_loop')
    loop.graph.until(lambda: loop.see() or (loop.fields and loop.strength() > 1e-3))
    loop.graph.until(lambda: loop.strength() == 0)
    count = len(loop.fields)
    level, sentence, _ = loop.node.health()
    assert level == b'\x01'
    assert 'poses are' in sentence
    loop.see(age=5.0)  # an old pose changes nothing
    loop.graph.until(lambda: loop.node.stage._last_t < loop.node.seconds() - 4)
    assert len(loop.fields) == count


@pytest.mark.parametrize('place', [(math.nan, 0.0), (math.inf, 0.0), (1.0, 1.0)])
def test_a_goal_that_cannot_be_is_refused_with_zero(
        ros: Any, place: tuple[float, float]) -> None:
    loop = Loop(ros, controller='waypoint')
    loop.go(place)
    loop.graph.until(lambda: len(loop.node.stage.goals) == 1)
    loop.graph.until(lambda: loop.see() or loop.fields)
    level, sentence, values = loop.node.health()
    assert loop.strength() == 0
    assert level == b'\x01'
    assert values['result'] == 'bad goal'
    assert sentence.startswith('waypoint: ')


def test_a_pose_that_is_no_number_is_not_acted_on(ros: Any) -> None:
    loop = Loop(ros, controller='waypoint')
    loop.go((50e-6, 0.0))
    loop.graph.until(lambda: len(loop.node.stage.goals) == 1)
    loop.graph.until(lambda: loop.see(x=math.nan, y=math.inf) or loop.fields)
    assert loop.strength() == 0
    assert loop.node.health()[2]['result'] == 'particle lost'


def test_goals_of_particles_and_what_becomes_of_them(ros: Any) -> None:
    """For one that is gone, outside, in another frame, reached, cancelled: a clear answer each."""
    loop = Loop(ros, controller='waypoint', delay_ms=0.0)
    told = loop.graph.hear(DiagnosticStatus, 'controller/progress')
    sent = loop.graph.probe.create_publisher(PointCloud2, 'particle_goals', 10)
    clicked = loop.graph.probe.create_publisher(PoseStamped, 'goal_pose', 10)
    loop.graph.until(lambda: sent.get_subscription_count() and clicked.get_subscription_count())

    def answer(true: Any) -> dict[str, str]:
        told.clear()
        loop.graph.until(lambda: loop.keep_seeing() or (told and true(told[-1].message)))
        return values(told)

    def go(particle: int, x: float) -> None:
        goal = np.array([(particle, x, 0.0)], GOAL)
        sent.publish(messages.cloud(goal, messages.to_stamp(7.5)))

    go(4, 50e-6)
    assert answer(lambda said: 'particle 4 is not tracked' in said)['result'] == 'particle lost'
    go(0, 5e-3)
    assert answer(lambda said: 'outside the workspace' in said)['result'] == 'bad goal'
    go(0, 1e-6)
    reached = answer(lambda said: 'goal 1 of 1' in said)
    assert (reached['done'], reached['goals_stamp_s'], reached['goal']) == ('True', '7.5', '0')
    elsewhere = PoseStamped()
    elsewhere.header.frame_id = 'map'
    clicked.publish(elsewhere)
    loop.graph.until(lambda: "expected the frame 'workspace'; received 'map'"
                     in loop.node._complaint)
    assert len(loop.node.stage.goals) == 1
    loop.go()
    assert answer(lambda said: 'waits for a goal' in said)['goals'] == '0'


def test_naming_a_controller_again_restarts_it_after_a_fault(ros: Any, monkeypatch: Any) -> None:
    def breaks(*_: Any) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as broken:
        broken.setattr(OpenLoop, 'compute', breaks)
        loop = Loop(ros, controller='open_loop')
        loop.graph.until(lambda: loop.keep_seeing() or loop.node.stage.manager.fault)
    assert 'ZeroDivisionError' in loop.node.health()[1]
    assert loop.set(open_loop__field_mT=4.0).successful
    assert loop.node.stage.manager.fault
    assert loop.set(controller='open_loop').successful
    loop.graph.until(lambda: loop.keep_seeing() or (loop.fields and loop.strength() > 3.9e-3))


def test_what_there_is_is_latched(ros: Any) -> None:
    loop = Loop(ros)
    listed = loop.graph.hear(String, 'controller/controllers', LATCHED)
    loop.graph.until(lambda: listed)
    names = set(conforming('controller/controllers', listed[0].data))
    assert {'hold', 'open_loop', 'waypoint'} <= names


@pytest.mark.parametrize(('controller', 'refused'), [
    ('manual', {'goals', 'goal_pose', 'particle_goals', 'path', 'plan'}),
    ('hold', {'goals', 'goal_pose', 'particle_goals', 'path', 'plan'}),
    ('waypoint', {'path', 'plan'}),
    ('experiment', {'goals', 'goal_pose', 'particle_goals', 'path'}),
    ('path_following', {'goals', 'goal_pose', 'particle_goals', 'plan'})])
def test_what_a_controller_does_not_take_is_refused_and_who_takes_it_is_named(
        ros: Any, controller: str, refused: set[str]) -> None:
    loop = Loop(ros, controller=controller)
    told = loop.graph.hear(DiagnosticStatus, 'controller/progress')
    one = np.array([[1e-5, 0.0]])
    goal = np.zeros(1, GOAL)

    def sent(what: str, stamp: Any) -> tuple[type, str, Any]:
        poses = messages.poses(one, np.zeros(1), stamp)
        pose = PoseStamped(header=poses.header, pose=poses.poses[0])
        return {
            'goals': (PoseArray, 'goals', poses), 'goal_pose': (PoseStamped, 'goal_pose', pose),
            'particle_goals': (PointCloud2, 'particle_goals', messages.cloud(goal, stamp)),
            'path': (Path, 'path', Path(header=poses.header, poses=[pose, pose])),
            'plan': (JointTrajectory, 'field/plan', messages.plan(Commands(
                np.array([0.0, 1.0]), np.zeros((2, 2))), stamp))}[what]
    takers = {'path': 'path_following', 'plan': 'experiment'}
    for k, what in enumerate(('goals', 'goal_pose', 'particle_goals', 'path', 'plan')):
        kind, topic, message = sent(what, messages.to_stamp(100.0 + k))
        publisher = loop.graph.talk(kind, topic)
        publisher.publish(message)
        answer = 'refused_stamp_s' if what in refused else {
            'path': 'path_stamp_s', 'plan': 'plan_stamp_s'}.get(what, 'goals_stamp_s')
        loop.graph.until(lambda k=k, answer=answer: values(told).get(answer) == repr(100.0 + k))
        if what in refused:
            assert values(told)['refused'].startswith(f'{controller} takes no ')
            assert takers.get(what, 'waypoint') in values(told)['refused']
    assert len(loop.node.stage.goals) == (0 if 'goals' in refused else 1)
    assert len(loop.node.stage.path) == (0 if 'path' in refused else 2)
    assert (loop.node.stage.plan is None) == ('plan' in refused)


class Armed:
    """A driver that says whether it is armed."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._publisher = loop.graph.talk(Bool, 'coil_driver/armed', LATCHED)

    def say(self, armed: bool) -> None:
        """Say so."""
        self._publisher.publish(Bool(data=armed))

    def is_(self, armed: bool) -> None:
        """Say so, and wait until the controller knows it."""
        self.say(armed)
        self._loop.graph.until(lambda: self._loop.node.stage.armed is armed)


def test_the_first_command_after_arming_is_zero_and_the_next_starts_from_there(ros: Any) -> None:
    loop = Loop(ros, controller='open_loop', slew_mT_per_s=20.0)
    driver = Armed(loop)
    driver.is_(False)
    loop.graph.until(lambda: loop.see() or (loop.fields and loop.strength() > 4e-3))
    count = len(loop.fields)
    driver.is_(True)
    loop.graph.until(lambda: any(field.vector.x == field.vector.y == 0.0
                                 for field in loop.fields[count:]))
    zero = next(k for k, field in enumerate(loop.fields) if k >= count
                and field.vector.x == field.vector.y == 0.0)
    loop.graph.until(lambda: loop.keep_seeing() or len(loop.fields) > zero + 1)
    after = loop.fields[zero + 1].vector
    assert math.hypot(after.x, after.y) <= 20e-3 * 0.1 * (1 + 1e-9)


def test_zero_is_commanded_on_arming_though_no_pose_came(ros: Any) -> None:
    """The driver waits for it."""
    loop = Loop(ros)
    Armed(loop).is_(True)
    loop.graph.until(lambda: loop.fields)
    assert loop.strength() == 0


def test_what_was_being_carried_out_is_forgotten_when_disarmed(ros: Any) -> None:
    loop = Loop(ros, controller='waypoint')
    goals = loop.graph.hear(PointCloud2, 'controller/goals', LATCHED)
    driver = Armed(loop)
    loop.go((50e-6, 0.0))
    driver.is_(False)
    loop.graph.until(lambda: len(loop.node.stage.goals) == 1)
    assert 'not armed: starts when armed' in loop.node.health()[1]
    driver.is_(True)
    assert len(loop.node.stage.goals) == 1, 'goals that waited start'
    assert 'not armed' not in loop.node.health()[1]
    driver.is_(False)
    assert len(loop.node.stage.goals) == 0
    assert loop.node.health()[2]['goals_stamp_s'] == '0.0'
    loop.graph.until(lambda: goals and goals[-1].width == 0)
    driver.is_(True)
    loop.see()
    loop.graph.until(lambda: loop.node.health()[1].endswith('waits for a goal'))


def test_a_disarm_that_came_while_it_was_held_up_is_not_missed(ros: Any) -> None:
    loop = Loop(ros, controller='waypoint')
    driver = Armed(loop)
    driver.is_(True)
    loop.go((50e-6, 0.0))
    loop.graph.until(lambda: len(loop.node.stage.goals) == 1)
    for armed in (False, True):  # nobody spins meanwhile
        driver.say(armed)
    loop.graph.until(lambda: len(loop.node.stage.goals) == 0)
    loop.graph.until(lambda: loop.node.stage.armed)


def test_a_stick_held_while_arming_has_to_be_centred_once(ros: Any) -> None:
    loop = Loop(ros, controller='teleop', joy_timeout_ms=2000.0)
    driver = Armed(loop)
    joy = loop.graph.talk(Joy, 'joy', 1)

    def push(x: float) -> bool:
        joy.publish(Joy(axes=[x, 0.0]))
        loop.keep_seeing()
        return bool(loop.fields) and loop.strength() > 1e-3
    loop.graph.until(lambda: push(1.0))
    driver.is_(True)
    loop.graph.until(lambda: (push(1.0), 'centre it' in loop.node.health()[1])[1])
    loop.fields.clear()
    loop.graph.until(lambda: (push(1.0), len(loop.fields) > 3)[1])
    assert not any(field.vector.x or field.vector.y for field in loop.fields)
    loop.graph.until(lambda: (push(0.1), 'centre it' not in loop.node.health()[1])[1])
    loop.graph.until(lambda: push(1.0))


def test_to_cancel_is_never_refused(ros: Any) -> None:
    loop = Loop(ros, controller='waypoint')
    loop.go((50e-6, 0.0))
    loop.graph.until(lambda: len(loop.node.stage.goals) == 1)
    assert loop.set(controller='hold').successful
    loop.go()
    loop.graph.until(lambda: len(loop.node.stage.goals) == 0)


def test_a_goal_is_accepted_followed_and_cancelled_as_an_action_is(ros: Any) -> None:
    loop = Loop(ros, controller='waypoint', delay_ms=0.0)
    told = loop.graph.hear(DiagnosticStatus, 'controller/progress')
    loop._goals.publish(messages.poses(
        np.array([(50e-6, 0.0)]), np.zeros(1), messages.to_stamp(3.5)))
    loop.graph.until(lambda: loop.keep_seeing() or (
        'distance_um' in values(told) and bool(loop.fields) and loop.strength() > 1e-3))
    assert values(told)['goals_stamp_s'] == '3.5'
    assert float(values(told)['distance_um']) == pytest.approx(50, abs=1)
    assert values(told)['done'] == 'False'
    loop.go()
    loop.graph.until(lambda: loop.keep_seeing() or values(told)['goals'] == '0')
    loop.graph.until(lambda: loop.keep_seeing() or loop.strength() == 0)


def test_the_list_of_controllers_tells_what_each_takes(ros: Any) -> None:
    loop = Loop(ros)
    listed = conforming('controller/list_controllers', loop.graph.call(
        Trigger, 'controller/list_controllers', Trigger.Request()).message)
    takes = {one['name']: set(one['takes']) for one in listed}
    assert [one['name'] for one in listed if one['state'] == 'active'] == ['hold']
    assert takes['hold'] == takes['manual'] == takes['open_loop'] == set()
    assert takes['waypoint'] == {'goals', 'particle_goals'}
    assert (takes['path_following'], takes['experiment'], takes['teleop']) == (
        {'path'}, {'plan'}, {'joystick'})


def test_viewers_get_particles_and_goals(ros: Any) -> None:
    loop = Loop(ros, controller='waypoint')
    drawn = loop.graph.hear(MarkerArray, 'markers')
    loop.go((50e-6, 20e-6), (math.nan, 0.0))
    loop.graph.until(lambda: len(loop.node.stage.goals) == 2)
    loop.graph.until(lambda: loop.see(x=1e-5) or drawn)
    by_name = {marker.ns: marker for marker in drawn[-1].markers}
    assert [point.x for point in by_name['goals'].points] == pytest.approx([50e-6])
    assert [point.x for point in by_name['particles'].points] == pytest.approx([1e-5])
    assert by_name['labels'].text == '0: 4.0 µm/s'


def test_what_became_of_goals_is_not_said_of_the_next(ros: Any) -> None:
    """New goals are answered at once, also where no pose comes that could be acted on."""
    loop = Loop(ros, controller='waypoint', delay_ms=0.0)
    told = loop.graph.hear(DiagnosticStatus, 'controller/progress')
    loop.go((1e-6, 0.0))
    loop.graph.until(lambda: loop.keep_seeing() or values(told).get('done') == 'True')
    goals = messages.poses(np.array([(90e-6, 0.0)]), np.zeros(1), messages.to_stamp(8.25))
    loop._goals.publish(goals)
    loop.graph.until(lambda: values(told)['goals_stamp_s'] == '8.25')
    assert 'done' not in values(told)
    assert 'no poses since' in told[-1].message
    path = loop.graph.talk(Path, 'path')
    path.publish(Path(header=goals.header))
    loop.graph.until(lambda: values(told)['path_stamp_s'] == '8.25')
class Stick:
    """A joystick driver: says where the stick is, and when that was."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._joy = loop.graph.talk(Joy, 'joy')

    def push(self, *axes: float, ahead: float = 0.0, stamped: bool = True) -> float:
        """The stamp [s] of what was said."""
        now = self._loop.node.seconds() + ahead
        message = Joy(axes=list(axes))
        message.header.stamp = messages.to_stamp(now if stamped else 0.0)
        self._joy.publish(message)
        return now


@pytest.mark.parametrize('stamped', [True, False])
def test_a_joystick_that_dies_while_deflected_counts_as_centred(
        ros: Any, stamped: bool) -> None:
    """Judged at exposure, so that every frame is on one side of it: live or replayed."""
    loop = Loop(ros, controller='teleop')
    stick = Stick(loop)
    loop.graph.until(lambda: (stick.push(1.0, 0.0, stamped=stamped), loop.see(),
                              loop.fields and loop.strength() > 4.9e-3)[-1])
    last = stick.push(0.0, 1.0, stamped=stamped)
    loop.graph.until(lambda: loop.keep_seeing() or loop.fields[-1].vector.y > 4.9e-3)
    since = len(loop.fields)
    loop.graph.until(lambda: loop.keep_seeing() or loop.strength() == 0)
    count = len(loop.fields)
    loop.graph.until(lambda: loop.keep_seeing() or len(loop.fields) > count + 10)
    slack = 0.0 if stamped else 0.1  # without a stamp its arrival counts
    for field in loop.fields[since:]:
        age = messages.to_seconds(field.header.stamp) - last
        if age <= 0.25 - 1e-6 or age > 0.25 + slack + 1e-6:
            assert math.hypot(field.vector.x, field.vector.y) == pytest.approx(
                5e-3 if age <= 0.25 else 0.0)
    _, sentence, _ = loop.node.health()
    assert re.search(r'the joystick sent no message for \d\.\d\d s: treated as centred', sentence)
    assert 'the joystick sent no message' in loop.node._complaint
    loop.graph.until(lambda: (stick.push(-1.0, 0.0), loop.see(),
                              loop.fields[-1].vector.x < -4.9e-3)[-1])
    assert 'joystick' not in loop.node.health()[1]


@pytest.mark.parametrize('axes', [
    (math.nan, 1.0), (1.0, math.nan), (math.inf, 0.0), (0.0, -math.inf), (1.0,), ()])
def test_a_joystick_that_says_no_number_counts_as_centred(
        ros: Any, axes: tuple[float, ...]) -> None:
    loop = Loop(ros, controller='teleop')
    stick = Stick(loop)
    loop.graph.until(lambda: (stick.push(1.0, 1.0), loop.see(),
                              loop.fields and loop.strength() > 4.9e-3)[-1])
    stick.push(*axes)
    loop.graph.until(lambda: 'treated as centred' in loop.node._complaint)
    last = loop.node.seconds()
    loop.graph.until(lambda: loop.keep_seeing() or messages.to_seconds(
        loop.fields[-1].header.stamp) > last + 0.04)
    assert loop.strength() == 0
    assert loop.node.stage.manager.fault == ''


def test_a_joystick_ahead_of_its_time_does_not_live_longer(ros: Any) -> None:
    """An hour ahead: its stamp alone would keep it fresh for that long."""
    loop = Loop(ros, controller='teleop')
    stick = Stick(loop)
    loop.graph.until(lambda: (stick.push(1.0, 0.0, ahead=3600.0), loop.see(),
                              loop.fields and loop.strength() > 4.9e-3)[-1])
    loop.graph.until(lambda: loop.keep_seeing() or loop.strength() == 0)


def drive_slowly(ros: Any, **parameters: Any) -> Loop:
    """At full field, which only changes by 0.5 mT a frame, at most by 2 mT a gap."""
    loop = Loop(ros, controller='open_loop', slew_mT_per_s=20.0, border_s=0.0, **parameters)
    loop.graph.until(lambda: loop.keep_seeing() or (loop.fields and loop.strength() > 4.9e-3))
    return loop


def go_quiet(loop: Loop) -> None:
    """No frames until the controller has let go."""
    loop.graph.until(lambda: loop.strength() == 0)


def get_an_old_pose(loop: Loop) -> None:
    """It comes in between, from a camera that is late."""
    loop.see(age=3.0)
    go_quiet(loop)


def be_deactivated(loop: Loop) -> None:
    """And activated."""
    loop.node.trigger_deactivate()
    go_quiet(loop)
    loop.node.trigger_activate()


def be_cleaned_up(loop: Loop) -> None:
    """And set up again."""
    loop.node.trigger_deactivate()
    loop.node.trigger_cleanup()
    go_quiet(loop)
    loop.node.trigger_configure()
    loop.node.trigger_activate()
    loop.graph.until(lambda: loop._state.get_subscription_count() == 1)


def stumble(loop: Loop) -> None:
    """A cloud with a kind of number that there is not, which is an exception in a callback."""
    cloud = messages.cloud(np.zeros(1, ESTIMATE), messages.to_stamp(loop.node.seconds()))
    cloud.fields[0].datatype = 99
    loop._state.publish(cloud)
    go_quiet(loop)


@pytest.mark.parametrize('controller', ['open_loop', 'hold'])
@pytest.mark.parametrize(
    'interrupt', [go_quiet, get_an_old_pose, be_deactivated, be_cleaned_up, stumble])
def test_the_first_command_after_letting_go_starts_from_zero(
        ros: Any, interrupt: Any, controller: str) -> None:
    loop = drive_slowly(ros)
    interrupt(loop)
    assert 'driving' not in loop.node.health()[1]
    assert loop.set(controller=controller).successful
    zeros = len(loop.fields)
    loop.graph.until(lambda: loop.see() or len(loop.fields) > zeros)
    first = loop.fields[zeros].vector
    assert math.hypot(first.x, first.y) <= 0.02 * 0.1 * (controller != 'hold')
    if controller != 'hold':
        loop.graph.until(lambda: loop.keep_seeing() or loop.strength() > 4.9e-3)


def test_rollers_are_told_that_the_field_no_longer_turns(ros: Any) -> None:
    loop = Loop(ros, controller='open_loop', open_loop__frequency_hz=2.0, border_s=0.0)
    rotating = loop.graph.hear(TwistStamped, 'field/rotating')
    loop.graph.until(lambda: loop.keep_seeing() or (
        rotating and abs(rotating[-1].twist.angular.y) > 12.0))
    count = len(loop.fields)
    loop.graph.until(lambda: len(loop.fields) > count)
    assert loop.fields[-1].vector.x == loop.fields[-1].vector.y == 0


def test_a_controller_that_was_held_up_acts_on_the_newest(ros: Any) -> None:
    """Thirty states came while it was: none of them is worked through but the last."""
    loop = Loop(ros)
    loop.graph.until(lambda: loop.see() or loop.fields)
    loop.graph.until(lambda: loop.node.seconds() - messages.to_seconds(
        loop.fields[-1].header.stamp) > 0.1)  # all that was under way has come
    count = len(loop.fields)
    for _ in range(30):  # nobody spins meanwhile
        loop.see()
    newest = loop.node.seconds()
    loop.graph.until(lambda: len(loop.fields) > count and messages.to_seconds(
        loop.fields[-1].header.stamp) > newest - 5e-3)
    assert len(loop.fields) - count <= 2


@pytest.mark.parametrize(('values', 'said'), [
    ({'open_loop.field_mT': 1.5, 'waypoint.arrival_um': -1.0}, 'arrival_um'),
    ({'open_loop.field_mT': 1.5, 'open_loop.durations_s': [1.0, 2.0]}, 'one duration per dir'),
    ({'waypoint.arrival_um': 3.0, 'open_loop.field_mT': 1.5, 'open_loop.durations_s': [1.0]},
     'one duration per dir'),
    ({'open_loop.field_mT': 1.5, 'open_loop.durations_s': [1.0], 'waypoint.arrival_um': 3.0},
     'one duration per dir'),
    ({'open_loop.field_mT': 1.5, 'workspace_um': [0.0, 0.0, 1.0, 1.0]}, 'read-only'),
    ({'open_loop.field_mT': 1.5, 'delay_ms': -1.0}, 'delay_ms'),
    ({'open_loop.field_mT': 1.5, 'use_sim_time': 'yes'}, ''),
    ({'open_loop.field_mT': 1.5, 'controller': 'steam'}, "no controller 'steam'"),
    ({'open_loop.field_mT': 1.5, 'model_file': '/nowhere.yaml'}, '/nowhere.yaml'),
    ({'controller': 'waypoint', 'waypoint.arrival_um': -1.0}, 'arrival_um'),
    ({'controller': 'waypoint', 'waypoint.arrival_um': 3.0, 'open_loop.durations_s': [1.0]},
     'one duration per dir')])
@pytest.mark.parametrize('atomically', [True, False])
def test_what_the_node_says_and_what_runs_are_the_same(
        ros: Any, values: dict[str, Any], said: str, atomically: bool) -> None:
    loop = Loop(ros, controller='open_loop')
    loop.graph.until(lambda: loop.see() or loop.fields)
    parameters = [Parameter(name, value=value).to_parameter_msg()
                  for name, value in values.items()]
    if atomically:
        results = [loop.graph.call(
            SetParametersAtomically, 'controller/set_parameters_atomically',
            SetParametersAtomically.Request(parameters=parameters)).result]
    else:
        results = loop.graph.call(SetParameters, 'controller/set_parameters',
                                  SetParameters.Request(parameters=parameters)).results
    refused = [result for result in results if not result.successful]
    assert len(refused) == 1
    assert said in refused[0].reason
    board, told = loop.node.stage.manager, loop.node.get_parameter
    for name in ('open_loop', 'waypoint'):
        for field, runs in vars(board._threads[name]._controller.parameters).items():
            parameter = told(f'{name}.{field}').value
            assert (list(parameter) if isinstance(runs, list) else parameter) == runs
            if atomically:
                assert runs == getattr(type(board._threads[name]._controller).Parameters(), field)
    assert board.active == told('controller').value == loop.node.settings.controller
    assert board.active == 'open_loop' or not atomically
    if atomically:
        loop.graph.until(lambda: loop.keep_seeing() or loop.strength() > 4.9e-3)


def test_a_set_that_is_refused_does_not_restart_after_a_fault(
        ros: Any, monkeypatch: Any) -> None:
    def breaks(*_: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(OpenLoop, 'compute', breaks)
    loop = Loop(ros, controller='open_loop')
    loop.graph.until(lambda: loop.keep_seeing() or loop.node.stage.manager.fault)
    monkeypatch.undo()
    request = SetParametersAtomically.Request(parameters=[
        Parameter(name, value=value).to_parameter_msg()
        for name, value in {'controller': 'open_loop', 'waypoint.arrival_um': -1.0}.items()])
    assert not loop.graph.call(SetParametersAtomically, 'controller/set_parameters_atomically',
                               request).result.successful
    assert loop.node.stage.manager.fault


def test_a_state_in_another_frame_is_not_acted_on(ros: Any) -> None:
    loop = Loop(ros, controller='open_loop')
    cloud = messages.cloud(np.zeros(1, ESTIMATE), messages.to_stamp(loop.node.seconds()))
    cloud.header.frame_id = 'camera'
    loop._state.publish(cloud)
    loop.graph.until(lambda: "expected the frame 'workspace'; received 'camera'"
                     in loop.node._complaint)
    assert not loop.fields


def test_the_heading_is_that_of_the_same_frame(ros: Any, monkeypatch: Any) -> None:
    """And not known in a state of before it was carried."""
    seen: list[np.ndarray] = []
    monkeypatch.setattr(OpenLoop, 'compute',
                        lambda _, inputs: seen.append(inputs.theta) or no_field(''))
    loop = Loop(ros, controller='open_loop')
    point = np.zeros(2, ESTIMATE)
    point['id'], point['theta'] = [4, 7], [1.5, np.nan]
    loop._state.publish(messages.cloud(point, messages.to_stamp(loop.node.seconds())))
    loop.graph.until(lambda: seen)
    assert seen[-1] == pytest.approx([1.5, np.nan], nan_ok=True)
    before = [name for name in ESTIMATE.names or () if name != 'theta']
    loop._state.publish(messages.cloud(repack_fields(point[before]), messages.to_stamp(
        loop.node.seconds())))
    loop.graph.until(lambda: len(seen) == 2)
    assert np.isnan(seen[-1]).all()


def test_frames_that_overtake_each_other_give_the_field_no_time(ros: Any) -> None:
    """By turns 0.1 s old and new: to and fro, they would let it change by 2 mT each time."""
    loop = Loop(ros, controller='open_loop', slew_mT_per_s=20.0, border_s=0.0,
                pose_timeout_ms=1000.0)
    loop.graph.until(lambda: loop.keep_seeing() or (loop.fields and loop.strength() > 2.5e-3))
    begun = len(loop.fields) - 1
    for age in 10 * [0.1, 0.0]:
        count = len(loop.fields)
        loop.see(age=age)
        loop.graph.until(lambda count=count: len(loop.fields) > count)
    stamps = [messages.to_seconds(field.header.stamp) for field in loop.fields[begun:]]
    strengths = np.array([field.vector.x for field in loop.fields[begun:]])
    newest = np.maximum.accumulate(stamps)
    assert (np.diff(strengths) <= 0.02 * np.diff(newest) + 1e-9).all()
    assert strengths[-1] > strengths[0]
