"""Nothing unsafe leaves the controller manager, whatever a controller does."""

import gc
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from microbot_ros.control.contract import (
    Controller,
    FieldCommand,
    Goals,
    Limits,
    ParticleLostError,
    Result,
    no_field,
)
from microbot_ros.control.controller_thread import AGAIN
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.hold import Hold
from microbot_ros.control.plugins.open_loop import OpenLoop, OpenLoopParameters
from microbot_ros.control.registry import controller_classes
from microbot_ros.control.testkit import controller_input
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.model import Model

LIMITS = Limits(field=5e-3, slew=0.1)
DT = 0.01


class East(Controller):
    """Full field to the right; counts what is done to it."""

    interface_version = 1
    summary = 'East.'

    def __init__(self):
        super().__init__()
        self.calls = []

    def activate(self, inputs):
        self.calls.append('activate')
        self.start = inputs.field

    def compute(self, inputs):
        self.calls.append('compute')
        return FieldCommand(np.array([inputs.limits.field, 0]))

    def deactivate(self):
        self.calls.append('deactivate')


class Answers(East):
    """Answers what it is told to; an exception is raised."""

    def __init__(self, value=None):
        super().__init__()
        self.value = value

    def compute(self, inputs):
        if isinstance(self.value, BaseException):
            raise self.value
        return self.value


class Refuses(East):
    def activate(self, inputs):
        raise ParticleLostError('particle 3 is not tracked')


class Spins(East):
    def compute(self, inputs):
        while True:
            pass


class Waits(East):
    gate = threading.Event()

    def compute(self, inputs):
        self.gate.wait()
        return no_field('')


class SpinsInTurn(East):
    """Hangs in what its class is told to; made anew, in nothing."""

    @dataclass(frozen=True)
    class Parameters:
        hangs_in: str = ''

    def _maybe(self, where):
        self.thread = threading.current_thread()
        while self.parameters.hangs_in == where:
            pass

    def activate(self, inputs):
        self._maybe('activate')

    def deactivate(self):
        self._maybe('deactivate')


AMPLE = 30.0
"""Deadline [s] that a controller misses on no machine."""


def look(t, **changes):
    return controller_input(2, t=t, dt=DT, limits=LIMITS, **changes)


def run(manager, ticks, t=0.0):
    return [manager.tick(look(t + k * DT)) for k in range(ticks)]


def make(**controllers):
    return ControllerManager({'hold': Hold(), 'east': East(), **controllers}, 'hold',
                       deadline=AMPLE, patience=60)


def test_field_rises_and_falls_no_faster_than_the_slew():
    manager = make()
    run(manager, 2)
    assert manager.switch_controller('east').ok
    fields = [outcome.command.field for outcome in run(manager, 8, 0.1)]
    manager.switch_controller('hold')
    fields += [outcome.command.field for outcome in run(manager, 8, 0.2)]
    steps = np.hypot(*np.diff(fields, axis=0).T)
    assert steps.max() <= LIMITS.slew * DT * (1 + 1e-9)
    assert np.max(fields) == pytest.approx(5e-3)
    assert not np.any(fields[-1])


def test_the_slew_counts_the_part_along_z():
    manager = make(up=Answers(FieldCommand(np.array([0, 0, 5e-3]))))
    manager.switch_controller('up')
    fields = [outcome.command.field for outcome in run(manager, 7)]
    strengths = np.linalg.norm([np.zeros(3), *fields], axis=1)
    assert np.diff(strengths) == pytest.approx([1e-3] * 5 + [0, 0], abs=1e-12)


def test_a_controller_takes_over_from_the_present_field_in_the_next_tick():
    east, other = East(), East()
    manager = make(east=east, other=other)
    run(manager, 1)
    manager.switch_controller('east')
    before = run(manager, 3)[-1].command.field
    assert manager.switch_controller('other').ok
    assert east.calls[-1] == 'deactivate'
    assert np.array_equal(other.start, before)
    run(manager, 1)
    assert other.calls == ['activate', 'compute']
    assert manager.active == 'other'


def test_a_refused_swap_changes_nothing():
    manager = make(refuses=Refuses())
    run(manager, 1)
    manager.switch_controller('east')
    answer = manager.switch_controller('refuses')
    assert not answer.ok
    assert 'particle 3' in answer.message
    assert manager.active == 'east'
    assert run(manager, 1)[0].result is Result.OK
    assert not manager.switch_controller('nobody').ok


def test_before_the_first_poses_a_controller_is_activated_at_its_first_tick():
    east = East()
    manager = make(east=east)
    assert manager.switch_controller('east').ok
    assert east.calls == []
    run(manager, 2)
    assert east.calls == ['activate', 'compute', 'compute']


