"""An ONNX policy drives the loop; a file that is no such policy is refused in one line."""

import math
import runpy
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import yaml
from onnx import TensorProto, helper, numpy_helper

from microbot_ros.common.errors import InputError
from microbot_ros.control.contract import Goals, ModelError, Result
from microbot_ros.control.deadline_worker import UnhurriedWorker
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.hold import Hold
from microbot_ros.control.plugins.policy import Policy, PolicyParameters
from microbot_ros.control.testkit import controller_input, exercise
from microbot_ros.virtual_rig import simulation
from microbot_ros.virtual_rig.scenario import read_scenario

EXAMPLE = runpy.run_path(
    str(Path(__file__).parents[2] / 'docs/examples/train_policy.py'), run_name='example')
GOALS = Goals(np.array([[20e-6, 10e-6]]))


@pytest.fixture
def proportional(tmp_path):
    """A policy for one particle that goes straight to its goal."""
    path = tmp_path / 'policy.onnx'
    EXAMPLE['export'](EXAMPLE['policy'](np.array([[4.0, 0.0]])), path)
    return path


def network(path, inputs=((1, 9),), output=(1, 2), element=TensorProto.FLOAT, fill=0.0):
    """A network that answers always the same."""
    value = numpy_helper.from_array(np.full(output, fill, np.float32))
    graph = helper.make_graph(
        [helper.make_node('Constant', [], ['action'], value=value)], 'policy',
        [helper.make_tensor_value_info(f'in{k}', element, list(shape))
         for k, shape in enumerate(inputs)],
        [helper.make_tensor_value_info('action', TensorProto.FLOAT, list(output))])
    onnx.save(helper.make_model(
        graph, ir_version=10, opset_imports=[helper.make_opsetid('', 21)]), path)
    return path


def policy(path):
    made = Policy()
    made.configure(PolicyParameters(file=str(path)))
    return made


def manager(path):
    return ControllerManager(
        {'policy': policy(path), 'hold': Hold()}, 'policy', worker=UnhurriedWorker)


def test_it_reaches_its_goal_in_the_whole_loop(tmp_path, proportional):
    path = tmp_path / 'scenario.yaml'
    path.write_text(yaml.safe_dump({
        'duration_s': 16, 'seed': 1, 'radius_um': 2.3, 'reference_field_mT': 5.0,
        'fluid': {'viscosity_mPa_s': 1.245},
        'camera': {'frame_rate_hz': 30, 'localisation_um': 0.1},
        'particles': [{'x_um': 0, 'y_um': 10, 'v_um_s': 3.71, 'phi_rad': -1.09}],
        'controller': {'name': 'policy', 'goals_um': [[20, -10]],
                       'parameters': {'file': str(proportional)}}}), encoding='utf-8')
    scenario, particles = read_scenario(path)
    first, second = (simulation.run(scenario, particles, str(path)) for _ in range(2))
    away = np.hypot(*(first.tracks.position - [20e-6, -10e-6]).T)
    assert away.min() < 2e-6
    assert away[-1] < 8e-6  # it stays about the goal, on a triangle
    assert first.commands.field.tobytes() == second.commands.field.tobytes()


def test_with_a_policy_it_keeps_the_contract(proportional):
    class Playing(Policy):
        def configure(self, parameters):
            super().configure(PolicyParameters(file=str(proportional)))

    exercise(Playing)


def test_the_action_is_the_field(proportional):
    shown = controller_input(1, goals=GOALS, dt=1.0)
    command = manager(proportional).tick(shown).command
    way = (GOALS.position - shown.position)[0] @ [1, 1j] / np.exp(1j * shown.phi[0])
    assert command.field @ [1, 1j] == pytest.approx(5e-3 * way / abs(way), rel=1e-5)
    assert command.particles.tolist() == [0]
    assert command.progress.message == '0 of 1 particles have reached their goals'


def test_at_the_last_goal_it_is_done_and_goes_round_a_triangle(proportional):
    playing = manager(proportional)
    shown = controller_input(1, dt=1.0)
    fields = []
    for k in range(3):
        outcome = playing.tick(controller_input(
            1, t=1.1 * k, dt=0.1, goals=Goals(shown.position)))
        assert outcome.command.progress.done
        fields.append(outcome.command.field)
    assert np.sum(fields, axis=0) == pytest.approx(np.zeros(2), abs=1e-12)


