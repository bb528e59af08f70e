"""Nothing unsafe leaves the switchboard, whatever a controller does."""

import threading
from contextlib import suppress
from dataclasses import dataclass

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
from microbot_ros.control.hold import Hold
from microbot_ros.control.open_loop import OpenLoop, OpenLoopParameters
from microbot_ros.control.registry import controller_classes
from microbot_ros.control.switchboard import Switchboard
from microbot_ros.control.testkit import situation
from microbot_ros.model.effects.command_delay import CommandDelay
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

    def activate(self, situation):
        self.calls.append('activate')
        self.start = situation.field

    def compute(self, situation):
        self.calls.append('compute')
        return FieldCommand(np.array([situation.limits.field, 0]))

    def deactivate(self):
        self.calls.append('deactivate')


class Answers(East):
    """Answers what it is told to; an exception is raised."""

    def __init__(self, value=None):
        super().__init__()
        self.value = value

    def compute(self, situation):
        if isinstance(self.value, BaseException):
            raise self.value
        return self.value


class Refuses(East):
    def activate(self, situation):
        raise ParticleLostError('particle 3 is not seen')


class Spins(East):
    def compute(self, situation):
        while True:
            pass


class Waits(East):
    gate = threading.Event()

    def compute(self, situation):
        self.gate.wait()
        return no_field('')


class SpinsInTurn(East):
    """Hangs in what its class is told to; made anew, in nothing."""

    @dataclass(frozen=True)
    class Parameters:
        hangs_in: str = ''

    def _maybe(self, where):
        while self.parameters.hangs_in == where:
            pass

    def activate(self, situation):
        self._maybe('activate')

    def deactivate(self):
        self._maybe('deactivate')


def look(t, **changes):
    return situation(2, t=t, dt=DT, limits=LIMITS, **changes)


def run(board, ticks, t=0.0):
    return [board.tick(look(t + k * DT)) for k in range(ticks)]


def make(**controllers):
    return Switchboard({'hold': Hold(), 'east': East(), **controllers}, 'hold',
                       deadline=0.2, patience=0.3)


def test_field_rises_and_falls_no_faster_than_the_slew():
    board = make()
    run(board, 2)
    assert board.swap('east').ok
    fields = [outcome.command.field for outcome in run(board, 8, 0.1)]
    board.swap('hold')
    fields += [outcome.command.field for outcome in run(board, 8, 0.2)]
    steps = np.hypot(*np.diff(fields, axis=0).T)
    assert steps.max() <= LIMITS.slew * DT * (1 + 1e-9)
    assert np.max(fields) == pytest.approx(5e-3)
    assert not np.any(fields[-1])


def test_a_controller_takes_over_from_the_present_field_in_the_next_tick():
    east, other = East(), East()
    board = make(east=east, other=other)
    run(board, 1)
    board.swap('east')
    before = run(board, 3)[-1].command.field
    assert board.swap('other').ok
    assert east.calls[-1] == 'deactivate'
    assert np.array_equal(other.start, before)
    run(board, 1)
    assert other.calls == ['activate', 'compute']
    assert board.active == 'other'


def test_a_refused_swap_changes_nothing():
    board = make(refuses=Refuses())
    run(board, 1)
    board.swap('east')
    answer = board.swap('refuses')
    assert not answer.ok
    assert 'particle 3' in answer.message
    assert board.active == 'east'
    assert run(board, 1)[0].result is Result.OK
    assert not board.swap('nobody').ok


def test_before_the_first_poses_a_controller_is_activated_at_its_first_tick():
    east = East()
    board = make(east=east)
    assert board.swap('east').ok
    assert east.calls == []
    run(board, 2)
    assert east.calls == ['activate', 'compute', 'compute']


@pytest.mark.parametrize('value', [
    ValueError('no'), ZeroDivisionError(), SystemExit(1), KeyboardInterrupt(), None, 7, no_field,
    FieldCommand(np.array([np.nan, 0])), FieldCommand(np.array([0, np.inf])),
    FieldCommand(np.array([-np.inf, 0])), FieldCommand(np.array([5.001e-3, 0])),
    FieldCommand(np.zeros(3)), FieldCommand(np.zeros(2), np.nan), FieldCommand(np.zeros(2), -1.0),
    FieldCommand(np.zeros(2), np.inf), FieldCommand(np.array(['a', 'b']))])
def test_faults_end_in_zero_until_the_next_swap(value):
    board = make(answers=Answers(value))
    run(board, 1)
    board.swap('east')
    run(board, 10)
    board.swap('answers')
    outcomes = run(board, 8)
    assert {outcome.result for outcome in outcomes} == {Result.FAULT}
    assert not np.any(outcomes[-1].command.field)
    assert 'answers' in board.fault
    assert 'answers' in outcomes[-1].message
    assert board.swap('east').ok
    assert run(board, 1)[0].result is Result.OK
    assert board.fault == ''


