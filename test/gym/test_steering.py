"""The environment is Gymnasium's, its loop is the rig's, and no action gets past the limits."""

import dataclasses
import math
import runpy
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import yaml
from gymnasium.utils.env_checker import check_env

import microbot_ros.gym
from microbot_ros.common.errors import InputError
from microbot_ros.control.contract import Controller, FieldCommand, Goals, NoSolutionError
from microbot_ros.control.deadline_worker import UnhurriedWorker
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.policy import Policy
from microbot_ros.control.policy_task import PolicyTask, wanted_field
from microbot_ros.control.testkit import controller_input
from microbot_ros.drive.gate import Gate, Reason
from microbot_ros.loop.allocation import AllocationStage, GateParameters, limits
from microbot_ros.virtual_rig.coil_gradients import coil_gradients
from microbot_ros.virtual_rig.dynamics import advance_worlds
from microbot_ros.virtual_rig.world import FieldHistory, World

STEERING = 'microbot_ros/Steering-v0'
CONFIG = Path(__file__).parents[2] / 'config'
SCENARIO = yaml.safe_load((CONFIG / 'scenario_closed_loop.yaml').read_text(encoding='utf-8'))


def make(**arguments):
    return gymnasium.make(STEERING, **arguments).unwrapped


def scenario(tmp_path, **sections):
    path = tmp_path / 'scenario.yaml'
    path.write_text(yaml.safe_dump(SCENARIO | sections), encoding='utf-8')
    return path


def to_the_first_goal(shown):
    """The action towards the goal of the first particle that has not been at its own."""
    ways = shown[2:].reshape(-1, 7)
    way = ways[np.flatnonzero(ways[:, 6])[0], :2]
    return way / np.hypot(*way)


def play(env, seed=None, act=to_the_first_goal, **options):
    """All that the steps of one episode gave."""
    shown, _ = env.reset(seed=seed, options=options)
    steps = []
    while not (steps and (steps[-1][2] or steps[-1][3])):
        steps.append(env.step(act(shown)))
        shown = steps[-1][0]
    return steps


def test_gymnasium_finds_nothing_wrong_with_it():
    check_env(make())


def test_the_same_seed_gives_the_same_episode():
    rng = np.random.default_rng(3)
    actions = rng.uniform(-1, 1, (300, 2))
    for seed, same in ((7, True), (8, False)):
        one, other = make(), make()
        first, second = one.reset(seed=7)[0], other.reset(seed=seed)[0]
        for action in actions:
            if not same:
                break
            a, b = one.step(action), other.step(action)
            assert a[0].tobytes() == b[0].tobytes()
            assert a[1:] == b[1:]
        assert (first.tobytes() == second.tobytes()) == same


def test_goals_are_reached_one_after_the_other_and_end_the_episode():
    env = make()
    start, _ = env.reset(seed=2)
    left = sum(np.hypot(*one[:2]) * np.hypot(*one[4:6]) * 3 for one in start[2:].reshape(-1, 7))
    steps = play(env, seed=2)
    *_, terminated, truncated, info = steps[-1]
    assert (terminated, truncated) == (True, False)
    assert info['is_success']
    assert info['reached'] == 2
    assert [step[4]['reached'] for step in steps].count(1) > 30
    # Ways are in 30 s and speeds in 10 µm/s, so that their product is in 300 µm.
    assert sum(step[1] for step in steps) == pytest.approx(
        2 + left - info['t_s'] / 60, abs=1e-5)


@pytest.mark.parametrize('action', [
    (0, 0), (1, 1), (-1, 0.999), (1e-30, 0), (1e30, -1e30), (1e300, 1e300), (0.6, 0.8)])
def test_the_field_stays_within_its_limit(action):
    env = make()
    env.reset(seed=1)
    shown = env.step(np.array(action))[0]
    assert np.hypot(*shown[:2]) == pytest.approx(min(math.hypot(*action), 1), abs=1e-6)
    assert np.hypot(*shown[:2]) <= 1 + 1e-6


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize('place', [0, 1])
def test_an_action_that_is_no_number_is_no_field(value, place):
    env = make()
    env.reset(seed=1)
    assert env.step(np.array([1.0, 0.0]))[0][0] == pytest.approx(1)
    action = np.zeros(2)
    action[place] = value
    shown, reward, *_, info = env.step(action)
    assert shown[:2].tolist() == [0, 0]
    assert math.isfinite(reward)
    assert 'the policy returned' in info['reason']
    shown, *_, info = env.step(np.array([0.0, 1.0]))
    assert shown[1] == pytest.approx(1)
    assert info['reason'] == ''


