"""Every way to zero of the driver of the coils, on virtual time: exact, and quick for mutants."""

import errno
import math
import threading
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bench import _emulator as emulated
from bench._emulator import FULL_SCALE_A, MEASURED
from bench._virtual import VirtualAmplifier, VirtualDriver
from microbot_ros.common.errors import InputError
from microbot_ros.common.patience import PATIENCE
from microbot_ros.drive import coil_driver
from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.coil_driver import STOPPED, CoilDriver
from microbot_ros.drive.errors import NoAnswerError
from microbot_ros.drive.gate import UNATTENDED_S, Limits, Reason
from microbot_ros.drive.rotation import Turning

ZERO = (0.0,) * 4
DRIVING = (1.0, -1.0, 0.5, 0.2)
LIMITS = replace(emulated.LIMITS, command_timeout_s=0.8, feedback_timeout_s=0.8)
WITHOUT_WATCHDOG = ('modbus', 'scpi')
SOON_S = 0.2

every_protocol = pytest.mark.parametrize('protocol', MEASURED)


class Rig(VirtualDriver):
    """A driver and its emulated amplifier, in other limits if told."""

    def __init__(self, protocol='serial_transfer', watchdog_s=0.1, *, on_reading=lambda _: None,
                 on_sent=lambda _: None, self_check=False, accept_no_watchdog=True, heat=None,
                 **limits):
        super().__init__(
            VirtualAmplifier(protocol, watchdog_s=watchdog_s),
            Limits(**{**vars(LIMITS), **limits}), on_reading, on_sent=on_sent,
            self_check=self_check, accept_no_watchdog=accept_no_watchdog, heat=heat)

    def connect(self):
        super().connect()
        return self

    def drive(self, currents=DRIVING):
        super().drive(currents)
        return self

    def command_for(self, seconds, currents=DRIVING):
        end_s = self.clock.now_s + seconds
        while self.clock.now_s < end_s:
            self.driver.command(currents)
            self.turn(0.01)

    def tripped(self, reason):
        """The fault, once it is there and the coils are at zero."""
        fault = self.until(lambda: self.gate.fault)
        assert fault.reason is reason
        self.until(lambda: self.device.flows(ZERO), SOON_S)
        assert not self.gate.armed
        assert not self.driver.command(DRIVING)
        return fault


@pytest.fixture
def protocol():
    return 'serial_transfer'


@pytest.fixture
def watchdog_s():
    return 0.1


@pytest.fixture
def make(protocol, watchdog_s):
    """A function that makes a connected rig, in other limits if told."""
    return lambda **options: Rig(protocol, watchdog_s, **options).connect()


@pytest.fixture
def rig(make):
    return make()


@every_protocol
def test_nothing_flows_before_arming(rig):
    assert not rig.driver.command(DRIVING)
    rig.turn(0.5)
    assert (rig.driver.connected, rig.gate.armed, rig.gate.fault) == (True, False, None)
    assert set(rig.device.flowed) == {ZERO}
    rig.drive()  # and the command of before is forgotten
    assert {*rig.device.flowed[:-1]} == {ZERO} or rig.device.protocol != 'serial_transfer'


@every_protocol
def test_arming_tries_each_coil_and_then_lets_commands_flow(make, protocol):
    told, tags = [], []
    rig = make(on_reading=told.append, on_sent=tags.append, self_check=True,
               accept_no_watchdog=protocol in WITHOUT_WATCHDOG)
    driver, device = rig.driver, rig.device
    assert driver.gains is None
    rig.until(lambda: told)
    assert rig.ask() is None
    assert not driver.arming
    assert driver.gains == pytest.approx([1.0] * 4, abs=0.15)
    pulses = [[abs(current) > 0.1 for current in flowed]
              for flowed in device.flowed if any(flowed)]
    assert pulses == [[coil == pulsed for coil in range(4)] for pulsed in range(4)]
    unwatched = driver.warning.startswith('the amplifier has no watchdog')
    assert unwatched == (protocol in WITHOUT_WATCHDOG)
    if protocol == 'serial_transfer':
        assert 0.09 < driver.watchdog_s < 0.15
        assert device.causes[-1] == 'watchdog'
    else:
        assert driver.watchdog_s is None
    driver.command(ZERO)
    assert driver.command(DRIVING, 'tag')
    rig.until(lambda: device.flows(DRIVING))
    assert tags[0].tag == 'tag'
    rig.until(lambda: any(one.acknowledges is tags[0] for one in told))
    assert tags[0].currents_A == pytest.approx(DRIVING)
    count = len(device.flowed)
    assert rig.ask() is None  # armed already: nothing is tried again
    assert len(device.flowed) == count
    assert rig.stop() is Zero.CONFIRMED
    assert device.flowed[-1] == ZERO
    assert (driver.connected, rig.gate.armed) == (False, False)


def test_limits_with_which_a_self_check_shows_nothing_are_refused_before_arming(make):
    with pytest.raises(InputError, match='deviation_A'):
        make(self_check=True, deviation_A=1.0)
    make(self_check=False, deviation_A=1.0)


@pytest.mark.parametrize('watchdog_s', [0.4])
def test_the_zero_of_the_watchdog_is_no_fault_of_the_coils(make):
    """Though the pulse lasted for longer than a reading may be late."""
    rig = make(self_check=True, accept_no_watchdog=False, settling_s=0.05, feedback_timeout_s=0.2)
    rig.arm()
    assert rig.driver.watchdog_s == pytest.approx(0.4, abs=0.03)


@pytest.mark.parametrize('watchdog_s', [None])
def test_a_firmware_without_a_watchdog_is_found_out(make):
    rig = make(self_check=True, accept_no_watchdog=False)
    refusal = rig.until(lambda: 'watchdog' in (said := rig.ask() or '') and said)
    assert 'the amplifier has no watchdog' in refusal
    assert rig.gate.fault.reason is Reason.SELF_CHECK
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)
    assert (rig.gate.armed, rig.driver.gains, rig.driver.watchdog_s) == (False, None, None)