@pytest.mark.parametrize('value', [
    ValueError('no'), ZeroDivisionError(), SystemExit(1), KeyboardInterrupt(), None, 7, no_field,
    FieldCommand(np.array([np.nan, 0])), FieldCommand(np.array([0, np.inf])),
    FieldCommand(np.array([-np.inf, 0])), FieldCommand(np.array([5.001e-3, 0])),
    FieldCommand(np.zeros(4)), FieldCommand(np.zeros(2), np.nan), FieldCommand(np.zeros(2), -1.0),
    FieldCommand(np.zeros(2), np.inf), FieldCommand(np.array(['a', 'b'])),
    FieldCommand(np.array([0, 0, np.nan])), FieldCommand(np.array([0, 0, np.inf])),
    FieldCommand(np.array([4e-3, 0, 4e-3])),
    *(FieldCommand(np.array([1e-3, 0, 0]), 1.0, axis=np.array(axis)) for axis in (
        [0, np.nan, 0], [np.inf, 0, 0], [0, 0, 0], [1, 1]))])
def test_faults_end_in_zero_until_the_next_swap(value):
    manager = make(answers=Answers(value))
    run(manager, 1)
    manager.switch_controller('east')
    run(manager, 10)
    manager.switch_controller('answers')
    outcomes = run(manager, 8)
    assert {outcome.result for outcome in outcomes} == {Result.FAULT}
    assert not np.any(outcomes[-1].command.field)
    assert 'answers' in manager.fault
    assert 'answers' in outcomes[-1].message
    assert manager.switch_controller('east').ok
    assert run(manager, 1)[0].result is Result.OK
    assert manager.fault == ''


def test_at_the_limit_is_within_the_limit():
    manager = make(answers=Answers(FieldCommand(np.array([0, -5e-3]), 100.0)))
    manager.switch_controller('answers')
    assert run(manager, 6)[-1].command.field == pytest.approx([0, -5e-3])


def test_a_controller_that_only_cant_act_now_is_asked_again():
    answers = Answers(ParticleLostError('gone'))
    manager = make(answers=answers)
    manager.switch_controller('answers')
    outcome = run(manager, 1)[0]
    assert (outcome.result, outcome.message) == (Result.PARTICLE_LOST, 'gone')
    answers.value = no_field('')
    assert run(manager, 1)[0].result is Result.OK


def test_a_controller_that_spins_is_late_then_given_up_and_a_fresh_one_can_return():
    manager = ControllerManager(
        {'hold': Hold(), 'spins': Spins()}, 'spins', deadline=0.02, patience=0.05)
    assert run(manager, 1)[0].result is Result.FAULT
    spinning = manager._threads['spins']._worker._thread
    while not manager.fault:
        manager.tick(look(1.0))
    assert 'spins' in manager.fault
    spinning.join(30)
    assert not spinning.is_alive()
    manager._deadline = AMPLE
    assert manager.switch_controller('hold').ok
    assert run(manager, 1)[0].result is Result.OK


def test_a_thread_that_can_not_be_ended_does_not_hold_up_the_others():
    """It swallows what should end it, until the test lets it go."""
    over = threading.Event()

    class Clings(East):
        def compute(self, inputs):
            while not over.is_set():
                with suppress(BaseException):
                    while not over.is_set():
                        pass
            return no_field('')

    manager = ControllerManager({'clings': Clings(), 'east': East()}, 'clings',
                        deadline=0.5, patience=0.05)
    assert run(manager, 1)[0].result is Result.FAULT
    thread = manager._threads['clings']._worker._thread
    manager._deadline = AMPLE
    assert manager.switch_controller('east').ok
    assert {outcome.result for outcome in run(manager, 20)} == {Result.OK}
    assert thread.is_alive()
    over.set()
    thread.join(30)
    assert not thread.is_alive()


def test_the_threads_of_a_manager_that_nobody_closes_end_with_it():
    manager = ControllerManager({'east': East()}, 'east', deadline=AMPLE, patience=60)
    assert run(manager, 1)[0].result is Result.OK
    thread = manager._threads['east']._worker._thread
    assert thread.is_alive()
    del manager
    gc.collect()
    thread.join(30)
    assert not thread.is_alive()


def test_a_late_answer_is_not_used_and_not_a_lasting_fault():
    waits = Waits()
    waits.gate = threading.Event()
    manager = ControllerManager({'waits': waits}, 'waits', deadline=0.02, patience=60)
    assert 'took longer than' in run(manager, 1)[0].message
    assert 'previous command' in run(manager, 1)[0].message
    manager._deadline = AMPLE
    waits.gate.set()
    assert manager._threads['waits']._worker._newest.returned.wait(10)
    assert run(manager, 1)[0].result is Result.OK
    assert manager.fault == ''


