"""The controller node: swapped by a parameter, silent when poses stop, safe when it fails."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseArray, PoseStamped, Vector3Stamped
from nav_msgs.msg import Path
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from microbot_ros.control.open_loop import OpenLoop
from microbot_ros.nodes import messages
from microbot_ros.nodes.lifecycle import LATCHED


class Loop:
    """A controller node, and a model that says what the test wants."""

    def __init__(self, ros: Any, **parameters: Any) -> None:
        # A shared machine may pause for longer than a controller may think.
        self.graph = ros({'controller': {'deadline_ms': 200.0, **parameters}})
        self.node = self.graph.add('controller')
        assert self.node.active, self.node.fault
        self.fields = self.graph.hear(Vector3Stamped, 'field/command')
        self._state = self.graph.probe.create_publisher(PointCloud2, 'model/state', 10)
        self._goals = self.graph.probe.create_publisher(PoseArray, 'goals', 10)
        self._next_frame = 0.0
        self.graph.until(lambda: self._state.get_subscription_count() == 1)

    def see(self, x: float = 0.0, y: float = 0.0, age: float = 0.0, phi: float = 0.5) -> None:
        """One particle, whose v and φ are known."""
        point = np.zeros(1, messages.ESTIMATE)
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
    loop.graph.until(lambda: len(loop.node._goals) == 1)
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
    loop.graph.until(lambda: loop.node._last_t < loop.node.seconds() - 4)
    assert len(loop.fields) == count


@pytest.mark.parametrize('place', [(math.nan, 0.0), (math.inf, 0.0), (1.0, 1.0)])
def test_a_goal_that_cannot_be_is_refused_with_zero(
        ros: Any, place: tuple[float, float]) -> None:
    loop = Loop(ros, controller='waypoint')
    loop.go(place)
    loop.graph.until(lambda: len(loop.node._goals) == 1)
    loop.graph.until(lambda: loop.see() or loop.fields)
    level, sentence, values = loop.node.health()
    assert loop.strength() == 0
    assert level == b'\x01'
    assert values['result'] == 'bad goal'
    assert sentence.startswith('waypoint: ')


def test_a_pose_that_is_no_number_is_not_acted_on(ros: Any) -> None:
    loop = Loop(ros, controller='waypoint')
    loop.go((50e-6, 0.0))
    loop.graph.until(lambda: len(loop.node._goals) == 1)
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
        return {pair.key: pair.value for pair in told[-1].values}

    def go(particle: int, x: float) -> None:
        goal = np.array([(particle, x, 0.0)], messages.GOAL)
        sent.publish(messages.cloud(goal, messages.to_stamp(7.5)))

    go(4, 50e-6)
    assert answer(lambda said: 'particle 4 is not seen' in said)['result'] == 'particle lost'
    go(0, 5e-3)
    assert answer(lambda said: 'outside the workspace' in said)['result'] == 'bad goal'
    go(0, 1e-6)
    values = answer(lambda said: 'goal 1 of 1' in said)
    assert (values['done'], values['goals_stamp_s']) == ('True', '7.5')
    elsewhere = PoseStamped()
    elsewhere.header.frame_id = 'map'
    clicked.publish(elsewhere)
    loop.graph.until(lambda: "expected the frame 'workspace'; received 'map'"
                     in loop.node._complaint)
    assert len(loop.node._goals) == 1
    loop.go()
    assert answer(lambda said: 'waits for a goal' in said)['goals'] == '0'


def test_paths_that_are_none_and_the_border(ros: Any) -> None:
    loop = Loop(ros, controller='path_following')
    path = loop.graph.probe.create_publisher(Path, 'path', 10)
    loop.graph.until(lambda: path.get_subscription_count() == 1)

    def follow(places: list[tuple[float, float]], said: str) -> None:
        message = Path()
        for x, y in places:
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.position.y = x, y
            message.poses.append(pose)
        path.publish(message)
        loop.graph.until(lambda: loop.see() or (loop.fields and said in loop.node.health()[1]))
        assert loop.strength() == 0

    follow([], 'waits for a path')
    follow([(0.0, 0.0)], 'two different points')
    follow([(0.0, 0.0), (math.nan, 0.0)], 'the path leaves the workspace')
    assert loop.set(controller='open_loop').successful
    loop.graph.until(lambda: loop.see(x=140e-6, phi=0.0) or loop.strength() > 4.9e-3)
    assert 'about to leave the view' in loop.node.health()[1]


def test_naming_a_controller_again_restarts_it_after_a_fault(ros: Any, monkeypatch: Any) -> None:
    def breaks(*_: Any) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as broken:
        broken.setattr(OpenLoop, 'compute', breaks)
        loop = Loop(ros, controller='open_loop')
        loop.graph.until(lambda: loop.keep_seeing() or loop.node._switchboard.fault)
    assert 'ZeroDivisionError' in loop.node.health()[1]
    assert loop.set(open_loop__field_mT=4.0).successful
    assert loop.node._switchboard.fault
    assert loop.set(controller='open_loop').successful
    loop.graph.until(lambda: loop.keep_seeing() or (loop.fields and loop.strength() > 3.9e-3))


def test_what_there_is_is_latched(ros: Any) -> None:
    loop = Loop(ros)
    listed = loop.graph.hear(String, 'controller/controllers', LATCHED)
    loop.graph.until(lambda: listed)
    assert {'hold', 'open_loop', 'waypoint'} <= set(yaml.safe_load(listed[0].data))


def test_viewers_get_particles_and_goals(ros: Any) -> None:
    loop = Loop(ros)
    drawn = loop.graph.hear(MarkerArray, 'markers')
    loop.go((50e-6, 20e-6), (math.nan, 0.0))
    loop.graph.until(lambda: len(loop.node._goals) == 2)
    loop.graph.until(lambda: loop.see(x=1e-5) or drawn)
    by_name = {marker.ns: marker for marker in drawn[-1].markers}
    assert [point.x for point in by_name['goals'].points] == pytest.approx([50e-6])
    assert [point.x for point in by_name['particles'].points] == pytest.approx([1e-5])
    assert by_name['labels'].text == '0: 4.0 µm/s'


def test_each_keeps_its_parameters(ros: Any) -> None:
    loop = Loop(ros)
    assert loop.set(waypoint__arrival_um=3.0).successful
    assert not loop.set(waypoint__arrival_um=math.nan).successful
    assert not loop.set(waypoint__arrival_um=-1.0).successful
    assert loop.set(controller='waypoint').successful
    assert loop.set(controller='hold').successful
    answer = loop.set(waypoint__arrival_um=3.0)
    assert answer.successful
    assert loop.node._switchboard._runners['waypoint']._parameters.arrival_um == 3.0


def test_what_became_of_goals_is_not_said_of_the_next(ros: Any) -> None:
    """New goals are answered at once, also where no pose comes that could be acted on."""
    loop = Loop(ros, controller='waypoint', delay_ms=0.0)
    told = loop.graph.hear(DiagnosticStatus, 'controller/progress')

    def values() -> dict[str, str]:
        return {pair.key: pair.value for pair in told[-1].values} if told else {}
    loop.go((1e-6, 0.0))
    loop.graph.until(lambda: loop.keep_seeing() or values().get('done') == 'True')
    goals = messages.poses(np.array([(90e-6, 0.0)]), np.zeros(1), messages.to_stamp(8.25))
    loop._goals.publish(goals)
    loop.graph.until(lambda: values()['goals_stamp_s'] == '8.25')
    assert 'done' not in values()
    assert 'no poses since' in told[-1].message
    path = loop.graph.probe.create_publisher(Path, 'path', 10)
    loop.graph.until(path.get_subscription_count)
    path.publish(Path(header=goals.header))
    loop.graph.until(lambda: values()['path_stamp_s'] == '8.25')
