"""The reference firmware on a simulated ATmega328P, with the host's driver at its UART.

Needs avr-gcc, avr-libc, cc and libsimavr (Debian: gcc-avr avr-libc libsimavr-dev libelf-dev);
what is missing is named in the reason for skipping.
"""

import ctypes
import json
import math
import shutil
import signal
import struct
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import serial

from microbot_ros.drive.serial_transfer import codec
from microbot_ros.drive.serial_transfer.driver import SerialTransferAmplifier

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


@pytest.fixture(scope='module')
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp('firmware')
    subprocess.run(['make', '--silent', '-C', SOURCE, f'BUILD={folder}', 'all', 'simulator'],
                   check=True)
    return folder


class Board:
    """The simulated board: the name of its terminal and what its outputs did."""

    def __init__(self, built: Path, log: Path) -> None:
        self.log = log
        with log.open('w') as stream:
            self.process = subprocess.Popen(
                [built / 'simulate', built / 'coil_board.elf'], stdout=stream)
        self.url = self.until(lambda: self.lines()[1:] and self.lines()[0])

    def lines(self) -> list[str]:
        return [line for line in self.log.read_text().splitlines(True) if line.endswith('\n')]

    def entries(self) -> list[dict]:
        return [json.loads(line) for line in self.lines()[1:]]

    def until(self, condition):
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            if value := condition():
                return value.strip() if isinstance(value, str) else value
            time.sleep(0.002)
        raise AssertionError('the awaited condition never came true')

    def until_at(self, duties):
        return self.until(lambda: (last := self.entries()[-1])['duties'][:4]
                          == pytest.approx(duties, abs=STEP) and last)


@pytest.fixture
def board(built, tmp_path):
    board = Board(built, tmp_path / 'log.jsonl')
    yield board
    board.process.terminate()
    board.process.wait(DEADLINE_S)


@pytest.fixture
def amplifier(board):
    amplifier = SerialTransferAmplifier(board.url, 2.0, boot_s=DEADLINE_S)
    amplifier.connect()
    yield amplifier
    amplifier.close()


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
    amplifier.write([1.0, -1.0, 0.5, 2.0])
    driven = board.until_at([0.5, -0.5, 0.25, 1.0])
    amplifier._release()
    zeroed = board.until_at([0.0] * 4)
    elapsed_s = zeroed['t_device_s'] - driven['t_device_s']
    assert 0.095 <= elapsed_s <= 0.102
    assert zeroed['restarts'] == 0


@needs_simulator
def test_every_output_is_off_at_start_and_after_a_reset(amplifier, board):
    assert board.entries()[0]['duties'] == [0.0] * 6
    amplifier.write([2.0, 2.0, -2.0, -2.0])
    board.until_at([1.0, 1.0, -1.0, -1.0])
    board.process.send_signal(signal.SIGUSR1)
    first = board.until(lambda: next((e for e in board.entries() if e['restarts'] == 1), None))
    assert first['duties'] == [0.0] * 6
    amplifier.write([1.0, 0.0, 0.0, 0.0])
    board.until_at([0.5, 0.0, 0.0, 0.0])


def raw_command(duties: list[float]) -> bytes:
    return codec.encode(struct.pack('<17f', *[0.0] * 11, *duties, *[0.0] * (6 - len(duties))))


@needs_simulator
def test_what_is_no_command_changes_nothing(board):
    good = raw_command([0.5, 0.25, 0.0, 0.0])
    wrong_crc = good[:-2] + bytes((good[-2] ^ 1, good[-1]))
    bad = [raw_command([value, 0, 0, 0]) for value in (math.nan, math.inf, -math.inf, 1.01, -2)]
    with serial.Serial(board.url, 500_000, exclusive=True) as port:
        for damaged in (*bad, wrong_crc, good[:-1], good[1:], b'\x7e\x00\xff\x44', b'\x7e' * 40):
            port.write(damaged)
        decoder, reports = codec.Decoder(codec.MEASUREMENT_BYTES), 0
        while reports < 10:  # that long it has had to act on any of them
            reports += len(decoder.feed(port.read(port.in_waiting or 1), time.monotonic()))
        assert len(board.entries()) == 1
        port.write(good)
        board.until_at([0.5, 0.25, 0.0, 0.0])


@pytest.fixture(scope='module')
def take(tmp_path_factory):
    """The firmware's decoder, compiled for this machine."""
    if not NEEDED['cc']:
        pytest.skip('not installed: cc')
    library = tmp_path_factory.mktemp('packet') / 'packet.so'
    subprocess.run(['cc', '-shared', '-fPIC', '-Wall', '-Werror', '-o', library,
                    SOURCE / 'packet.c'], check=True)
    compiled = ctypes.CDLL(str(library))
    compiled.packet_take.restype = ctypes.c_bool

    def take(stream: bytes) -> list[bytes]:
        window, payload = ctypes.create_string_buffer(75), ctypes.create_string_buffer(68)
        return [payload.raw for byte in stream
                if compiled.packet_take(window, ctypes.c_uint8(byte), payload)]

    take.encode = compiled.packet_encode
    return take


def test_firmware_and_host_agree_on_what_is_a_packet(take):
    random = np.random.default_rng(5)
    accepted = 0
    for _ in range(300):
        stream = b''
        for _ in range(3):
            payload = bytes(random.choice([0x7E, 0x00, 0x81, 0xFF, 0x44, 0x3F], 68).tolist())
            packet = bytearray(codec.encode(payload))
            for _ in range(random.integers(0, 3)):
                packet[random.integers(len(packet))] = random.integers(256)
            del packet[:random.choice([0, 0, 0, 5])]
            stream += bytes(packet)
        expected = codec.Decoder(68).feed(stream, 0.0)
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