def test_swapping_away_from_a_controller_that_hangs():
    waits = Waits()
    # Not for ever: where lines are traced, as for coverage, Python 3.11 executes no other thread
    # until this one has received the exception that ends it.
    waits.gate = SimpleNamespace(wait=partial(threading.Event().wait, 1.0))
    manager = ControllerManager(
        {'hold': Hold(), 'waits': waits}, 'waits', deadline=0.02, patience=60)
    run(manager, 1)
    manager._deadline = AMPLE
    assert manager.switch_controller('hold').ok
    assert run(manager, 1)[0].result is Result.OK


@pytest.mark.parametrize('where', ['activate', 'deactivate'])
def test_what_hangs_in_a_swap_costs_a_deadline_and_a_fresh_one_stands_in(where):
    it = SpinsInTurn()
    manager = ControllerManager({'hold': Hold(), 'it': it}, 'hold', deadline=1.0, patience=0.1)
    run(manager, 1)
    assert manager.configure('it', SpinsInTurn.Parameters(where)).ok
    assert manager.switch_controller('it').ok == (where == 'deactivate')
    assert manager.switch_controller('hold').ok
    assert run(manager, 1)[0].result is Result.OK
    it.thread.join(30)
    assert not it.thread.is_alive()
    assert manager.configure('it', SpinsInTurn.Parameters()).ok
    assert manager.switch_controller('it').ok
    assert run(manager, 1)[0].result is Result.OK
    assert manager._threads['it']._controller is not it


def test_only_the_controller_that_drives_has_a_thread():
    manager = ControllerManager({name: Hold() for name in 'abc'}, 'a', deadline=AMPLE)
    run(manager, 1)
    for name in 'abc':
        assert manager.configure(name, Hold.Parameters()).ok
    assert manager.switch_controller('b').ok
    run(manager, 1)
    assert [name for name, it in manager._threads.items() if it._worker._thread] == ['b']


def test_a_fresh_one_that_can_not_be_configured_does_not_take_over(tmp_path):
    """The file has gone meanwhile: rather no controller than one with other parameters."""
    file = tmp_path / 'commands.csv'
    file.write_text('t_s,bx_mT,by_mT\n0,1,0\n9,0,0\n')
    manager = ControllerManager({'hold': Hold(), 'open_loop': OpenLoop()}, 'hold', deadline=AMPLE)
    run(manager, 1)
    played = OpenLoopParameters(file=str(file))
    assert manager.configure('open_loop', played).ok
    file.unlink()
    manager.reset()
    refused = manager.switch_controller('open_loop')
    assert not refused.ok
    assert 'commands.csv' in refused.message
    assert manager.active == 'hold'
    file.write_text('t_s,bx_mT,by_mT\n0,1,0\n9,0,0\n')
    assert manager.configure('open_loop', played).ok
    assert manager.switch_controller('open_loop').ok


def test_naming_the_one_that_drives_restarts_it():
    east = East()
    manager = make(east=east)
    run(manager, 1)
    manager.switch_controller('east')
    run(manager, 1)
    assert manager.switch_controller('east').ok
    assert east.calls == ['activate', 'compute', 'deactivate', 'activate']


def test_a_delay_that_the_model_knows_adds_to_that_of_the_rig():
    class Looks(East):
        def compute(self, inputs):
            self.seen = inputs.delay, inputs.model.delay
            return super().compute(inputs)

    looks = Looks()
    manager = ControllerManager({'looks': looks}, 'looks', deadline=AMPLE)
    manager.tick(look(0.0, delay=0.03, model=Model(5e-3, effects=(CommandDelay(0.2),))))
    assert looks.seen == (pytest.approx(0.23), 0)


def test_particles_without_a_position_are_left_out():
    class Counts(East):
        def compute(self, inputs):
            self.seen = inputs.ids.tolist(), len(inputs.expected), len(inputs.phi)
            return no_field('')

    counts = Counts()
    manager = ControllerManager({'counts': counts}, 'counts', deadline=AMPLE)
    position = np.array([[0, 0], [np.nan, 0], [0, np.inf], [1e-6, 0]])
    manager.tick(controller_input(4, position=position))
    assert counts.seen == ([0, 3], 2, 2)


