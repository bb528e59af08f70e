"""The reference firmware on a simulated ATmega328P, with the host's driver at its UART.

Needs avr-gcc, avr-libc, cc and libsimavr (Debian: gcc-avr avr-libc libsimavr-dev libelf-dev);
what is missing is named in the reason for skipping.
"""

import ctypes
import json
import math
import shutil
import struct
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import serial

from microbot_ros.drive.amplifiers.serial_transfer import codec
from microbot_ros.drive.amplifiers.serial_transfer.driver import SerialTransferAmplifier
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits

pytestmark = pytest.mark.rig

SOURCE = Path(__file__).parents[2] / 'firmware'
NEEDED = {
    'make': shutil.which('make'), 'cc': shutil.which('cc'), 'avr-gcc': shutil.which('avr-gcc'),
    'avr-libc': Path('/usr/lib/avr/include/avr/io.h').exists(),
    'libsimavr-dev': Path('/usr/include/simavr/sim_avr.h').exists(),
    'libelf-dev': Path('/usr/include/libelf.h').exists(),
}
MISSING = [name for name, found in NEEDED.items() if not found]
needs_simulator = pytest.mark.skipif(bool(MISSING), reason=f'not installed: {MISSING}')
DEADLINE_S = 30.0
STEP = 1.01 / 255  # of the outputs
GROWTH = 31 / 256  # of a duty in one period, at 240 A/s and 2 A
OFF = [0.0] * 6


def build(folder: Path, *settings: str) -> subprocess.CompletedProcess:
    return subprocess.run(['make', '--silent', '-C', SOURCE, f'BUILD={folder}', *settings, 'all',
                           'simulator'], stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope='module')
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp('firmware')
    build(folder).check_returncode()
    return folder


class Board:
    """The simulated board: the name of its terminal and what its outputs did."""

    def __init__(self, built: Path, log: Path, *options: str) -> None:
        self.log = log
        with log.open('w') as stream:
            self.process = subprocess.Popen(
                [built / 'simulate', built / 'coil_board.elf', *options],
                stdin=subprocess.PIPE, stdout=stream, text=True)
        self.url = self.until(lambda: self.lines()[1:] and self.lines()[0])

    def lines(self) -> list[str]:
        return [line for line in self.log.read_text().splitlines(True) if line.endswith('\n')]

    def entries(self) -> list[dict]:
        return [json.loads(line) for line in self.lines()[1:]]

    def duties(self, since: int = 0) -> np.ndarray:
        """All six duties in every PWM period in which one of them changed."""
        return np.array([entry['duties'] for entry in self.entries()[since:]])

    def tell(self, line: str) -> None:
        """Change the world around the board; see simulate.c."""
        self.process.stdin.write(line + '\n')
        self.process.stdin.flush()

    def until(self, condition):
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            if value := condition():
                return value.strip() if isinstance(value, str) else value
            time.sleep(0.002)
        raise AssertionError('the awaited condition never came true')

    def until_at(self, duties, since: int = 0):
        """The first entry from the one numbered `since` on that has these duties."""
        wanted = pytest.approx([*duties, *OFF[len(duties):]], abs=STEP)
        return self.until(lambda: next(
            (entry for entry in self.entries()[since:] if entry['duties'] == wanted), None))

    def end(self) -> None:
        self.process.terminate()
        self.process.wait(DEADLINE_S)
        self.process.stdin.close()


@pytest.fixture
def start(built, tmp_path):
    """A function that powers up a board, with options of the simulator; all end with the test."""
    boards = []

    def start(*options: str, folder: Path = built) -> Board:
        boards.append(Board(folder, tmp_path / f'{len(boards)}.jsonl', *options))
        return boards[-1]

    yield start
    for board in boards:
        board.end()


@pytest.fixture
def board(start):
    return start()


@pytest.fixture
def amplifier(board):
    amplifier = SerialTransferAmplifier(board.url, 2.0, boot_s=DEADLINE_S)
    amplifier.connect()
    yield amplifier
    amplifier.close()


def raw_command(duties: list[float]) -> bytes:
    return codec.encode(struct.pack('<17f', *[0.0] * 11, *duties, *[0.0] * (6 - len(duties))))


