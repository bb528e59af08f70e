"""Whatever happens on the lines, in any order: no coil that can be reached keeps its current."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench._virtual import VirtualAmplifier, VirtualDriver
from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.errors import AmplifierError
from microbot_ros.drive.gate import Limits

PROTOCOLS = ('scpi', 'roboteq', 'roboclaw', 'modbus', 'serial_transfer', 'sabertooth')
DRIVING = (1.0, -1.0, 0.5, 0.7)
CHECKED = {'roboclaw', 'modbus', 'serial_transfer'}
"""Those that find every damaged byte of a command and of a reading."""

moments = st.integers(0, 600_000).map(lambda microseconds: microseconds * 1e-6)
currents = st.lists(st.sampled_from([0.0, 0.5, -1.0, 2.0]), min_size=4, max_size=4)
loud = st.sampled_from(['unplug', 'silence', 'delay=5', 'delay=40', 'reset=30'])
lasting = st.sampled_from([0.001, 0.03, 0.1, 0.3, 9.0])
faults = st.tuples(loud, st.integers(0, 4), moments, lasting)
waits = st.sampled_from([0.0, 0.005, 0.05, 0.3])
acts = st.one_of(
    st.tuples(st.just('write'), currents), st.tuples(st.just('poll'), waits),
    st.tuples(st.just('zero'), st.none()), st.tuples(st.just('close'), st.none()),
    st.tuples(st.just('connect'), st.none()))


class Story:
    """A driver and an emulated amplifier without any watchdog, to which things happen."""

    def __init__(self, protocol, planned):
        self.rig = VirtualAmplifier(protocol)
        self.rig.coils.feed = lambda: None
        self.amplifier = self.rig.amplifier()
        self.amplifier.connect()
        self.amplifier.write(DRIVING)
        self.rig.clock.wait_for(
            lambda: bool(self.amplifier.poll(0.01)) and self.rig.flows(DRIVING), 1.0)
        for kind, line, start_s, duration_s in planned:
            where = f'/{line}' if line and not kind.startswith('reset') else ''
            self.rig.fault(f'{kind}{where}@{start_s:.6f}+{duration_s:.6f}')

    def do(self, act, value, undamaged=True):
        """Do it; after an error no coil on a line that is there and undamaged carries current."""
        try:
            match act:
                case 'write':
                    self.amplifier.write(value)
                case 'poll':
                    self.amplifier.poll(value)
                case 'zero':
                    self.amplifier.zero()
                case 'connect':
                    self.amplifier.connect()
                case 'close':
                    self.check_closed(self.amplifier.close())
        except AmplifierError:
            if undamaged and act in ('poll', 'connect', 'zero'):
                assert not self.reached().any()

    def reached(self, *, without=()):
        """The currents of the coils whose lines are there, and which hear what is said."""
        rig, now_s = self.rig, self.rig.clock.now_s
        per_line = rig.coils.channels // len(rig.lines)
        return np.array([current for coil, current in enumerate(rig.coils.currents_A)
                         if (port := coil // per_line) is not None
                         and rig.faults.value('unplug', now_s, port) is None
                         and rig.lines[port].host is not None
                         and not rig.lines[port].host.lost
                         and rig.urls[port] not in without])

    def check_closed(self, zero):
        rig = self.rig
        assert not any(line.host for line in rig.lines)
        if zero is Zero.CONFIRMED:
            assert not any(rig.coils.currents_A)
            assert self.amplifier.unreachable == ()


def confirmed_or_named(amplifier, rig):
    """After the end: every coil is at zero, or on a line that is named."""
    zero = amplifier.close()
    per_line = rig.coils.channels // len(rig.lines)
    for coil, current in enumerate(rig.coils.currents_A):
        assert not current or rig.urls[coil // per_line] in amplifier.unreachable
    if zero is Zero.CONFIRMED:
        assert not any(rig.coils.currents_A)


every_protocol = pytest.mark.parametrize('protocol', PROTOCOLS)
happenings = st.lists(acts, min_size=1, max_size=12)
damaged = st.sampled_from(['drop=0.05', 'flip=0.05', 'double=0.05', 'truncate=0.1'])
damages = st.tuples(damaged, st.integers(0, 4), moments, lasting)


def orders_of(quickly):
    """So many examples, and in `make soak` ten thousand."""
    return pytest.mark.parametrize('examples', [quickly, pytest.param(
        10_000, marks=[pytest.mark.soak, pytest.mark.timeout(7200)])])


def tell(examples, story, *strategies):
    """Tell a story in so many examples, the same on every run."""
    settings(max_examples=examples, deadline=None, derandomize=True)(given(*strategies)(story))()


@every_protocol
@orders_of(60)
def test_any_order_of_lost_silent_and_slow_lines(protocol, examples):
    def lost(planned, happening):
        story = Story(protocol, planned)
        for act, value in happening:
            story.do(act, value)
        if story.amplifier._lines:
            confirmed_or_named(story.amplifier, story.rig)

    tell(examples, lost, st.lists(faults, min_size=1, max_size=4), happenings)


@every_protocol
@orders_of(60)
def test_any_order_of_damaged_lines(protocol, examples):
    """What is damaged may keep a current; no zero is called confirmed that is none."""
    def damaging(planned, happening, seed):
        story = Story(protocol, planned)
        story.rig.faults._random.seed(seed)
        for act, value in happening:
            if act != 'close' or protocol in CHECKED:
                story.do(act, value, undamaged=False)
        if story.amplifier._lines and protocol in CHECKED:
            zero = story.amplifier.close()
            assert zero is not Zero.CONFIRMED or not any(story.rig.coils.currents_A)

    tell(examples, damaging, st.lists(damages | faults, min_size=1, max_size=4), happenings,
         st.integers(0, 1000))


# With the driver of the coils ---------------------------------------------------------------

SOON_S = 0.2
LIMITS = Limits(
    current_A=2.0, step_A=4.0, slew_A_per_s=1e4, command_timeout_s=0.075, deviation_A=0.2,
    settling_s=0.1, feedback_timeout_s=0.2, rated_current_A=3.0, thermal_s=60.0, idle_s=10.0)
turns = st.sampled_from([0.001, 0.02, 0.1, 0.4])
orders = st.one_of(
    st.tuples(st.just('command'), currents), st.tuples(st.just('drive'), turns),
    st.tuples(st.just('turn'), turns), st.tuples(st.just('arm'), st.none()),
    st.tuples(st.just('stop'), st.none()))


class DrivenStory:
    """A driver of the coils, to whose lines things happen while it is armed and commanded."""

    def __init__(self, protocol, planned):
        device = VirtualAmplifier(protocol)
        device.coils.feed = lambda: None  # no watchdog helps
        self.device, self.clock = device, device.clock
        measures = amplifier_class(protocol).reads_back
        self.rig = VirtualDriver(device, LIMITS, self_check=measures, accept_no_watchdog=True,
                                 accept_no_feedback=True)
        self.rig.connect()
        self.rig.turn(0.05)
        self.rig.drive(DRIVING)
        self.asked_s = self.clock.now_s
        """When somebody wanted current last."""
        self.away_s = [-np.inf] * len(device.lines)
        """When each line was away last."""
        self.arming = None
        for kind, line, start_s, duration_s in planned:
            where = f'/{line}' if line and not kind.startswith('reset') else ''
            device.fault(f'{kind}{where}@{start_s:.6f}+{duration_s:.6f}')

    def do(self, act, value):
        """Do it, and look after every turn of the driver."""
        driver = self.rig.driver
        match act:
            case 'command':
                self.command(value)
            case 'drive':
                for _ in range(max(int(value / 0.02), 1)):
                    self.command(DRIVING)
                    self.turn(0.02)
            case 'turn':
                self.turn(value)
            case 'arm':
                self.arming = driver.request_arming(driver.epoch)
            case 'stop':
                driver.request_zero()

    def command(self, wanted):
        self.rig.driver.command(wanted)
        self.asked_s = self.clock.now_s

    def turn(self, seconds):
        end_s = self.clock.now_s + seconds
        self.rig.until(lambda: self.look() or self.clock.now_s >= end_s)

    def look(self):
        """No coil on a line that is there carries current that nobody has wanted for 200 ms."""
        now_s, device = self.clock.now_s, self.device
        if self.arming is not None and not self.arming.done():
            self.asked_s = now_s
        per_line = device.coils.channels // len(device.lines)
        for port in range(len(device.lines)):
            if device.faults.value('unplug', now_s, port) is not None:
                self.away_s[port] = now_s
            unwanted_s = now_s - max(self.asked_s, self.away_s[port])
            flows = any(device.coils.currents_A[port * per_line:(port + 1) * per_line])
            assert not flows or unwanted_s <= SOON_S + 0.01


@every_protocol
@orders_of(30)
def test_no_current_outlives_whoever_wants_it(protocol, examples):
    def driven(planned, happening):
        story = DrivenStory(protocol, planned)
        for act, value in happening:
            story.do(act, value)
        story.turn(0.5)

    tell(examples, driven, st.lists(faults, min_size=1, max_size=3),
         st.lists(orders, min_size=1, max_size=8))