def test_each_controller_keeps_its_parameters_and_a_bad_set_changes_nothing():
    manager = ControllerManager({'hold': Hold(), 'open_loop': OpenLoop()}, 'hold', deadline=AMPLE)
    good = OpenLoopParameters(directions_deg=[90.0], durations_s=[5.0])
    assert manager.configure('open_loop', good).ok
    refused = manager.configure('open_loop', OpenLoopParameters(directions_deg=[1.0, 2.0]))
    assert not refused.ok
    assert 'one duration per direction' in refused.message
    manager.reset()
    run(manager, 1)
    manager.switch_controller('open_loop')
    assert run(manager, 8)[-1].command.field == pytest.approx([0, 5e-3])


def test_expected_positions_follow_the_commands_on_their_way():
    """By hand: 50 ms eastwards are on the way, then 20 ms of exposure age with nothing."""
    class Looks(East):
        def compute(self, inputs):
            self.expected = inputs.expected
            return super().compute(inputs)

    looks = Looks()
    fast = Limits(field=5e-3, slew=10.0)
    manager = ControllerManager({'looks': looks}, 'looks', deadline=AMPLE)
    speed, phi = np.array([4e-6, 2e-6]), np.array([np.pi / 2, np.nan])

    def tick(t, dt=DT):
        manager.tick(controller_input(2, t=t, dt=dt, limits=fast, age=0.02, delay=0.03,
                             position=np.zeros((2, 2)), speed=speed, phi=phi))

    for t in (0.0, 0.01, 0.02):
        tick(t)
    # Exposed at 0.00, acting from 0.05 on; the first command acts from 0.03 on.
    assert looks.expected[0] == pytest.approx([0, 4e-6 * 0.02], abs=1e-12)
    assert looks.expected[1] == pytest.approx([0, 0])
    tick(1.02, dt=1.0)
    assert looks.expected[0] == pytest.approx([0, 0]), 'what was driven meanwhile is not known'


def test_closing_deactivates():
    east = East()
    manager = make(east=east)
    manager.switch_controller('east')
    run(manager, 1)
    manager.close()
    assert east.calls[-1] == 'deactivate'


def test_nothing_unsafe_comes_out_of_random_switches_among_all_controllers_and_faulty_ones():
    kinds = controller_classes()
    faulty = {'nan': FieldCommand(np.full(2, np.nan)), 'strong': FieldCommand(np.ones(2)),
              'fast': FieldCommand(np.zeros(2), 1e9), 'raises': RuntimeError('on purpose')}
    controllers = {name: kind() for name, kind in kinds.items()}
    controllers |= {name: Answers(value) for name, value in faulty.items()} | {'no': Refuses()}
    manager = ControllerManager(controllers, 'hold', deadline=AMPLE)
    rng, before = np.random.default_rng(0), np.zeros(2)
    goals = Goals(np.array([[20e-6, 0], [0, 20e-6]]))
    for k in range(300):
        name = rng.choice(list(controllers))
        was, answer = manager.active, manager.switch_controller(name)
        assert manager.active == (name if answer.ok else was)
        outcome = manager.tick(look(k * DT, goals=goals, path=goals.position, model=Model(5e-3)))
        field = outcome.command.field
        assert np.hypot(*field) <= LIMITS.field * (1 + 1e-9)
        assert np.hypot(*(field - before)) <= LIMITS.slew * DT * (1 + 1e-9)
        assert 0 <= outcome.command.frequency <= LIMITS.frequency
        assert (outcome.result is Result.FAULT) == (manager.active in faulty)
        before = field


class Fussy(East):
    """Takes parameters, but not bad ones; keeps what it was given last."""

    @dataclass(frozen=True)
    class Parameters:
        strength: float = 1.0

    def configure(self, parameters):
        self.given = parameters.strength
        if self.given < 0:
            raise ValueError('strength must be above 0')
        super().configure(parameters)


def three():
    fussy, other = Fussy(), Fussy()
    manager = make(fussy=fussy, other=other, refuses=Refuses())
    run(manager, 1)
    return manager, fussy, other


@pytest.mark.parametrize(('parameters', 'drives', 'said'), [
    ({'fussy': 2.0, 'other': -1.0}, '', 'other: strength must be'),
    ({'fussy': 2.0, 'other': 3.0}, 'refuses', 'refuses: particle 3'),
    ({'fussy': 2.0, 'other': -1.0}, 'east', 'other: strength must be'),
    ({'fussy': 2.0}, 'nobody', "no controller 'nobody'")])