@every_protocol
@pytest.mark.parametrize(('fault', 'sentence'), [
    ('open=2', 'coil_plus_x is open'), ('reversed=3', 'coil_minus_y is reversed'),
    ('half_gain=4', 'coil_minus_x has the wrong gain, 0.5')])
def test_a_coil_that_is_wrong_refuses_arming(make, fault, sentence):
    rig = make(self_check=True, deviation_A=0.2, settling_s=0.5)
    rig.device.fault(fault)
    refusal = rig.until(lambda: 'coil_' in (said := rig.ask() or '') and said)
    assert refusal.startswith(f'self-check: {sentence}')
    assert rig.gate.fault.reason is Reason.SELF_CHECK
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)
    assert not rig.gate.armed
    assert rig.driver.gains is None
    assert not rig.driver.command(DRIVING)
    rig.device.mend()
    rig.arm()
    assert rig.gate.fault is None
    rig.drive()


def test_a_refusal_tells_the_reason(rig):
    rig.device.coils.command(DRIVING)  # a hand at the board
    assert rig.until(lambda: rig.gate.fault).reason is Reason.UNCOMMANDED
    assert rig.ask().endswith('measured while zero is commanded')
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)  # as it is said again and again


def test_commands_during_the_check_go_nowhere(make):
    rig = make(self_check=True)
    rig.turn(0.1)
    answer = rig.driver.request_arming(rig.driver.epoch)

    def armed():
        assert not rig.driver.command((0.0, 0.0, 0.0, 1.9)) or answer.done()
        return answer.done()

    rig.until(armed)
    assert answer.result() is None
    assert all(abs(current) < 1.0 for one in rig.device.flowed for current in one)


@pytest.mark.parametrize('watchdog_s', [0.4])
def test_a_pulse_that_lasts_is_not_a_stale_command(make):
    rig = make(self_check=True, accept_no_watchdog=False, command_timeout_s=0.25)
    rig.arm()
    assert rig.driver.watchdog_s > 0.3


def test_a_held_command_feeds_the_watchdog_of_the_device_and_does_not_flood_it(make):
    rig = make(command_timeout_s=60.0).drive()
    sent = rig.driver.amplifier.counters.frames_sent
    rig.turn(2.0)
    assert rig.device.flows(DRIVING)
    assert 'watchdog' not in rig.device.causes
    assert rig.driver.amplifier.counters.frames_sent - sent == pytest.approx(50, abs=7)


@every_protocol
def test_a_command_that_goes_stale_ends_in_zero(make, protocol):
    rig = make(command_timeout_s=0.075 if protocol != 'scpi' else 0.3).drive()
    last_s = rig.device.times[-1]
    assert rig.tripped(Reason.STALE).detail.startswith('none for')
    # The dead-man's own time, a tick, and what the line takes.
    assert rig.device.times[-1] - last_s < rig.gate.limits.command_timeout_s + 0.025
    assert rig.driver.zero is not None


def test_a_command_that_waited_too_long_goes_nowhere(make):
    waiting_s = [0.0]
    rig = make(on_reading=lambda _: rig.clock.sleep(waiting_s.pop() if waiting_s else 0.0),
               command_timeout_s=0.5)
    rig.arm()
    rig.turn(0.1)
    rig.driver.command(DRIVING)
    rig.clock.sleep(0.6)  # the thread is held up
    assert rig.tripped(Reason.STALE).detail.startswith('given')
    assert {*rig.device.flowed} == {ZERO}


def test_the_newest_command_takes_the_place_of_one_that_waits(rig):
    rig.drive()
    count = len(rig.device.flowed)
    for share in range(1, 21):
        rig.driver.command([share / 20, 0, 0, 0])
    rig.turn(0.1)
    assert rig.device.flowed[count:] == [pytest.approx([1.0, 0, 0, 0])]


@pytest.mark.parametrize(('bad', 'reason'), [
    ((math.nan, 0, 0, 0), Reason.MALFORMED), ((0, math.inf, 0, 0), Reason.MALFORMED),
    ((0, 0, 0), Reason.MALFORMED), ((0, 0, -2.1, 0), Reason.LIMIT)])
def test_a_bad_command_ends_in_zero_until_armed_again(rig, bad, reason):
    rig.drive()
    rig.driver.command(bad)
    rig.tripped(reason)
    rig.drive()
    assert rig.gate.fault is None


def test_disarming_zeroes_at_once(rig):
    rig.drive()
    before_s = rig.clock.now_s
    assert not rig.driver.request_zero().is_set()
    rig.until(lambda: rig.device.flows(ZERO))
    assert rig.clock.now_s - before_s < 0.006
    assert (rig.gate.fault, rig.gate.armed) == (None, False)
    assert not rig.driver.command(DRIVING)
    rig.driver.disarm((Reason.COMMANDER, 'nothing to tell of'))
    rig.turn(0.1)
    assert rig.gate.fault is None
    rig.drive()
    rig.driver.disarm((Reason.COMMANDER, 'somebody else'))
    assert rig.tripped(Reason.COMMANDER).detail == 'somebody else'


def test_a_request_to_zero_is_done_when_it_went_out(rig):
    rig.drive()
    done = rig.driver.request_zero()
    rig.until(done.is_set)
    assert rig.driver._sent == ZERO
    rig.until(lambda: rig.device.flows(ZERO), 0.01)
    rig.device.fault('unplug')
    rig.turn(0.1)
    rig.until(rig.driver.request_zero().is_set)  # there is no line, and nobody waits for it