@pytest.mark.parametrize('action', [0.0, [1.0], [1.0, 0.0, 0.0], [[1.0, 0.0]]])
def test_an_action_of_another_shape_is_refused(action):
    env = make()
    env.reset(seed=1)
    with pytest.raises(ValueError, match=r'expected an action \(2,\)'):
        env.step(np.array(action))


class Agent(Controller):
    """Asks for what it is told to ask for."""

    interface_version = 1
    summary = 'Asks.'
    action = np.zeros(2)

    def compute(self, inputs):
        field = wanted_field(self.action, inputs.limits.field)
        if not np.isfinite(field).all():
            raise NoSolutionError('no number')
        return FieldCommand(field)


@pytest.mark.parametrize('most_mT', [5.0, 40.0])  # 80 mT are more than the slew lets one frame go
def test_what_flows_is_what_flows_in_the_loop(tmp_path, most_mT):
    path = scenario(tmp_path, spread_um=100, controller={'name': 'hold', 'max_field_mT': 5.0})
    env, agent, rng = make(scenario=path), Agent(), np.random.default_rng(3)
    worlds = env.worlds
    worlds.limits = dataclasses.replace(worlds.limits, field=most_mT * 1e-3)
    allocation, odd = AllocationStage(GateParameters()), 0
    for seed in range(12):
        env.reset(seed=seed)
        worlds.seen[0, 0] = worlds.bodies['x'][0, 0], worlds.bodies['y'][0, 0] = [
            139.5e-6, 103.5e-6] if seed % 2 else [0, 0]
        gate = Gate(limits(GateParameters()))
        gate.measured((0.0,) * 4, 0.0)
        gate.arm(0.0)
        manager = ControllerManager({'agent': agent}, 'agent', worker=UnhurriedWorker)
        for k in range(20):
            action = rng.normal(0, 1, 2) if k % 7 else np.array([1.0, np.nan])
            inputs, agent.action = worlds.inputs(0), action
            outcome = manager.tick(inputs)
            currents = gate.command(allocation.step(outcome.command.field).tolist(), inputs.t)
            gate.measured(currents, inputs.t)
            *_, info = env.step(action)
            odd += bool(info['reason'])
            wanted = outcome.command.field
            assert worlds.commanded[0] == pytest.approx(wanted, rel=1e-14, abs=1e-17)
            assert worlds.gates[0].output == pytest.approx(currents, rel=1e-12, abs=1e-15)
            assert (worlds.gates[0].fault is None) == (gate.fault is None)
    assert odd > 40


def test_the_controller_is_shown_what_the_environment_shows():
    env, policy, seen = make(), Policy(), []

    class Recorder:
        particles = 2

        def answer(self, shown):
            seen.append(shown)
            return np.zeros(2)

    policy._policy = Recorder()
    manager = ControllerManager({'policy': policy}, 'policy', worker=UnhurriedWorker)
    shown, _ = env.reset(seed=5)
    for _ in range(40):
        assert manager.tick(env.worlds.inputs(0)).command is not None
        shown_before, (shown, *_) = shown, env.step(np.zeros(2))
        assert seen[-1].tobytes() == shown_before.tobytes()
    assert len(seen) == 40


def test_the_order_of_particles_does_not_matter():
    goals = Goals(np.array([[3e-5, 0], [0, 2e-5], [-1e-5, 1e-5]]), np.array([0, 2, 1]))
    straight = controller_input(4, goals=goals)
    turned = np.array([2, 0, 3, 1])
    per_particle = {name: getattr(straight, name)[turned] for name in (
        'ids', 'position', 'speed', 'phi', 'expected')}
    shown = PolicyTask().observation(straight)
    again = PolicyTask().observation(controller_input(4, goals=goals, **per_particle))
    assert again.tobytes() == shown.tobytes()
    assert len(shown) == 2 + 7 * 3