def raw_turn(parts: list[list[float]], rate: float) -> bytes:
    """Of six coils, whatever the host's own codec would say of it."""
    steps = [round(32767 * duty) for part in parts for duty in part]
    return codec.encode(struct.pack('<18hf28x', *steps, rate), codec.TURN_ID)


class Line:
    """A host that sends what it likes to all six channels."""

    def __init__(self, url: str) -> None:
        self._port = serial.Serial(url, 500_000, exclusive=True)
        self.await_board()

    def await_board(self) -> None:
        """Wait until the board listens: it reports from then on. What came before is gone."""
        self._port.reset_input_buffer()
        self._decoder = codec.Decoder(codec.MEASUREMENT_BYTES)
        self.report()

    def send(self, duties: list[float]) -> None:
        self._port.write(raw_command(duties))

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def report(self) -> tuple[float, ...]:
        """The next measured currents [A]; the last of them where several came."""
        while True:
            data = self._port.read(self._port.in_waiting or 1)
            if payloads := self._decoder.feed(data, time.monotonic()):
                return codec.currents(payloads[-1])

    def close(self) -> None:
        self._port.close()


@pytest.fixture
def line(board):
    line = Line(board.url)
    yield line
    line.close()


@needs_simulator
def test_commands_flow_and_are_measured(amplifier, board):
    for currents in ([1.0, -1.0, 0.5, 2.0], [-0.3, 0.0, -2.0, 0.01], [0.0] * 4):
        command = amplifier.write(currents)
        reading = next(reading for _ in range(1000) for reading in amplifier.poll(0.1)
                       if reading.acknowledges is command)
        assert reading.currents_A == pytest.approx(currents, abs=0.02)
        board.until_at([current / 2 for current in currents])
    assert (amplifier.counters.crc_errors, amplifier.counters.discarded_bytes) == (0, 0)


@needs_simulator
def test_a_host_that_dies_leaves_zero_after_100_ms(amplifier, board):
    before = len(board.entries())
    amplifier.write([1.0, -1.0, 0.5, 2.0])
    board.until_at([0.5, -0.5, 0.25, 1.0], before)
    amplifier._release()
    driven = board.entries()[before]  # the first period in which the command shows
    zeroed = board.until_at(OFF, before)
    elapsed_s = zeroed['t_device_s'] - driven['t_device_s']
    assert 0.095 <= elapsed_s <= 0.102
    assert zeroed['restarts'] == 0


@needs_simulator
def test_every_output_is_off_at_start_and_after_a_reset(amplifier, board):
    assert board.entries()[0]['duties'] == [0.0] * 6
    amplifier.write([2.0, 2.0, -2.0, -2.0])
    board.until_at([1.0, 1.0, -1.0, -1.0])
    board.tell('reset')
    first = board.until(lambda: next((e for e in board.entries() if e['restarts'] == 1), None))
    assert first['duties'] == [0.0] * 6
    board.until(lambda: amplifier.write([1.0, 0.0, 0.0, 0.0])  # lost until it listens again
                and board.duties()[-1] == pytest.approx([0.5, *OFF[1:]], abs=STEP))


@needs_simulator
def test_what_is_no_command_changes_nothing(line, board):
    good = raw_command([0.5, 0.25, 0.0, 0.0])
    wrong_crc = good[:-2] + bytes((good[-2] ^ 1, good[-1]))
    bad = [raw_command([value, 0, 0, 0]) for value in (math.nan, math.inf, -math.inf, 1.01, -2)]
    for damaged in (*bad, wrong_crc, good[:-1], good[1:], b'\x7e\x00\xff\x44', b'\x7e' * 40):
        line.write(damaged)
    for _ in range(10):  # that long it has had to act on any of them
        line.report()
    assert not board.duties().any()
    line.write(good)
    board.until_at([0.5, 0.25, 0.0, 0.0])


ROUND = [[0.0, 0.1, 0, 0, 0, 0], [0.5, 0, -0.5, 0, 0, 0.3], [0, 0.4, 0, -0.4, 0, 0.3]]
"""Steady, cosine and sine parts: a field of amplitude ½ that goes round, and more."""