@every_protocol
@pytest.mark.parametrize('fault', ['open=1', 'silence', 'reset=9000'])
def test_a_fault_of_the_device_ends_in_zero(make, fault, protocol):
    rig = make(feedback_timeout_s=0.4).drive()
    rig.command_for(0.8)  # then zeros are no late reading of what was before
    rig.device.fault(fault)
    begin_s = rig.clock.now_s
    while not rig.gate.fault:
        rig.driver.command(DRIVING)
        rig.turn(0.005)
        assert rig.gate.fault or rig.clock.now_s - begin_s < 1.0
    polled_silence = fault != 'open=1' and protocol != 'serial_transfer'
    assert rig.gate.fault.reason is (
        Reason.DEVIATION if fault == 'open=1' else Reason.LINE if polled_silence
        else Reason.SILENCE)
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)
    assert rig.device.times[-1] - begin_s < 0.4 + SOON_S


@pytest.mark.parametrize('protocol', ['roboteq', 'roboclaw', 'modbus', 'scpi'])
def test_what_the_device_says_of_itself_is_a_fault(make):
    rig = make(self_check=True, feedback_timeout_s=30.0, settling_s=20.0)
    rig.arm()
    rig.device.fault('over_temperature')
    fault = rig.until(lambda: rig.gate.fault)
    assert fault.reason is Reason.DEVICE
    assert rig.ask() == fault.detail
    assert not rig.gate.armed


@every_protocol
def test_a_lost_line_comes_back_at_zero_and_disarmed(rig):
    rig.drive()
    rig.device.coils.watchdog_s, rig.device.coils._deadline_s = None, math.inf
    rig.device.coils.feed = lambda: None  # no watchdog helps
    rig.device.fault('unplug+3')
    assert rig.until(lambda: rig.gate.fault).reason is Reason.LINE
    rig.until(lambda: not rig.driver.connected)
    assert rig.driver.zero is Zero.UNREACHABLE
    assert rig.driver.amplifier.unreachable
    assert rig.ask() == 'the amplifier is not connected'
    assert not rig.driver.command(DRIVING)
    rig.until(lambda: rig.driver.connected, 10.0)
    assert rig.device.flows(ZERO)
    assert rig.gate.fault.reason is Reason.LINE
    assert rig.driver.zero is Zero.CONFIRMED
    rig.arm()
    assert rig.device.flows(ZERO)  # what was commanded in between is forgotten
    rig.drive()


@every_protocol
def test_a_line_that_is_back_is_at_zero_within_a_moment(rig):
    """However long it was away: the pause between attempts does not grow."""
    rig.drive()
    rig.device.coils.feed = lambda: None
    rig.device.coils._deadline_s = math.inf
    rig.device.fault('unplug+10')
    rig.until(lambda: not rig.driver.connected)
    rig.turn(9.0)
    rig.until(lambda: rig.device.lines[0]._plugged, 10.0)
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)


def test_a_line_that_is_away_is_tried_ten_times_a_second(rig):
    rig.device.fault('unplug')
    rig.until(lambda: not rig.driver.connected)
    tried = len(rig.device.opened)
    rig.turn(1.0)
    assert len(rig.device.opened) - tried == pytest.approx(10, abs=1)


def test_stopping_while_the_line_is_away(rig):
    rig.device.fault('unplug')
    rig.until(lambda: not rig.driver.connected)
    assert rig.stop() is Zero.UNREACHABLE


def checking(make, **options):
    """A rig in a self-check that never ends, and what arming will answer."""
    rig = make(self_check=True, **options)
    rig.driver._go_on_checking = lambda *_: None
    rig.turn(0.1)
    answer = rig.driver.request_arming(rig.driver.epoch)
    rig.until(lambda: rig.driver.arming)
    return rig, answer


def test_stopping_during_the_check_answers(make):
    rig, answer = checking(make, settling_s=5.0)
    assert rig.ask() == 'a self-check is already running'
    assert not rig.driver.command(DRIVING)
    rig.stop()
    assert answer.result() == 'the coil driver stopped'


def test_disarming_during_the_check_ends_it(make):
    rig, answer = checking(make)
    rig.driver.disarm()
    rig.until(answer.done)
    assert answer.result() == 'disarmed meanwhile'
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)
    del rig.driver._go_on_checking
    rig.drive()


@every_protocol
@pytest.mark.parametrize(('fault', 'reasons'), [
    ('silence', (Reason.SILENCE, Reason.LINE)), ('unplug+0.2', (Reason.LINE,))])
def test_a_line_that_fails_during_the_check_ends_it(make, fault, reasons):
    rig = make(self_check=True, settling_s=0.5)
    rig.turn(0.1)
    rig.device.coils.feed = lambda: None  # no watchdog helps
    rig.device.fault('delay=10')  # so that a pulse lasts
    answer = rig.driver.request_arming(rig.driver.epoch)
    rig.until(lambda: any(rig.device.coils.currents_A))
    rig.device.fault(fault)
    rig.until(answer.done)
    assert rig.gate.fault.reason in reasons
    assert answer.result().startswith(rig.gate.fault.reason.value)
    assert not rig.gate.armed
    rig.until(lambda: rig.device.flows(ZERO), 0.4)


@pytest.mark.parametrize('where', ['on_reading', 'on_sent', 'write'])
def test_whatever_fails_ends_in_zero_and_the_thread_goes_on(make, where, monkeypatch):
    failing = []

    def fail(_):
        if failing:
            raise RuntimeError('subscriber gone')

    rig = make(**{where: fail} if where != 'write' else {}).drive()
    write = rig.driver.amplifier.write

    def refuse(currents, *more):
        if failing and any(currents):
            raise RuntimeError('subscriber gone')
        return write(currents, *more)

    if where == 'write':
        monkeypatch.setattr(rig.driver.amplifier, 'write', refuse)
    failing.append(True)
    rig.driver.command((0.5, 0, 0, 0), 'tag')
    assert 'subscriber gone' in rig.tripped(Reason.INTERNAL).detail
    failing.clear()
    rig.drive()