def test_what_is_shown_is_what_it_says():
    position = np.array([[14.4e-6, -10.8e-6], [0.5e-6, 0.0]])
    shown = PolicyTask().observation(controller_input(
        2, position=position, speed=np.array([5e-6, 4e-6]), phi=np.array([math.pi / 2, 0.0]),
        field=np.array([0.0, -2.5e-3]), goals=Goals(np.array([[14.4e-6, 19.2e-6], [1e-6, 0.0]]))))
    assert shown == pytest.approx([
        0, -0.5, 0.2, 0, 0.1, -0.1, 0, 0.5, 1,  # 30 µm at 5 µm/s are 6 s along the field
        0, 0, 0.5 / 144, 0, 0.4, 0, 0], abs=1e-6)  # at its goal


def test_an_episode_is_cut_when_its_time_is_over(tmp_path):
    env = make(scenario=scenario(tmp_path, duration_s=1), particles=None)
    steps = play(env, seed=1)
    assert len(steps) == 30
    assert steps[-1][2:4] == (False, True)
    assert not steps[-1][4]['is_success']


def test_an_episode_is_cut_when_a_particle_leaves_the_workspace(tmp_path):
    drift = {'uniform_drift': {'wx_um_s': 40.0, 'wy_um_s': 0.0}}
    env = make(scenario=scenario(tmp_path, effects=drift), particles=None)
    steps = play(env, seed=1)
    assert steps[-1][2:4] == (False, True)
    assert 2 < steps[-1][4]['t_s'] < 4  # 100 µm at 40 µm/s


def test_an_episode_is_cut_when_the_gate_cuts_the_currents():
    env = make()
    shown, _ = env.reset(seed=1)
    env.step(to_the_first_goal(shown))
    env.worlds.gates[0].trip(Reason.DEVICE, 'smoke')
    *_, terminated, truncated, info = env.step(to_the_first_goal(shown))
    assert (terminated, truncated) == (False, True)
    assert info['reason'] == 'fault of the amplifier: smoke'
    env.reset()
    assert not env.step(to_the_first_goal(shown))[3]


def test_a_scenario_brings_particles_goals_and_effects(tmp_path):
    effects = {'command_delay': {'delay_s': 0.2}, 'speed_decay': {'tau_s': 100.0}}
    env = make(scenario=scenario(tmp_path, effects=effects), particles=None)
    env.reset(seed=1)
    bodies = env.worlds.bodies[0]
    assert bodies['x'] * 1e6 == pytest.approx([-60, 40])
    assert bodies['speed'] * 1e6 == pytest.approx([3.71, 4.38])
    assert bodies['delay'].tolist() == [0.2, 0.2]
    assert env.worlds.goals[0] * 1e6 == pytest.approx(np.array([[30, -20], [-20, -20]]))
    heading = bodies['heading'].copy()
    for k in range(12):
        env.step(np.array([1.0, 0.0]))
        aligned = np.abs(np.exp(1j * (bodies['heading'] - bodies['phi'])) - 1) < 0.3
        assert aligned.all() == (k >= 6), k  # the command of the first frame, 0.2 s later
    assert not np.array_equal(bodies['heading'], heading)
    assert (bodies['fuel'] < 1).all()


def test_effects_are_drawn_anew_for_each_episode():
    env = make(randomise={'uniform_drift': {'wx_um_s': (-1, 1), 'wy_um_s': (0.5, 0.5)}})
    drawn = []
    for seed in range(20):
        env.reset(seed=seed)
        drawn.append(env.worlds.bodies[0]['drift_x'][0] * 1e6)
        assert env.worlds.bodies[0]['drift_y'] * 1e6 == pytest.approx([0.5, 0.5])
    assert -1 <= min(drawn) < -0.4
    assert 0.4 < max(drawn) <= 1
    env.reset(options={'effects': {'uniform_drift': {'wx_um_s': 3.0}}})
    assert env.worlds.bodies[0]['drift_x'] * 1e6 == pytest.approx([3, 3])