def test_at_the_limit_is_within_the_limit():
    board = make(answers=Answers(FieldCommand(np.array([0, -5e-3]), 100.0)))
    board.swap('answers')
    assert run(board, 6)[-1].command.field == pytest.approx([0, -5e-3])


def test_a_controller_that_only_cant_act_now_is_asked_again():
    answers = Answers(ParticleLostError('gone'))
    board = make(answers=answers)
    board.swap('answers')
    outcome = run(board, 1)[0]
    assert (outcome.result, outcome.message) == (Result.PARTICLE_LOST, 'gone')
    answers.value = no_field('')
    assert run(board, 1)[0].result is Result.OK


def test_a_controller_that_spins_is_late_then_given_up_and_a_fresh_one_can_return():
    board = Switchboard({'hold': Hold(), 'spins': Spins()}, 'spins', deadline=0.02, patience=0.05)
    assert run(board, 1)[0].result is Result.FAULT
    spinning = board._runners['spins']._worker._thread
    while not board.fault:
        board.tick(look(1.0))
    assert 'spins' in board.fault
    spinning.join(30)
    assert not spinning.is_alive()
    assert board.swap('hold').ok
    assert run(board, 1)[0].result is Result.OK


def test_a_thread_that_can_not_be_ended_does_not_hold_up_the_others():
    """It swallows what should end it, until the test lets it go."""
    over = threading.Event()

    class Clings(East):
        def compute(self, situation):
            while not over.is_set():
                with suppress(BaseException):
                    while not over.is_set():
                        pass
            return no_field('')

    board = Switchboard({'clings': Clings(), 'east': East()}, 'clings',
                        deadline=0.5, patience=0.05)
    assert run(board, 1)[0].result is Result.FAULT
    thread = board._runners['clings']._worker._thread
    assert board.swap('east').ok
    assert {outcome.result for outcome in run(board, 20)} == {Result.OK}
    assert thread.is_alive()
    over.set()
    thread.join(30)
    assert not thread.is_alive()


def test_a_late_answer_is_not_used_and_not_a_lasting_fault():
    waits = Waits()
    waits.gate = threading.Event()
    board = Switchboard({'waits': waits}, 'waits', deadline=0.02, patience=60)
    assert 'took longer than' in run(board, 1)[0].message
    assert 'tick before' in run(board, 1)[0].message
    waits.gate.set()
    assert board._runners['waits']._worker._newest.returned.wait(10)
    assert run(board, 1)[0].result is Result.OK
    assert board.fault == ''


def test_swapping_away_from_a_controller_that_hangs():
    waits = Waits()
    waits.gate = threading.Event()
    board = Switchboard({'hold': Hold(), 'waits': waits}, 'waits', deadline=0.02, patience=60)
    run(board, 1)
    assert board.swap('hold').ok
    assert run(board, 1)[0].result is Result.OK
    waits.gate.set()


@pytest.mark.parametrize('where', ['activate', 'deactivate'])
def test_what_hangs_in_a_swap_costs_a_deadline_and_a_fresh_one_stands_in(where):
    it = SpinsInTurn()
    board = Switchboard({'hold': Hold(), 'it': it}, 'hold', deadline=0.04, patience=0.1)
    run(board, 1)
    assert board.configure('it', SpinsInTurn.Parameters(where)).ok
    thread = board._runners['it']._worker._thread
    assert board.swap('it').ok == (where == 'deactivate')
    assert board.swap('hold').ok
    assert run(board, 1)[0].result is Result.OK
    thread.join(30)
    assert not thread.is_alive()
    assert board.configure('it', SpinsInTurn.Parameters()).ok
    assert board.swap('it').ok
    assert run(board, 1)[0].result is Result.OK
    assert board._runners['it']._controller is not it


def test_a_fresh_one_that_can_not_be_configured_does_not_take_over(tmp_path):
    """The file has gone meanwhile: rather no controller than one with other parameters."""
    file = tmp_path / 'commands.csv'
    file.write_text('t_s,bx_mT,by_mT\n0,1,0\n9,0,0\n')
    board = Switchboard({'hold': Hold(), 'open_loop': OpenLoop()}, 'hold', deadline=2.0)
    run(board, 1)
    played = OpenLoopParameters(file=str(file))
    assert board.configure('open_loop', played).ok
    file.unlink()
    board.reset()
    refused = board.swap('open_loop')
    assert not refused.ok
    assert 'commands.csv' in refused.message
    assert board.active == 'hold'
    file.write_text('t_s,bx_mT,by_mT\n0,1,0\n9,0,0\n')
    assert board.configure('open_loop', played).ok
    assert board.swap('open_loop').ok