def test_a_failing_device_does_not_take_all_of_the_processor(rig, monkeypatch):
    tries = []

    def poll(_):
        tries.append(rig.clock.now_s)
        raise RuntimeError('driver broken')

    monkeypatch.setattr(rig.driver.amplifier, 'poll', poll)
    rig.until(lambda: len(tries) > 10)
    assert tries[10] - tries[0] >= 9 * coil_driver._TICK_S


@pytest.mark.parametrize('protocol', ['roboclaw'])
def test_a_device_that_cannot_be_read_any_more_is_zeroed(rig, monkeypatch):
    rig.drive()
    rig.device.coils.feed = lambda: None
    rig.device.coils._deadline_s = math.inf

    def poll(_):
        raise RuntimeError('driver broken')

    monkeypatch.setattr(rig.driver.amplifier, 'poll', poll)
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)


def test_an_error_on_the_way_to_zero_does_not_end_the_thread(rig, monkeypatch):
    rig.drive()

    def broken(*_):
        raise RuntimeError('broken')

    monkeypatch.setattr(rig.driver.amplifier, 'write', broken)
    assert rig.until(lambda: rig.gate.fault).reason is Reason.INTERNAL
    monkeypatch.undo()
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)
    rig.drive()


@pytest.mark.parametrize('fault', ['drop=0.02', 'double=0.02', 'truncate=0.3'])
def test_a_damaged_line_never_drives_a_wrong_current(rig, fault):
    rig.drive()
    rig.device.fault(fault)
    rig.command_for(1.0)
    rig.stop()
    assert rig.driver.amplifier.counters.discarded_bytes > 0
    assert all(max(abs(a - b) for a, b in zip(flowed, want, strict=True)) < 0.02
               for flowed in rig.device.flowed
               for want in [DRIVING if any(flowed) else ZERO])


def test_bits_that_flip_in_pairs_and_pass_a_crc_of_8_bits_do_not_last(rig):
    """One damaged packet in 256 gets through: what then flows deviates, or the next ends it."""
    rig.drive()
    rig.device.fault('flip=0.05')
    rig.command_for(2.0)
    rig.device.mend()
    rig.stop()
    assert rig.device.flows(ZERO)
    assert all(abs(current) <= FULL_SCALE_A for flowed in rig.device.flowed for current in flowed)


# What is refused before anything moves ----------------------------------------------------------

def test_without_a_device_it_does_not_start():
    rig = Rig()
    assert rig.driver.zero is Zero.UNREACHABLE
    rig.device.fault('silence')
    with pytest.raises(NoAnswerError):
        rig.driver.start()
    assert not [one for one in threading.enumerate() if one.name == 'coil driver']
    assert not rig.driver.connected
    assert rig.driver.arm() == 'the amplifier is not connected'
    assert not rig.driver.command(DRIVING)
    assert rig.driver.stop() is Zero.UNREACHABLE


@pytest.mark.parametrize('full_scale_A', [math.nextafter(FULL_SCALE_A, 0), [9.0, 9.0, 1.0, 9.0]])
def test_limits_that_allow_too_much_are_refused(full_scale_A):
    with pytest.raises(InputError, match='at most the full scale'):
        CoilDriver(amplifier_class('serial_transfer')('nowhere', full_scale_A), LIMITS, print)


@pytest.mark.parametrize(('protocol', 'self_check', 'accepted', 'right'), [
    ('modbus', True, False, False), ('modbus', True, True, True), ('modbus', False, True, True),
    ('scpi', True, False, False), ('scpi', True, True, True),
    ('serial_transfer', False, False, False), ('serial_transfer', True, False, True),
    ('serial_transfer', False, True, True), ('roboclaw', False, False, True),
    ('roboclaw', True, True, True)])
def test_what_has_no_watchdog_must_be_accepted(protocol, self_check, accepted, right):
    amplifier = amplifier_class(protocol)('a,b,c,d' if protocol == 'scpi' else 'a', FULL_SCALE_A)
    if right:
        driver = CoilDriver(amplifier, LIMITS, print, self_check=self_check,
                            accept_no_watchdog=accepted)
        assert bool(driver.warning) == (accepted and protocol != 'roboclaw')
        assert ('loses its power' in driver.warning) == bool(driver.warning)
    else:
        with pytest.raises(InputError, match='accept_no_watchdog'):
            CoilDriver(amplifier, LIMITS, print, self_check=self_check)  # which is not accepted


@pytest.mark.parametrize(('url', 'accepted', 'right'), [
    ('rfc2217://box:4000', False, False), ('rfc2217://box:4000', True, True),
    ('/dev/ttyUSB0', False, True)])
def test_a_port_that_no_sentinel_can_hold_must_be_accepted(url, accepted, right):
    """A sabertooth never says whether its timeout is armed: a sentinel watches as well."""
    options = {'self_check': False, 'accept_no_feedback': True, 'accept_no_watchdog': accepted}
    amplifier = amplifier_class('sabertooth')(url, FULL_SCALE_A)
    if right:
        driver = CoilDriver(amplifier, LIMITS, print, **options)
        assert ('this program is killed' in driver.warning) == (not amplifier.watchable)
    else:
        with pytest.raises(InputError, match='accept_no_watchdog: the sentinel cannot open'):
            CoilDriver(amplifier, LIMITS, print, **options)


# What is known of a zero ------------------------------------------------------------------------

@every_protocol
def test_a_zero_is_confirmed_by_a_reading_that_was_taken_after_it(rig):
    rig.drive()
    assert rig.driver.zero is None
    rig.driver.disarm()
    states = []

    def confirmed():
        states.append(rig.driver.zero)
        assert states[-1] is not Zero.CONFIRMED or rig.device.flows(ZERO)
        return states[-1] is Zero.CONFIRMED

    rig.until(confirmed, 0.5)
    assert states[-2] in (Zero.SENT, None)