def test_what_the_camera_misses_stays_where_it_was_seen(tmp_path):
    camera = {'frame_rate_hz': 30, 'localisation_um': 0.1, 'missed': 0.3, 'run': 2}
    env = make(scenario=scenario(tmp_path, camera=camera, duration_s=5), particles=None)
    steps = play(env, seed=4)
    places = np.array([step[0][4:6] for step in steps])
    still = (np.diff(places, axis=0) == 0).all(axis=1)
    assert 0.15 < still.mean() < 0.45


def test_other_numbers_of_particles_and_other_goals():
    env = make(particles=3)
    goals = [[10, 0], [0, 10], [-10, 0]]
    shown, info = env.reset(seed=1, options={'goals_um': goals})
    assert shown.shape == (2 + 7 * 3,)
    assert info == {'is_success': False, 'reached': 0, 't_s': 0.0, 'reason': ''}
    assert env.worlds.goals[0] == pytest.approx(np.array(goals) * 1e-6)


@pytest.mark.parametrize(('options', 'reason'), [
    ({'goals_um': [[0, 0]]}, r'expected 2 goals_um within the workspace; received \[\[0, 0\]\]'),
    ({'goals_um': [[0, 0], [999, 0]]}, 'expected 2 goals_um within the workspace'),
    ({'goals_um': [[0, 0], [math.nan, 0]]}, 'expected 2 goals_um within the workspace'),
    ({'goal': 1}, "unknown option 'goal'; expected goals_um or effects"),
    ({'effects': {'wind': {}}}, "unknown effect 'wind'")])
def test_options_that_cannot_be_are_refused(options, reason):
    with pytest.raises(ValueError, match=reason):
        make().reset(options=options)


@pytest.mark.parametrize(('arguments', 'reason'), [
    ({'controller': SCENARIO['controller'] | {'goals_um': [[0, 0]]}}, 'expected 2, one for each'),
    ({'camera': {'frame_rate_hz': 10}}, "'camera.frame_rate_hz': expected more than 13.3")])
def test_scenarios_that_cannot_be_are_refused(tmp_path, arguments, reason):
    with pytest.raises(InputError, match=reason):
        make(scenario=scenario(tmp_path, **arguments))


def test_a_scenario_with_commands_of_its_own_is_refused():
    with pytest.raises(InputError, match=r"scenario_plain.yaml: expected a 'controller'"):
        make(scenario=CONFIG / 'scenario_plain.yaml')


@pytest.mark.parametrize('ranges', [{'wx': (0, 1)}, {'wx_um_s': (0, math.nan)}])
def test_ranges_that_cannot_be_are_refused(ranges):
    with pytest.raises(ValueError, match='uniform_drift'):
        make(randomise={'uniform_drift': ranges})


def test_it_shows_the_microscopes_picture():
    env = make(render_mode='rgb_array')
    pictures = []
    for _ in range(2):
        env.reset(seed=1)
        env.step(np.array([1.0, 0.0]))
        pictures.append(env.render())
    assert pictures[0].shape == (480, 640, 3)
    assert pictures[0].dtype == np.uint8
    assert np.array_equal(*pictures)


def test_many_at_once_begin_anew_each_by_itself(tmp_path):
    path = scenario(tmp_path, duration_s=1, controller={'name': 'hold'})
    envs = gymnasium.make_vec(STEERING, num_envs=3, scenario=path)
    shown, _ = envs.reset(seed=1)
    assert envs.observation_space.contains(shown)
    assert shown.shape == (3, 16)
    envs.unwrapped.worlds.goals[1] = envs.unwrapped.worlds.seen[1]
    ends = []
    for k in range(64):
        shown, rewards, done, cut, info = envs.step(np.tile([1.0, 0.0], (3, 1)))
        ends += [(k, m, bool(done[m])) for m in np.flatnonzero(done | cut).tolist()]
        begun = info['t_s'] == 0
        assert (rewards[begun] == 0).all()
        assert (shown[begun, :2] == 0).all()
        assert begun.tolist() == [(k - 1, m) in [end[:2] for end in ends] for m in range(3)]
    assert ends == [(0, 1, True), (29, 0, False), (29, 2, False), (31, 1, False),
                    (60, 0, False), (60, 2, False), (62, 1, False)]
    with pytest.raises(ValueError, match=r'expected actions \(3, 2\)'):
        envs.step(np.zeros(2))