def test_a_change_is_taken_whole_or_not_at_all(parameters, drives, said):
    manager, fussy, other = three()
    wanted = {name: Fussy.Parameters(value) for name, value in parameters.items()}
    answer = manager.change(wanted, drives)
    assert not answer.ok
    assert said in answer.message
    assert manager.active == 'hold'
    assert [one.parameters.strength for one in (fussy, other)] == [1.0, 1.0]
    assert getattr(fussy, 'given', 1.0) == 1.0, 'what is refused by another does not touch it'


def test_a_change_that_all_take_is_made_before_the_swap():
    manager, fussy, _ = three()
    assert manager.change({'fussy': Fussy.Parameters(2.0)}, 'fussy').ok
    assert (manager.active, fussy.given, fussy.calls) == ('fussy', 2.0, ['activate'])


def test_what_can_not_be_taken_back_does_not_drive(tmp_path):
    """The file it had is gone: rather no field than one by parameters that were refused."""
    first, second = tmp_path / 'a.csv', tmp_path / 'b.csv'
    for file in (first, second):
        file.write_text('t_s,bx_mT,by_mT\n0,1,0\n9,0,0\n')
    manager = ControllerManager(
        {'open_loop': OpenLoop(), 'refuses': Refuses()}, 'open_loop', deadline=AMPLE)
    assert manager.configure('open_loop', OpenLoopParameters(file=str(first))).ok
    assert np.any(run(manager, 1)[0].command.field)
    first.unlink()
    refused = manager.change({'open_loop': OpenLoopParameters(file=str(second))}, 'refuses')
    assert not refused.ok
    outcomes = run(manager, 3)
    assert {outcome.result for outcome in outcomes} == {Result.FAULT}
    assert 'a.csv' in outcomes[0].message
    assert not np.any(outcomes[-1].command.field)


class Slow(Fussy):
    """Takes 2 as its strength for as long as the test wants."""

    goes_on = threading.Event()

    def configure(self, parameters):
        if parameters.strength == 2.0:
            type(self).goes_on.wait(30)
        super().configure(parameters)


@pytest.fixture
def slow():
    Slow.goes_on = threading.Event()
    yield ControllerManager({'slow': Slow(), 'fussy': Fussy()}, 'slow', deadline=AMPLE)
    Slow.goes_on.set()


def test_no_tick_waits_for_parameters_and_what_drives_goes_on(slow):
    run(slow, 20)
    began = time.monotonic()
    refused = slow.change({'fussy': Fussy.Parameters(3.0), 'slow': Slow.Parameters(2.0)},
                          seconds=0.01)
    assert time.monotonic() - began < 2.0
    assert not refused.ok
    assert refused.message == f'slow is still being configured in the background: {AGAIN}'
    outcome = run(slow, 20)[-1]
    assert outcome.result is Result.OK
    assert outcome.command.field.any()
    assert [thread.parameters.strength for thread in slow._threads.values()] == [1.0, 1.0]
    assert not slow.change({'slow': Slow.Parameters(2.0)}, seconds=0.0).ok
    Slow.goes_on.set()
    assert slow._threads['slow']._prepared[2].returned.wait(10)
    assert slow.change({'fussy': Fussy.Parameters(3.0), 'slow': Slow.Parameters(2.0)},
                       seconds=5.0).ok
    assert [thread.parameters.strength for thread in slow._threads.values()] == [2.0, 3.0]
    assert run(slow, 1)[0].result is Result.OK


def test_other_parameters_take_the_place_of_those_still_being_taken(slow):
    assert not slow.configure('slow', Slow.Parameters(2.0), 0.0).ok
    assert slow.configure('slow', Slow.Parameters(3.0), 5.0).ok
    Slow.goes_on.set()
    run(slow, 1)
    assert slow._threads['slow']._controller.parameters.strength == 3.0


def test_parameters_that_are_taken_too_late_are_not_taken(slow, monkeypatch):
    monkeypatch.setattr('microbot_ros.control.controller_thread.CONFIGURING', 0.0)
    refused = slow.configure('slow', Slow.Parameters(2.0), 0.02)
    assert not refused.ok
    assert 'took longer than' in refused.message
    Slow.goes_on.set()
    run(slow, 1)
    assert slow._threads['slow']._controller.parameters.strength == 1.0
    assert slow._threads['slow'].parameters.strength == 1.0


@pytest.mark.parametrize('field', [np.array([[1e-3], [0]]), [1e-3, 0], (np.float32(1e-3), 0)])
def test_a_field_of_another_shape_leaves_as_two_numbers(field):
    manager = ControllerManager({'answers': Answers(FieldCommand(field))}, 'answers',
                                deadline=AMPLE, border=0.0)
    assert run(manager, 2)[-1].command.field == pytest.approx([1e-3, 0])