def test_naming_the_one_that_drives_restarts_it():
    east = East()
    board = make(east=east)
    run(board, 1)
    board.swap('east')
    run(board, 1)
    assert board.swap('east').ok
    assert east.calls == ['activate', 'compute', 'deactivate', 'activate']


def test_a_delay_that_the_model_knows_adds_to_that_of_the_rig():
    class Looks(East):
        def compute(self, situation):
            self.seen = situation.delay, situation.model.delay
            return super().compute(situation)

    looks = Looks()
    board = Switchboard({'looks': looks}, 'looks', deadline=0.2)
    board.tick(look(0.0, delay=0.03, model=Model(5e-3, effects=(CommandDelay(0.2),))))
    assert looks.seen == (pytest.approx(0.23), 0)


@pytest.mark.parametrize('age', [0.21, np.nan, np.inf, -np.inf, -0.3, 1e9])
def test_stale_poses_mean_no_command_and_a_start_from_zero(age):
    board = make()
    board.swap('east')
    run(board, 10)
    outcome = board.tick(look(1.0, age=age))
    assert (outcome.command, outcome.result) == (None, Result.STALE)
    assert np.hypot(*run(board, 1)[0].command.field) <= LIMITS.slew * DT * (1 + 1e-9)


@pytest.mark.parametrize('dt', [0.0, -1.0, np.nan])
def test_without_time_the_field_stays(dt):
    board = make()
    board.swap('east')
    before = run(board, 3)[-1].command.field
    after = board.tick(situation(2, t=1.0, dt=dt, limits=LIMITS)).command.field
    assert np.array_equal(before, after)


def test_a_long_gap_does_not_let_the_field_jump():
    board = Switchboard({'east': East()}, 'east', deadline=0.2)
    slow = Limits(field=5e-3, slew=0.01)
    outcome = board.tick(situation(2, dt=100.0, limits=slow))
    assert np.hypot(*outcome.command.field) == pytest.approx(1e-3)


def test_particles_without_a_position_are_left_out():
    class Counts(East):
        def compute(self, situation):
            self.seen = situation.ids.tolist(), len(situation.expected), len(situation.phi)
            return no_field('')

    counts = Counts()
    board = Switchboard({'counts': counts}, 'counts', deadline=0.2)
    position = np.array([[0, 0], [np.nan, 0], [0, np.inf], [1e-6, 0]])
    board.tick(situation(4, position=position))
    assert counts.seen == ([0, 3], 2, 2)


def test_each_controller_keeps_its_parameters_and_a_bad_set_changes_nothing():
    board = Switchboard({'hold': Hold(), 'open_loop': OpenLoop()}, 'hold', deadline=0.2)
    good = OpenLoopParameters(directions_deg=[90.0], durations_s=[5.0])
    assert board.configure('open_loop', good).ok
    refused = board.configure('open_loop', OpenLoopParameters(directions_deg=[1.0, 2.0]))
    assert not refused.ok
    assert 'one duration per direction' in refused.message
    board.reset()
    run(board, 1)
    board.swap('open_loop')
    assert run(board, 8)[-1].command.field == pytest.approx([0, 5e-3])


def test_expected_positions_follow_the_commands_on_their_way():
    """By hand: 50 ms eastwards are on the way, then 20 ms of exposure age with nothing."""
    class Looks(East):
        def compute(self, situation):
            self.expected = situation.expected
            return super().compute(situation)

    looks = Looks()
    fast = Limits(field=5e-3, slew=10.0)
    board = Switchboard({'looks': looks}, 'looks', deadline=0.2)
    speed, phi = np.array([4e-6, 2e-6]), np.array([np.pi / 2, np.nan])
    for t in (0.0, 0.01, 0.02):
        board.tick(situation(2, t=t, dt=DT, limits=fast, age=0.02, delay=0.03,
                             position=np.zeros((2, 2)), speed=speed, phi=phi))
    # Exposed at 0.00, acting from 0.05 on; the first command acts from 0.03 on.
    assert looks.expected[0] == pytest.approx([0, 4e-6 * 0.02], abs=1e-12)
    assert looks.expected[1] == pytest.approx([0, 0])


def test_closing_deactivates():
    east = East()
    board = make(east=east)
    board.swap('east')
    run(board, 1)
    board.close()
    assert east.calls[-1] == 'deactivate'