def test_a_zero_that_nothing_reads_back_is_sent_and_not_confirmed(make):
    rig = make(feedback_timeout_s=0.3).drive()
    rig.device.fault('silence')
    rig.driver.disarm()
    rig.turn(0.3)
    assert rig.driver.zero is Zero.SENT
    assert not rig.driver.zero_overdue
    rig.turn(0.7)
    assert rig.driver.zero is Zero.SENT
    assert rig.driver.zero_overdue
    rig.device.mend()
    rig.until(lambda: rig.driver.zero is Zero.CONFIRMED)
    assert not rig.driver.zero_overdue
    rig.device.fault('silence')
    rig.turn(0.3 + 0.05)
    assert rig.driver.zero is Zero.SENT  # what was seen once is not seen for ever


def test_what_was_known_before_says_nothing_of_a_zero_that_was_not_sent(rig):
    rig.until(lambda: rig.driver.zero is Zero.CONFIRMED)
    sent = threading.Event()  # a thread that hangs takes no request
    assert rig.driver.await_zero(sent) is Zero.UNREACHABLE
    sent.set()
    assert rig.driver.await_zero(sent) is Zero.CONFIRMED


def test_what_reads_nothing_back_is_never_confirmed():
    rig = VirtualDriver(VirtualAmplifier('sabertooth'), LIMITS, self_check=False,
                        accept_no_feedback=True)
    rig.connect()
    assert rig.driver.zero is Zero.SENT
    rig.turn(1.0)
    assert rig.driver.zero is Zero.SENT
    assert not rig.driver.zero_overdue
    sent = rig.driver.request_zero()
    rig.until(sent.is_set)
    begin_s = rig.clock.now_s
    assert rig.driver.await_zero(sent) is Zero.SENT
    assert rig.clock.now_s - begin_s < 0.003  # as nobody waits for what cannot come


def test_a_reading_from_before_the_zero_does_not_confirm_it(rig):
    rig.turn(0.1)
    driver, amplifier = rig.driver, rig.driver.amplifier
    since_s = rig.clock.now_s
    driver._zero_since_s, driver._zero_seen_s = since_s, -math.inf
    for after_s, currents, zero in (
            (0.0, ZERO, Zero.SENT), (0.024, ZERO, Zero.SENT), (0.0251, ZERO, Zero.CONFIRMED),
            (0.026, (0.0, 0.3, 0.0, 0.0), Zero.SENT), (0.03, (math.nan,) * 4, Zero.SENT),
            (0.04, ZERO, Zero.CONFIRMED)):
        rig.clock.now_s = since_s + after_s
        driver._look_for_zero(amplifier._reading(
            since_s + after_s, since_s + after_s, np.array(currents)), since_s + after_s)
        assert driver.zero is zero


@pytest.mark.parametrize('protocol', ['roboclaw', 'roboteq', 'modbus', 'scpi'])
@pytest.mark.parametrize('later', ['unplugged', 'stuck'])
def test_what_was_seen_when_a_line_was_given_up_is_not_seen_any_more(make, later):
    rig = make(command_timeout_s=0.3)
    rig.device.fault('silence+0.4')
    rig.until(lambda: not rig.driver.connected)
    assert rig.driver._left is Zero.CONFIRMED
    assert rig.driver.zero is Zero.SENT
    rig.device.mend()
    if later == 'unplugged':
        rig.device.fault('unplug')
    else:  # a bridge that conducts whatever it is told
        rig.device.coils._settle = lambda _: None
        rig.device.coils.currents_A = (1.0,) * rig.device.coils.channels
    rig.turn(2.0)
    assert not rig.driver.connected
    assert rig.driver.zero is (Zero.UNREACHABLE if later == 'unplugged' else Zero.SENT)
    assert rig.stop() is rig.driver.zero


@pytest.mark.parametrize('protocol', ['roboclaw', 'roboteq', 'modbus', 'scpi'])
def test_a_zero_that_was_seen_when_a_line_was_given_up_is_not_confirmed_at_the_end(make):
    rig = make(command_timeout_s=0.3)
    rig.device.fault('silence+0.4')
    rig.until(lambda: not rig.driver.connected)
    assert rig.driver._left is Zero.CONFIRMED
    assert rig.stop() is Zero.SENT


@pytest.mark.parametrize(('late_ms', 'after_s'), [(0, 0.0), (5, 0.005), (16, 0.005), (20, 0.01)])
def test_a_report_from_before_the_zero_ends_no_session(late_ms, after_s):
    """One zero is damaged on its way; nothing watches the board."""
    rig = Rig(watchdog_s=None)
    rig.connect()
    if late_ms:
        rig.device.fault(f'delay={late_ms}')
    rig.turn(0.3)
    rig.arm()
    rig.turn(0.05)
    rig.driver.command((1.0, 0.0, 0.0, 0.0))
    rig.until(lambda: any(rig.gate.output))
    rig.turn(after_s)
    receive, damaged = rig.device.device.receive, [True]

    def receive_damaged(port, data, now):
        spoiled = damaged and damaged.pop()
        return receive(port, bytes(one ^ 1 for one in data) if spoiled else data, now)
    rig.device.device.receive = receive_damaged
    assert rig.stop() is Zero.CONFIRMED
    rig.clock.sleep(2.0)
    assert rig.device.flows(ZERO)


def test_a_report_over_a_network_may_be_older():
    amplifier = amplifier_class('serial_transfer')
    assert 0.2 <= amplifier('socket://rig:4000', 2.0).report_age_s <= 0.5
    assert amplifier('/dev/ttyACM0', 2.0).report_age_s < 0.05


@pytest.mark.parametrize('armed', [True, False])
@pytest.mark.parametrize('away_ms', [1, 20, 40, 80])
def test_a_board_that_lost_its_watchdog_in_a_reset_gets_it_again(armed, away_ms):
    rig = Rig('roboclaw')
    rig.connect()
    rig.turn(0.5)
    if armed:
        rig.drive((1.0,) * 4)
    rig.device.fault(f'reset={away_ms}')
    rig.turn(0.7)
    assert rig.device.coils.watchdog_s == 0.1
    if armed:
        assert not rig.gate.armed