def test_until_it_is_known_how_particles_answer_the_field_goes_round_a_triangle(proportional):
    unknown = {'speed': np.array([np.nan]), 'phi': np.array([np.nan]),
               'speed_std': np.array([np.inf]), 'phi_std': np.array([np.inf])}
    outcome = manager(proportional).tick(controller_input(1, goals=GOALS, dt=1.0, **unknown))
    assert outcome.command.progress.message == 'learns how particles answer to the field'
    assert outcome.command.field == pytest.approx([5e-3, 0])


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf])
def test_an_answer_that_is_no_number_commands_nothing_and_is_no_fault(tmp_path, value):
    playing = manager(network(tmp_path / 'odd.onnx', fill=value))
    for k in range(2):
        outcome = playing.tick(controller_input(1, t=k / 30, goals=GOALS))
        assert outcome.result is Result.NO_SOLUTION
        assert not outcome.command.field.any()
        assert outcome.message.startswith('the policy returned [')
    assert playing.fault == ''


def test_it_wants_as_many_goals_as_it_was_trained_with(proportional):
    two = Goals(np.array([[20e-6, 10e-6], [0, 0]]))
    outcome = manager(proportional).tick(controller_input(3, goals=two))
    assert outcome.result is Result.BAD_GOAL
    assert outcome.message == 'the policy is for 1 particles with a goal each; received 2 goals'
    named = Goals(GOALS.position, np.array([7]))
    assert manager(proportional).tick(
        controller_input(3, goals=named)).result is Result.PARTICLE_LOST


def test_without_a_file_it_does_not_take_over():
    playing = ControllerManager({'hold': Hold(), 'policy': Policy()}, 'hold',
                                worker=UnhurriedWorker)
    playing.tick(controller_input())
    assert playing.switch_controller('policy').message == "policy: 'file' names no ONNX file"
    with pytest.raises(ModelError):
        Policy().compute(controller_input(1, goals=GOALS))


@pytest.mark.parametrize(('made', 'reason'), [
    (lambda path: path, r'expected a readable ONNX file \(No such file or directory\)'),
    (lambda path: path.write_bytes(b'no network') and path, r'expected an ONNX file \(.*'),
    (lambda path: network(path, [(1, 8)]), r'expected an input of 2 \+ 7 .*; found 8'),
    (lambda path: network(path, [(1, 2)]), r'expected an input of 2 \+ 7 .*; found 2'),
    (lambda path: network(path, [(1, 9), (1, 9)]), 'expected one input, float .*'),
    (lambda path: network(path, [(4, 9)]), r'expected one input, .*tensor\(float\) .*4, 9.*'),
    (lambda path: network(path, [(9,)]), 'expected one input, .*'),
    (lambda path: network(path, element=TensorProto.DOUBLE), r'.*found tensor\(double\).*'),
    (lambda path: network(path, output=(1, 3)), r'expected one output \(1, 2\);.* \(1, 3\)'),
    (lambda path: network(path, output=(2,)), r'expected one output \(1, 2\); found \(2,\)')])
def test_another_file_is_refused_in_one_line(tmp_path, proportional, made, reason):
    playing = policy(proportional)
    path = made(tmp_path / 'other.onnx')
    with pytest.raises(InputError, match=rf'^{path}: {reason}$'):
        playing.configure(PolicyParameters(file=str(path)))
    assert playing.parameters.file == str(proportional)


@pytest.mark.parametrize('batch', ['batch', None])
def test_a_batch_of_any_size_is_as_good_as_one(tmp_path, batch):
    assert policy(network(tmp_path / 'policy.onnx', [(batch, 16)]))._policy.particles == 2


def test_without_onnxruntime_one_line_names_the_extra(monkeypatch, proportional):
    monkeypatch.setitem(sys.modules, 'onnxruntime', None)
    with pytest.raises(InputError, match=r'pip install microbot_ros\[onnx\]$'):
        policy(proportional)