def test_nothing_unsafe_comes_out_of_random_swaps_among_all_controllers_and_faulty_ones():
    kinds = controller_classes()
    faulty = {'nan': FieldCommand(np.full(2, np.nan)), 'strong': FieldCommand(np.ones(2)),
              'fast': FieldCommand(np.zeros(2), 1e9), 'raises': RuntimeError('on purpose')}
    controllers = {name: kind() for name, kind in kinds.items()}
    controllers |= {name: Answers(value) for name, value in faulty.items()} | {'no': Refuses()}
    board = Switchboard(controllers, 'hold', deadline=10.0)
    rng, before = np.random.default_rng(0), np.zeros(2)
    goals = Goals(np.array([[20e-6, 0], [0, 20e-6]]))
    for k in range(300):
        name = rng.choice(list(controllers))
        was, answer = board.active, board.swap(name)
        assert board.active == (name if answer.ok else was)
        outcome = board.tick(look(k * DT, goals=goals, path=goals.position, model=Model(5e-3)))
        field = outcome.command.field
        assert np.hypot(*field) <= LIMITS.field * (1 + 1e-9)
        assert np.hypot(*(field - before)) <= LIMITS.slew * DT * (1 + 1e-9)
        assert 0 <= outcome.command.frequency <= LIMITS.frequency
        assert (outcome.result is Result.FAULT) == (board.active in faulty)
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
    board = make(fussy=fussy, other=other, refuses=Refuses())
    run(board, 1)
    return board, fussy, other


@pytest.mark.parametrize(('parameters', 'drives', 'said'), [
    ({'fussy': 2.0, 'other': -1.0}, '', 'other: strength must be'),
    ({'fussy': 2.0, 'other': 3.0}, 'refuses', 'refuses: particle 3'),
    ({'fussy': 2.0, 'other': -1.0}, 'east', 'other: strength must be'),
    ({'fussy': 2.0}, 'nobody', "no controller 'nobody'")])
def test_a_change_is_taken_whole_or_not_at_all(parameters, drives, said):
    board, fussy, other = three()
    wanted = {name: Fussy.Parameters(value) for name, value in parameters.items()}
    answer = board.change(wanted, drives)
    assert not answer.ok
    assert said in answer.message
    assert board.active == 'hold'
    assert [one.parameters.strength for one in (fussy, other)] == [1.0, 1.0]
    assert fussy.given == 1.0


def test_a_change_that_all_take_is_made_before_the_swap():
    board, fussy, _ = three()
    assert board.change({'fussy': Fussy.Parameters(2.0)}, 'fussy').ok
    assert (board.active, fussy.given, fussy.calls) == ('fussy', 2.0, ['activate'])


def test_what_can_not_be_taken_back_does_not_drive(tmp_path):
    """The file it had is gone: rather no field than one by parameters that were refused."""
    first, second = tmp_path / 'a.csv', tmp_path / 'b.csv'
    for file in (first, second):
        file.write_text('t_s,bx_mT,by_mT\n0,1,0\n9,0,0\n')
    board = Switchboard({'open_loop': OpenLoop(), 'refuses': Refuses()}, 'open_loop', deadline=2.0)
    assert board.configure('open_loop', OpenLoopParameters(file=str(first))).ok
    assert np.any(run(board, 1)[0].command.field)
    first.unlink()
    refused = board.change({'open_loop': OpenLoopParameters(file=str(second))}, 'refuses')
    assert not refused.ok
    outcomes = run(board, 3)
    assert {outcome.result for outcome in outcomes} == {Result.FAULT}
    assert 'a.csv' in outcomes[0].message
    assert not np.any(outcomes[-1].command.field)


def test_parameters_that_are_taken_too_late_are_not_taken(monkeypatch):
    """It was refused, so what goes on with them is another one, which nobody asks."""
    monkeypatch.setattr('microbot_ros.control.runner.CONFIGURING', 0.05)
    goes_on = threading.Event()

    class Slow(Fussy):
        def configure(self, parameters):
            if parameters.strength == 2.0:
                goes_on.wait(30)
            super().configure(parameters)

    board = Switchboard({'slow': Slow()}, 'slow', deadline=0.5)
    refused = board.configure('slow', Slow.Parameters(2.0))
    assert not refused.ok
    goes_on.set()
    run(board, 1)
    assert board._runners['slow']._controller.parameters.strength == 1.0
    assert board._runners['slow'].parameters.strength == 1.0


@pytest.mark.parametrize('field', [np.array([[1e-3], [0]]), [1e-3, 0], (np.float32(1e-3), 0)])
def test_a_field_of_another_shape_leaves_as_two_numbers(field):
    board = Switchboard({'answers': Answers(FieldCommand(field))}, 'answers', deadline=0.2,
                        border=0.0)
    assert run(board, 2)[-1].command.field == pytest.approx([1e-3, 0])