def test_current_that_stays_is_no_zero_and_outranks_what_stopped_it(make):
    rig = make(command_timeout_s=0.3).drive()
    stuck = rig.device.coils._settle
    rig.device.coils._settle = lambda _: None  # a bridge that conducts whatever it is told
    assert rig.until(lambda: rig.gate.fault).reason is Reason.STALE
    rig.until(lambda: rig.gate.fault.reason is Reason.UNCOMMANDED, 1.0)
    assert rig.driver.zero is Zero.SENT
    sent = rig.driver.amplifier.counters.frames_sent
    rig.turn(0.2)
    assert rig.driver.amplifier.counters.frames_sent >= sent + 4  # and zero is said again
    rig.device.coils._settle = stuck
    rig.until(lambda: rig.device.flows(ZERO), SOON_S)
    rig.until(lambda: rig.driver.zero is Zero.CONFIRMED, SOON_S)


def test_nothing_is_said_of_a_zero_while_one_coil_is_driven(rig):
    rig.drive((0.0, 0.0, 0.5, 0.0))
    assert rig.driver.zero is None
    rig.turn(0.2)
    assert rig.driver.zero is None


def test_a_zero_is_awaited_until_it_is_confirmed_or_time_is_up(rig):
    rig.drive()
    begin_s = rig.clock.now_s
    sent = rig.driver.request_zero()
    assert rig.driver.await_zero(sent) is Zero.UNREACHABLE  # as nobody sends it
    assert rig.clock.now_s - begin_s == pytest.approx(PATIENCE.read_back_s)
    rig.until(sent.is_set)
    begin_s = rig.clock.now_s
    assert rig.driver.await_zero(sent) is Zero.SENT  # as nobody reads it back
    assert rig.clock.now_s - begin_s == pytest.approx(PATIENCE.read_back_s, abs=0.003)
    rig.turn(0.1)
    begin_s = rig.clock.now_s
    assert rig.driver.await_zero(sent) is Zero.CONFIRMED
    assert rig.clock.now_s - begin_s < 0.003


LINES = [('scpi', line) for line in (1, 2, 3, 4)] + [('roboteq', 1), ('roboteq', 2)]