def turned(angle: np.ndarray) -> np.ndarray:
    steady, cosine, sine = np.array(ROUND)
    return steady + np.outer(np.cos(angle), cosine) + np.outer(np.sin(angle), sine)


@needs_simulator
@pytest.mark.parametrize('hertz', [-2.0, 10.0])
def test_what_turns_turns_on_by_itself_and_ends_with_the_dead_man(line, board, hertz):
    before = len(board.entries())
    line.write(raw_turn(ROUND, math.tau * hertz))
    board.until_at(OFF, before + 20)
    entries = board.entries()[before:]
    t = np.array([entry['t_device_s'] for entry in entries])
    duties = board.duties(before)
    # It begins slowly, as the board's own limit has it; then it is where it should be.
    begun = t[0] - 1.024e-3 * 1.5
    during = (t > t[0] + 0.02) & (t < t[0] + 0.09)
    assert during.sum() > 20
    expected = turned(math.tau * hertz * (t[during] - begun))
    late = [np.abs(duties[during] - turned(math.tau * hertz * (t[during] - begun - shift))).max()
            for shift in np.arange(-2, 3) * 1.024e-3]
    assert min(late) < 0.05, np.abs(duties[during] - expected).max()
    assert 0.095 <= t[-1] - t[0] <= 0.104
    assert not duties[-1].any()


@needs_simulator
def test_packets_set_what_turns_right_without_a_jump(line, board):
    before, hertz = len(board.entries()), 5.0
    steady, cosine, sine = np.array(ROUND)
    while len(board.entries()) < before + 300:  # as a driver does: from where it is now
        a = math.tau * hertz * board.entries()[-1]['t_device_s']  # a busy machine's runs late
        line.write(raw_turn([steady.tolist(), (cosine * math.cos(a) + sine * math.sin(a)).tolist(),
                             (sine * math.cos(a) - cosine * math.sin(a)).tolist()],
                            math.tau * hertz))
        time.sleep(0.02)
    duties = board.duties(before)[40:]
    radius = np.hypot(duties[:, 0] / 0.5, (duties[:, 1] - 0.1) / 0.4)
    off = np.abs(radius - 1)  # a sign turns at zero, where it rests for 2 ms
    assert np.median(off) < 0.02
    assert np.quantile(off, 0.9) < 0.3


@needs_simulator
def test_what_turns_beyond_the_limits_changes_nothing(line, board):
    beyond = [[0.6] + [0.0] * 5, [0.3] + [0.0] * 5, [0.4] + [0.0] * 5]  # 0.6 + ½ at the most
    for parts, rate in ((beyond, 1.0), (ROUND, math.nan), (ROUND, math.inf), (ROUND, 1001.0)):
        line.write(raw_turn(parts, rate))
    for _ in range(10):
        line.report()
    assert not board.duties().any()
    line.write(raw_turn(ROUND, 1.0))
    board.until_at([0.5, 0.1, -0.5, 0.0, 0.0, 0.3])
    line.send([0.25, 0.0, 0.0, 0.0])  # and a command that stands ends it
    board.until_at([0.25, 0.0, 0.0, 0.0])


@needs_simulator
def test_a_byte_with_a_wrong_stop_bit_spoils_its_packet(line, board):
    board.tell('damage')
    line.send([0.5])
    for _ in range(10):
        line.report()
    assert not board.duties().any()
    line.send([0.25])
    board.until_at([0.25])


@needs_simulator
def test_the_pins_are_low_during_a_reset_because_the_wiring_pulls_them_down(start):
    for options, duty in ((), 0.0), (('--no-pull-downs',), 1.0):
        board = start(*options)
        line = Line(board.url)
        board.tell('reset')
        board.until(lambda: board.entries()[-1]['restarts'])  # noqa: B023
        line.await_board()
        assert [(entry['restarts'], entry['floating'], entry['duties'])
                for entry in board.entries()] == [
                    (0, 12, [duty] * 6), (0, 0, OFF), (1, 12, [duty] * 6), (1, 0, OFF)]
        line.close()