def test_one_of_many_is_the_same_as_one_alone():
    one, many = make(), gymnasium.make_vec(STEERING, num_envs=1)
    assert many.reset(seed=4)[0][0].tobytes() == one.reset(seed=4)[0].tobytes()
    for action in np.random.default_rng(1).uniform(-1, 1, (100, 2)):
        a, b = one.step(action), many.step(action[None])
        assert a[0].tobytes() == b[0][0].tobytes()
        assert [*a[1:4], a[4]['t_s']] == [*(x[0] for x in b[1:4]), b[4]['t_s'][0]]


def test_all_may_begin_anew_at_once(tmp_path):
    path = scenario(tmp_path, duration_s=1, controller={'name': 'hold'})
    envs = gymnasium.make_vec(STEERING, num_envs=2, scenario=path)
    envs.reset(seed=1)
    times = [envs.step(np.zeros((2, 2)))[4]['t_s'].tolist() for _ in range(33)]
    assert times[29:] == [[1.0, 1.0], [0.0, 0.0], [1 / 30] * 2, [2 / 30] * 2]


@pytest.mark.parametrize('exposure', [0.0, 0.5, 1.0])
def test_the_camera_sees_the_mean_of_its_exposure(tmp_path, exposure):
    camera = {'frame_rate_hz': 30, 'exposure': exposure}
    env = make(scenario=scenario(tmp_path, camera=camera), particles=None)
    env.reset(seed=1)
    worlds = env.worlds
    worlds.bodies['diffusion'] = worlds.bodies['rotational_diffusion'] = 0
    for _ in range(3):
        env.step(np.array([1.0, 0.0]))
    bodies, since = worlds.bodies[0], exposure / 30 / 2
    velocity = bodies['speed'] * np.exp(1j * bodies['phi'])
    middle = bodies['x'] + 1j * bodies['y'] - since * velocity
    assert worlds.t[0] == pytest.approx((3 + exposure) / 30)
    assert worlds.seen[0] @ [1, 1j] == pytest.approx(middle, abs=1e-9)


def test_long_steps_of_the_physics_cost_little():
    env = make()
    env.reset(seed=1)
    bodies = env.worlds.bodies.copy()
    bodies['diffusion'] = bodies['rotational_diffusion'] = 0
    angle = np.random.default_rng(1).uniform(-3, 3, 60)
    field = 5e-3 * np.stack((np.cos(angle), np.sin(angle)), axis=-1)[None, :, None]
    places = []
    for steps in (34, 7):  # of 1 ms and of 5 ms
        moved = bodies.copy()
        for k in range(60):
            advance_worlds(moved, np.zeros(1, int), np.full(1, k / 30), 1 / 30, steps,
                           np.arange(60) / 30, field, np.full(1, k + 1), coil_gradients(),
                           np.random.default_rng(1), np.zeros((1, 2, 2)))
        places.append(moved['x'][0] + 1j * moved['y'][0])
    assert np.abs(places[0] - places[1]).max() < 0.1e-6  # after 60 turns of the field


def test_the_worlds_move_as_the_virtual_rigs_does():
    env = make(particles=3)
    env.reset(seed=1)
    bodies, rows = env.worlds.bodies.copy(), np.arange(2) / 30
    world = World(bodies[0].copy(), np.random.default_rng(2))
    field = np.random.default_rng(3).normal(0, 3e-3, (1, 2, 1, 2))
    advance_worlds(bodies, np.zeros(1, int), np.zeros(1), 0.05, 50, rows, field,
                   np.full(1, 2), coil_gradients(), np.random.default_rng(2), np.zeros((1, 3, 2)))
    world.advance(0.05, FieldHistory(rows, field[0]))
    for name in ('x', 'y', 'heading'):
        assert bodies[name][0] == pytest.approx(world.bodies[name], rel=1e-12)


def test_without_gymnasium_one_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, 'gymnasium', None)
    with pytest.raises(ImportError, match=r'^microbot_ros.gym needs .*microbot_ros\[gym\]$'):
        runpy.run_path(microbot_ros.gym.__file__)