@pytest.mark.parametrize(('protocol', 'line'), LINES)
@pytest.mark.parametrize('when', ['armed', 'zeroing', 'reconnecting'])
def test_of_several_lines_the_others_are_at_zero_and_the_lost_one_is_named(rig, line, when):
    """Until it is back, and then it is at zero too."""
    rig.device.coils.feed = lambda: None  # no watchdog helps
    rig.drive()
    if when == 'zeroing':
        rig.driver.request_zero()
    if when == 'reconnecting':
        rig.device.fault('unplug+1')
        rig.until(lambda: not rig.driver.connected)
        rig.device.fault(f'unplug/{line}@1+6')
        rig.turn(1.0)
    else:
        rig.device.fault(f'unplug/{line}+6')
    per_line = 4 // len(rig.device.lines)
    others = [coil for coil in range(4) if coil // per_line != line - 1]
    rig.until(lambda: not any(rig.device.coils.currents_A[coil] for coil in others), SOON_S)
    rig.turn(2.0)
    assert not any(rig.device.coils.currents_A[coil] for coil in others)
    assert rig.driver.zero is Zero.UNREACHABLE
    assert rig.driver.amplifier.unreachable == (rig.device.urls[line - 1],)
    assert rig.ask() == 'the amplifier is not connected'
    rig.turn(6.0)
    rig.until(lambda: rig.driver.zero is Zero.CONFIRMED, 5.0)
    assert rig.device.flows(ZERO)


class Sentinel:
    """Writes down how it ends."""

    ended: list[str] = []  # noqa: RUF012 — emptied by its fixture

    def __init__(self, words):
        self.there = True

    def feed(self):
        return self.there

    def dismiss(self):
        self.ended.append('dismissed')

    def abandon(self):
        self.ended.append('abandoned')
        self.left_at()

    def left_at(self):
        pass


@pytest.fixture
def sentinel(monkeypatch):
    Sentinel.ended.clear()
    monkeypatch.setattr(coil_driver, 'LastResort', Sentinel)
    return Sentinel.ended


@pytest.mark.parametrize(('protocol', 'fault', 'end'), [
    ('scpi', None, 'dismissed'), ('modbus', None, 'dismissed'), ('scpi', 'unplug/3', 'abandoned'),
    ('scpi', 'silence/1', 'abandoned'), ('modbus', 'silence', 'abandoned'),
    ('modbus', 'unplug', 'abandoned')])
def test_the_sentinel_is_dismissed_by_a_confirmed_zero_alone(protocol, fault, end, sentinel):
    rig = Rig(protocol)
    rig.driver.amplifier.last_words = lambda: [(0, b'')]
    rig.connect().drive()
    if fault:
        rig.device.fault(fault)
    rig.stop()
    assert sentinel == [end]


def test_without_its_sentinel_the_coils_are_at_zero_and_another_begins(sentinel):
    rig = Rig('scpi')
    rig.driver.amplifier.last_words = lambda: [(0, b'')]
    rig.connect().drive()
    first = rig.driver._last_resort
    first.there = False
    first.left_at = lambda: sentinel.append(rig.driver._sent)
    assert 'sentinel' in rig.tripped(Reason.INTERNAL).detail
    assert rig.driver._last_resort is not first
    assert sentinel == ['abandoned', ZERO]  # zero goes out first
    rig.drive()
    assert rig.gate.fault is None


@pytest.mark.usefixtures('sentinel')
def test_a_sentinel_that_could_not_be_started_is_started_before_anything_is_driven(monkeypatch):
    rig = Rig('scpi')
    rig.driver.amplifier.last_words = lambda: [(0, b'')]
    rig.connect().drive()
    first, start, refusals = rig.driver._last_resort, coil_driver.LastResort, [True, True]

    def start_later(words):
        if refusals:
            refusals.pop()
            raise OSError(errno.ENOMEM, 'Cannot allocate memory')
        return start(words)
    monkeypatch.setattr(coil_driver, 'LastResort', start_later)
    first.there = False
    rig.tripped(Reason.INTERNAL)
    rig.drive()
    assert not refusals
    assert rig.driver._last_resort is not first
    assert rig.driver._last_resort.there


# Arming is asked in an epoch --------------------------------------------------------------------

@pytest.mark.parametrize('stop', ['disarm', 'fault', 'trip', 'line'])
def test_arming_from_before_a_stop_is_refused(make, stop):
    rig = make(command_timeout_s=0.3)
    rig.turn(0.1)
    epoch, wall_s = rig.driver.epoch, rig.driver.epoch_wall_s
    if stop == 'disarm':
        rig.driver.disarm()
    elif stop == 'fault':
        rig.device.coils.command(DRIVING)
    elif stop == 'trip':
        rig.drive()
    else:
        rig.device.fault('unplug+0.1')
    rig.until(lambda: rig.gate.fault or stop == 'disarm')
    rig.until(lambda: rig.driver.connected and rig.device.flows(ZERO))
    assert rig.driver.epoch > epoch
    assert rig.driver.epoch_wall_s > wall_s
    assert rig.ask(epoch) == STOPPED
    assert not rig.gate.armed
    rig.arm()


def test_an_epoch_lasts_until_something_stops_the_rig(rig):
    rig.drive()
    epoch = rig.driver.epoch
    rig.turn(0.5)
    assert rig.driver.epoch == epoch
    rig.tripped(Reason.STALE)
    rig.turn(0.5)
    assert rig.driver.epoch == epoch + 1  # though the fault stands


def test_a_stop_that_is_queued_before_arming_goes_first(make):
    """ARM, STOP, ARM: what would arm again was asked before the stop."""
    rig = make(self_check=True)
    rig.turn(0.1)
    epoch = rig.driver.epoch
    answers = [rig.driver.request_arming(epoch)]
    rig.driver.request_zero()
    answers.append(rig.driver.request_arming(epoch))
    rig.until(answers[-1].done)
    assert [answer.result() for answer in answers] == [STOPPED] * 2
    assert not rig.gate.armed
    assert set(rig.device.flowed) == {ZERO}


# Nothing from before arming flows ---------------------------------------------------------------

def test_a_command_from_before_arming_flows_only_after_a_zero(rig):
    rig.until(lambda: rig.ask() is None)
    rig.command_for(1.0)
    assert rig.gate.armed
    assert rig.gate.holding
    rig.driver.command(ZERO)
    rig.driver.command(DRIVING)  # takes the place of the zero in the mailbox
    rig.until(lambda: rig.device.flows(DRIVING))
    assert {*rig.device.flowed[:-1]} == {ZERO}


def test_a_zero_from_before_arming_does_not_count(rig):
    rig.driver.command(ZERO)
    rig.turn(0.1)
    rig.until(lambda: rig.ask() is None)
    rig.command_for(0.5)
    assert rig.gate.holding
    assert rig.device.flows(ZERO)


def test_a_zero_during_the_self_check_counts(make):
    rig = make(self_check=True)
    rig.turn(0.1)
    answer = rig.driver.request_arming(rig.driver.epoch)
    rig.until(lambda: rig.driver.arming)
    rig.driver.command(ZERO)
    rig.until(answer.done)
    rig.driver.command(DRIVING)
    rig.until(lambda: rig.device.flows(DRIVING), 0.1)


def test_currents_that_cancel_the_field_of_the_room_are_no_command_to_move(rig):
    rig.until(lambda: rig.ask() is None)
    cancelling = (0.03, 0.0, -0.03, 0.0)
    rig.driver.command(cancelling, neutral=True)
    rig.until(lambda: rig.device.flows(cancelling), 0.1)
    assert not rig.gate.holding


def test_a_field_that_turns_waits_for_a_zero_too(rig):
    rig.until(lambda: rig.ask() is None)
    for _ in range(30):
        rig.driver.turn(turning(1.0, 5.0))
        rig.turn(0.01)
    assert rig.device.flows(ZERO)
    rig.driver.command(ZERO)
    rig.turn(0.01)
    for _ in range(30):
        rig.driver.turn(turning(1.0, 5.0))
        rig.turn(0.01)
    assert rig.gate.fault is None
    assert max(abs(current) for current in rig.device.flowed[-1]) > 0.5


def test_what_turns_goes_stale_in_time_though_the_device_is_silent(make):
    rig = make(command_timeout_s=0.2)
    rig.arm()
    rig.driver.turn(turning(1.0, 5.0))
    given_s = rig.clock.now_s
    rig.turn(0.1)
    rig.device.fault('silence')
    assert rig.until(lambda: rig.gate.fault).reason is Reason.STALE
    assert rig.clock.now_s - given_s < 0.21


def test_a_zero_ends_what_turns(rig):
    rig.arm()
    rig.driver.turn(turning(1.0, 5.0))
    rig.turn(0.1)
    assert any(rig.device.flowed[-1])
    rig.driver.command(ZERO)
    rig.turn(0.01)
    count = len(rig.device.flowed)
    rig.turn(0.3)
    assert rig.gate.armed
    assert len(rig.device.flowed) == count
    assert rig.device.flows(ZERO)


def test_a_field_that_turned_before_a_stop_does_not_turn_after_arming(make):
    """Though the thread sees the stop and arming at once, and a zero comes during the check."""
    rig = make(self_check=True, command_timeout_s=60.0)
    rig.arm()
    rig.turn(0.01)
    rig.driver.turn(turning(0.1, 30.0))
    rig.turn(0.1)
    assert any(rig.device.flowed[-1])
    rig.driver.request_zero()
    answer = rig.driver.request_arming(rig.driver.epoch)
    rig.until(lambda: rig.driver.arming)
    rig.driver.command(ZERO)
    rig.until(answer.done)
    assert answer.result() is None
    count = len(rig.device.flowed)
    rig.turn(0.5)
    assert rig.gate.armed
    assert {*rig.device.flowed[count:]} <= {ZERO}
    assert rig.device.flows(ZERO)


def _array(values):
    return np.array(values, float)


def turning(amplitude_A, hertz):
    """Currents of so many amperes in four coils that turn, a quarter of a turn apart."""
    part = amplitude_A * _array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    return Turning(_array(ZERO), part, _array((0, 0, 1.0)), math.tau * hertz, _array((1.0, 0, 0)))


def test_an_operator_who_leaves_ends_the_permission(rig):
    rig.driver.attend()
    rig.drive()
    while not rig.gate.fault:
        rig.driver.command(DRIVING)
        rig.turn(0.05)
    rig.tripped(Reason.UNATTENDED)
    rig.turn(UNATTENDED_S)
    rig.drive()  # unattended, as no heartbeat came since
    rig.command_for(2 * UNATTENDED_S)
    assert rig.gate.armed


# What time does ---------------------------------------------------------------------------------

@pytest.mark.parametrize('protocol', ['scpi', 'modbus'])
def test_a_machine_that_was_suspended_wakes_at_zero_and_disarmed(rig):
    """The clock of the drive goes on meanwhile; nothing else does."""
    rig.drive()
    rig.clock.now_s += 3600.0
    rig.tripped(Reason.STALE if rig.gate.fault is None else rig.gate.fault.reason)
    assert rig.gate.heat[0] == pytest.approx((1.0 / 3.0)**2, rel=0.01)


def test_the_heat_of_before_keeps_a_hot_coil_from_being_driven(make):
    rig = make(heat=(0.0, 1.2, 0.0, 0.0))
    rig.turn(0.1)
    assert rig.ask().startswith('a coil is at 120% of its thermal limit')
    rig.turn(20.0)
    rig.drive()


# A board that turns the field by itself ---------------------------------------------------------

@pytest.mark.parametrize(('amplitude_A', 'hertz', 'reason'), [
    (1.0, 5.0, None), (1.0, 24.0, None), (1.0, 26.0, Reason.SLEW), (1.3, 5.0, None)])
def test_what_a_board_turns_is_judged_before_it_is_sent(swinging, amplitude_A, hertz, reason):
    """A sine of 1 A and 26 Hz changes by 104 A/s, whatever samples of it look like."""
    rig, swings = swinging(slew_A_per_s=100.0, command_timeout_s=60.0)
    rig.driver.turn(turning(amplitude_A, hertz))
    if reason is None:
        rig.turn(0.5)
        assert rig.gate.fault is None
        assert rig.driver._swinging
    else:
        rig.tripped(reason)
    assert any(swings) == (reason is None)


@pytest.fixture
def swinging(make, monkeypatch):
    """A function that makes an armed rig whose board turns by itself, and a list of whether each
    packet let it."""
    def swing(**limits):
        rig, swings = make(**limits), []
        write = rig.driver.amplifier.write

        def noted(currents, tag=None, swing=None):
            swings.append(swing is not None)
            return write(currents, tag, swing)

        monkeypatch.setattr(rig.driver.amplifier, 'write', noted)
        rig.driver.amplifier.swings = True
        rig.arm()
        rig.turn(0.05)
        return rig, swings
    return swing


def test_a_board_that_turns_is_stopped_as_soon_as_a_fault_comes(swinging):
    rig, swings = swinging(command_timeout_s=0.2)
    rig.driver.turn(turning(1.0, 5.0))
    rig.until(lambda: any(swings))
    assert rig.until(lambda: rig.gate.fault).reason is Reason.STALE
    assert rig.driver._sent == ZERO
    assert not rig.driver._swinging
    assert not swings[-1]


def test_a_stop_on_a_line_that_is_lost_is_answered_by_the_loss(rig, monkeypatch):
    """Not by how an earlier loss ended."""
    rig.drive()
    rig.driver._left = Zero.SENT
    amplifier, seen = rig.driver.amplifier, []
    close = amplifier.close

    def lost(*_):
        raise NoAnswerError('line', 'no byte could be written')

    def closing():
        seen.append((rig.driver.zero, done.is_set()))
        return close()
    monkeypatch.setattr(amplifier, 'write', lost)
    monkeypatch.setattr(amplifier, 'close', closing)
    done = rig.driver.request_zero()
    rig.until(done.is_set, SOON_S)
    assert seen == [(Zero.UNREACHABLE, False)]
    assert not rig.driver.connected


def test_no_zero_is_told_while_a_current_is_being_written(rig, monkeypatch):
    amplifier, told = rig.driver.amplifier, []
    write = amplifier.write

    def slowly(currents, *others):
        if any(currents):
            told.append(rig.driver.zero)
        return write(currents, *others)
    monkeypatch.setattr(amplifier, 'write', slowly)
    rig.drive()
    assert set(told) == {None}


def test_a_stop_in_the_turn_that_ends_the_check_refuses_arming(rig):
    answer = rig.driver._arming = Future()
    rig.driver._go_on_checking(
        SimpleNamespace(wanted=ZERO, done=True, gains=(1.0,) * 4, watchdog_s=None), 0.0)
    assert answer.result(0) == 'disarmed meanwhile'


def test_between_samples_of_a_slow_line_the_driver_looks_as_often_as_ever(rig):
    driver = rig.driver
    driver._rotation.follow(
        Turning(np.zeros(4), np.ones((4, 3)), np.array([0, 0, 1.0]), 1.0, np.array([1.0, 0, 0])),
        0.0, np.zeros(4))
    driver._sent_s = rig.clock.now()
    for sample_s, longest_s in ((0.07, 0.005), (0.002, 0.002)):
        driver.amplifier.sample_s = sample_s
        assert 0 < driver._patience_s() <= longest_s