@needs_simulator
def test_nothing_of_the_duty_before_comes_back_when_driving_resumes(line, board):
    for _ in range(10):
        before = len(board.entries())
        line.send([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
        board.until_at([1.0, -1.0, 1.0, -1.0, 1.0, -1.0], before)
        before = len(board.entries())
        line.send(OFF)
        board.until_at(OFF, before)
        before = len(board.entries())
        line.send([0.2, -0.2, 0.2, -0.2, 0.2, -0.2])
        board.until_at([0.2, -0.2, 0.2, -0.2, 0.2, -0.2], before)
        resumed = board.duties(before) * [1, -1, 1, -1, 1, -1]
        assert resumed.min() >= 0.0
        assert resumed.max() <= 0.2 + STEP


@needs_simulator
def test_a_sign_never_turns_under_the_magnitude_of_before(line, board):
    for _ in range(10):
        before = len(board.entries())
        line.send([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
        board.until_at([1.0, -1.0, 1.0, -1.0, 1.0, -1.0], before)
        before = len(board.entries())
        line.send([-0.2, 0.2, -0.2, 0.2, -0.2, 0.2])
        board.until_at([-0.2, 0.2, -0.2, 0.2, -0.2, 0.2], before)
        turned = board.duties(before - 1) * [-1, 1, -1, 1, -1, 1]
        assert turned.max() <= 0.2 + STEP
        assert not np.any((turned[:-1] < 0) & (turned[1:] > 0))  # always a period of zero between


@needs_simulator
def test_whatever_the_host_sends_currents_grow_no_faster_than_the_slew_limit(line, board):
    random = np.random.default_rng(7)
    for _ in range(60):
        for _ in range(5):
            line.send(random.choice([-1.0, 0.0, 1.0], 6).tolist())
        line.report()
    sizes = np.abs(board.duties())
    assert sizes.max() > 2 * GROWTH
    assert np.diff(sizes, axis=0).max() <= GROWTH + 1e-6


@needs_simulator
def test_a_command_beyond_the_limit_of_the_board_is_none(start, tmp_path):
    assert build(tmp_path / 'limited').returncode == 0
    assert build(tmp_path / 'limited', 'LIMIT_A=1').returncode == 0
    board = start(folder=tmp_path / 'limited')
    line = Line(board.url)
    before = len(board.entries())
    line.send([0.0, 0.0, 0.0, 0.0, 0.5, -0.5])
    board.until_at([0.0, 0.0, 0.0, 0.0, 0.5, -0.5], before)
    for channel in range(6):
        for duty in (0.51, -0.51, 1.0):
            line.send([duty if index == channel else 0.25 for index in range(6)])
            line.report()
    driven, zeroed = board.entries()[before], board.until_at(OFF, before)
    assert 0.095 <= zeroed['t_device_s'] - driven['t_device_s'] <= 0.102  # it kept nothing on
    assert not board.duties(before)[:, :4].any()
    line.close()


@needs_simulator
@pytest.mark.parametrize('setting', ['LIMIT_A=2.1', 'LIMIT_A=0', 'LIMIT_A=-1', 'SLEW_A_PER_S=0'])
def test_a_board_with_a_limit_that_limits_nothing_is_not_built(tmp_path, setting):
    assert f'"{setting.split("=")[0]}:' in build(tmp_path, setting).stderr


@needs_simulator
@pytest.mark.parametrize('channel', range(6))
def test_a_channel_that_carries_what_it_was_not_told_ends_all(line, board, channel):
    duties = [0.4] * 6
    duties[channel] = 0.0
    line.send(duties)
    board.until_at(duties)
    told = len(board.entries())
    board.tell(f'carry {channel + 1} 0.5')
    ignored = 0

    def latched() -> bool:
        nonlocal ignored
        line.send(duties)
        line.report()
        ignored = 0 if board.duties()[-1].any() else ignored + 1
        return ignored >= 30

    board.until(latched)
    carried, zeroed = board.entries()[told], board.entries()[-1]
    assert zeroed['t_device_s'] - carried['t_device_s'] <= 0.125
    board.tell(f'carry {channel + 1} 0')
    board.tell('reset')
    board.until(lambda: board.entries()[-1]['restarts'])
    line.await_board()
    before = len(board.entries())
    line.send(duties)
    board.until_at(duties, before)


@needs_simulator
@pytest.mark.parametrize('part', [-1.0, 0.15])
def test_a_board_whose_sense_lines_are_off_at_the_start_does_not_drive(line, board, part):
    board.tell(f'carry 6 {part}')
    board.tell('reset')
    board.until(lambda: board.entries()[-1]['restarts'])
    line.await_board()
    for _ in range(20):
        line.send([0.5])
        line.report()
    assert not board.duties().any()


@needs_simulator
def test_a_program_that_hangs_ends_in_zero_through_the_watchdog(line, board):
    line.send([0.5] * 6)
    board.until_at([0.5] * 6)
    before = len(board.entries())
    board.tell('hang')
    reset = board.until(lambda: next((e for e in board.entries() if e['restarts']), None))
    assert reset['duties'] == OFF
    assert reset['t_device_s'] - board.entries()[before]['t_device_s'] <= 0.13
    line.await_board()
    assert board.entries()[-1]['restarts'] == 1
    line.send([0.25])
    board.until_at([0.25], before)


@needs_simulator
def test_a_host_within_its_limits_does_not_notice_the_limits_of_the_board(board):
    limits = Limits(current_A=2.0, step_A=4.0, slew_A_per_s=200.0, command_timeout_s=1.0,
                    deviation_A=0.2, settling_s=0.1, feedback_timeout_s=1.0, rated_current_A=2.0,
                    thermal_s=60.0, idle_s=60.0)
    driver = CoilDriver(SerialTransferAmplifier(board.url, 2.0, boot_s=DEADLINE_S), limits,
                        lambda _: None)
    driver.start()
    try:
        board.until(lambda: driver.arm() is None)
        driver.command([0.0] * 4)
        for sign in [1, -1] * 20:  # the largest step, as often as it may come
            assert driver.command([2.0 * sign, -2.0 * sign, 0.0, 2.0 * sign])
            threading.Event().wait(0.022)
        assert driver.gate.fault is None
    finally:
        driver.stop()


@pytest.fixture(scope='module')
def take(tmp_path_factory):
    """The firmware's decoder, compiled for this machine."""
    if not NEEDED['cc']:
        pytest.skip('not installed: cc')
    library = tmp_path_factory.mktemp('packet') / 'packet.so'
    subprocess.run(['cc', '-shared', '-fPIC', '-Wall', '-Werror', '-o', library,
                    SOURCE / 'packet.c'], check=True)
    compiled = ctypes.CDLL(str(library))

    def take(stream: bytes) -> list[tuple[int, bytes]]:
        window, payload = ctypes.create_string_buffer(75), ctypes.create_string_buffer(68)
        return [(kind - 1, payload.raw) for byte in stream
                if (kind := compiled.packet_take(window, ctypes.c_uint8(byte), payload))]

    take.encode = compiled.packet_encode
    return take


def test_firmware_and_host_agree_on_what_is_a_packet(take):
    random = np.random.default_rng(5)
    accepted = 0
    for _ in range(300):
        stream = b''
        for _ in range(3):
            payload = bytes(random.choice([0x7E, 0x00, 0x81, 0xFF, 0x44, 0x3F], 68).tolist())
            packet = bytearray(codec.encode(payload, int(random.integers(2))))
            for _ in range(random.integers(0, 3)):
                packet[random.integers(len(packet))] = random.integers(256)
            del packet[:random.choice([0, 0, 0, 5])]
            stream += bytes(packet)
        expected = codec.Decoder(68, (codec.PACKET_ID, codec.TURN_ID)).feed_packets(stream, 0.0)
        assert take(stream) == expected
        accepted += len(expected)
    assert accepted > 100


def test_firmware_and_host_agree_on_what_a_measurement_looks_like(take):
    random = np.random.default_rng(6)
    for _ in range(300):
        payload = bytes(random.choice([0x7E, 0x00, 0x81, 0xFF], 24).tolist())
        packet = ctypes.create_string_buffer(30)
        take.encode(payload, packet)
        assert packet.raw == codec.encode(payload)
