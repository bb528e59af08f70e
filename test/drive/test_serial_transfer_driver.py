"""The SerialTransfer driver against the emulated board; over a network, and byte by byte."""

import contextlib
import math
import socket
import threading
from types import SimpleNamespace

import numpy as np
import pytest
import serial
from serial import rfc2217

from bench._virtual import VirtualAmplifier
from microbot_ros.drive.amplifier import AGAIN_S, Swing, Zero
from microbot_ros.drive.amplifiers.serial_transfer import codec
from microbot_ros.drive.amplifiers.serial_transfer.driver import SerialTransferAmplifier
from microbot_ros.drive.errors import (
    NoAnswerError,
    PortMissingError,
    WrongDeviceError,
)

FULL_SCALE = (2.0, 2.0, 2.0, 2.0)


ZERO = (0.0,) * 4


@pytest.fixture
def board():
    return VirtualAmplifier('serial_transfer')


@pytest.fixture
def amplifier(board):
    amplifier = board.amplifier()
    amplifier.connect()
    return amplifier


def acknowledged(amplifier, command):
    return next(reading for _ in range(1000) for reading in amplifier.poll(0.1)
                if reading.acknowledges is command)


def test_it_reports_by_itself(amplifier):
    times = [reading.t_monotonic_s for _ in range(10) for reading in amplifier.poll(1.0)]
    assert np.diff(times) == pytest.approx([0.02] * 9, abs=1e-5)


def test_closing_tells_where_no_reading_confirms_the_zero(amplifier, board):
    acknowledged(amplifier, amplifier.write([1.0, 0, 0, 0]))
    board.fault('silence')
    assert amplifier.close() is Zero.SENT
    assert board.flows(ZERO)


@pytest.mark.parametrize('url', ['/nowhere/coils', 'nonsense://x', '/dev/null'])
def test_a_missing_port_is_named(url):
    with pytest.raises(PortMissingError, match=url):
        SerialTransferAmplifier(url, 2.0).connect()


def test_a_command_for_a_coil_that_the_board_has_not_is_none(board):
    port = board.lines[0].open('a')
    for duties in ([0.5, 0.0, 0.0, 0.0, 0.1], [0.5, 0.0, 0.0, 0.0, 0.0, -0.1], [0.25]):
        port.send(codec.encode(codec.command(duties)))
    assert [currents[0] for currents in board.flowed] == [0.0, 0.5]


class Terminal(serial.Serial):
    """A port without the modem lines that a pseudo-terminal does not have."""

    cts = dsr = ri = cd = False

    def _update_dtr_state(self):
        pass

    def _update_rts_state(self):
        pass


@pytest.fixture
def emulated(emulate):
    return emulate('serial_transfer')


@pytest.fixture(params=['socket', 'rfc2217'])
def remote(request, emulated):
    """The board behind a serial-to-network server, as a URL."""
    line = Terminal(emulated.url, 500_000, timeout=0.01)
    listener = socket.create_server(('127.0.0.1', 0))
    listener.settimeout(60.0)
    ended = threading.Event()
    thread = threading.Thread(target=serve, args=(request.param, listener, line, ended))
    thread.start()
    yield f'{request.param}://127.0.0.1:{listener.getsockname()[1]}'
    ended.set()
    thread.join()
    listener.close()
    line.close()


def serve(kind, listener, line, ended):
    connection, _ = listener.accept()
    connection.settimeout(0.005)
    manager = rfc2217.PortManager(line, SimpleNamespace(write=connection.sendall))
    with connection:
        while not ended.is_set():
            if data := line.read(line.in_waiting):
                connection.sendall(b''.join(manager.escape(data)) if kind == 'rfc2217' else data)
            with contextlib.suppress(TimeoutError):
                if not (data := connection.recv(4096)):
                    return
                line.write(b''.join(manager.filter(data)) if kind == 'rfc2217' else data)


@pytest.mark.rig
@pytest.mark.filterwarnings('ignore:set(Daemon|Name):DeprecationWarning')  # within pyserial 3.5
def test_it_works_over_a_network_port(remote, emulated):
    amplifier = SerialTransferAmplifier(remote, FULL_SCALE)
    amplifier.connect()
    acknowledged(amplifier, amplifier.write([1.0, -0.5, 0.25, 2.0]))
    emulated.eventually([1.0, -0.5, 0.25, 2.0])
    assert amplifier.close() is Zero.CONFIRMED
    assert emulated.currents == [0, 0, 0, 0]


def test_the_bytes_of_a_session_and_no_others(board):
    """Connect, one command, close: the whole transcript."""
    amplifier = board.amplifier()
    amplifier.connect()
    acknowledged(amplifier, amplifier.write([2.0, -1.0, 0.0, 0.5]))
    assert amplifier.close() is Zero.CONFIRMED
    received = b''.join(data for _, data in board.lines[0].sent)
    counters = amplifier.counters
    assert counters.frames_sent == len(board.lines[0].sent)
    assert (counters.crc_errors, counters.discarded_bytes) == (0, 0)
    zero = bytes.fromhex('7e00ff44') + bytes(68) + bytes.fromhex('0081')
    drive = (bytes.fromhex('7e00ff44') + bytes(44)
             + bytes.fromhex('0000803f 000000bf 00000000 0000803e') + bytes(8))
    before, after = received.split(drive + bytes((codec.crc8(drive[4:]), 0x81)))
    for zeros in (before, after):  # one that no reading has shown after 10 ms is sent again
        assert zeros.startswith(zero)
        assert not zeros.replace(zero, b'')


@pytest.mark.parametrize(('fifth', 'sixth', 'fault'), [
    (0.199, -0.199, ''), (0.201, 0.0, 'spare channel 5 carries 0.2 A'),
    (0.0, -2.0, 'spare channel 6 carries -2 A'),
    (3.0, 3.0, 'spare channel 5 carries 3 A; no coil is configured on it; '
               'spare channel 6 carries 3 A'),
])
def test_coils_that_are_never_driven_must_carry_nothing(fifth, sixth, fault):
    amplifier = SerialTransferAmplifier('nowhere', FULL_SCALE)
    hears(amplifier, codec.encode(codec.measurement([1.0, 0.0, 0.0, 0.0, fifth, sixth])))
    reading, = amplifier.poll()
    assert reading.currents_A == pytest.approx([1.0, 0, 0, 0])
    assert amplifier.fault.startswith(fault)
    assert bool(amplifier.fault) == bool(fault)
    hears(amplifier, codec.encode(codec.measurement([0.0] * 6)))
    assert amplifier.poll()
    assert amplifier.fault == ''


def test_a_reading_at_a_bound_is_within():
    amplifier = SerialTransferAmplifier('nowhere', 5.0)  # bounds that a float of the line meets
    hears(amplifier, codec.encode(codec.measurement([10.0, -10.0, 0.0, 0.0, 0.5, -0.5])))
    reading, = amplifier.poll()
    assert reading.currents_A.tolist() == [10.0, -10.0, 0.0, 0.0]
    assert amplifier.fault == ''


def test_bytes_that_are_no_packet_are_counted():
    amplifier = SerialTransferAmplifier('nowhere', FULL_SCALE)
    hears(amplifier, b'noise' + codec.encode(codec.measurement([0.0] * 6)))
    assert amplifier.poll()
    assert amplifier.counters.discarded_bytes == 5


def opening(packets):
    """Open a board that falls silent after so many packets, one every 20 ms; how many it sent."""
    clock, sent = [100.0], []

    def receive(left_s):
        clock[0] += 0.02 if len(sent) < packets else left_s
        if len(sent) == packets:
            return b''
        sent.append(codec.encode(codec.measurement([0.0] * 6)))
        return sent[-1]

    amplifier = SerialTransferAmplifier('nowhere', FULL_SCALE)
    amplifier.clock = SimpleNamespace(now=lambda: clock[0])
    amplifier.open_port = lambda *_: SimpleNamespace(receive=receive)
    amplifier._open()
    return len(sent)


def test_a_board_is_running_when_packets_have_kept_coming():
    assert opening(9) == 3


@pytest.mark.parametrize('packets', [1, 2])
def test_a_board_that_opening_the_port_resets_is_not_believed(packets):
    with pytest.raises(WrongDeviceError, match='bytes'):
        opening(packets)


def reopening(report_s):
    """Open a known board that reports its first currents after so long; the amplifier, when it
    sent what, and for how long it listened at a time."""
    clock, sent, patience = [0.0], [], []

    def receive(left_s):
        patience.append(left_s)
        clock[0] += left_s
        late = clock[0] >= report_s
        return codec.encode(codec.measurement([0.0] * 6)) if late else b''

    amplifier = SerialTransferAmplifier('nowhere', FULL_SCALE)
    amplifier._known = True
    amplifier.clock = SimpleNamespace(now=lambda: clock[0])
    amplifier.open_port = lambda *_: SimpleNamespace(
        receive=receive, send=lambda *packets: sent.append((clock[0], b''.join(packets))))
    return amplifier, sent, patience


def test_a_known_board_is_sent_zeros_from_the_first_moment_while_it_is_opened():
    amplifier, sent, patience = reopening(0.1)
    amplifier._open()
    times = [moment for moment, _ in sent]
    assert times[:2] == [0.0, AGAIN_S]
    assert max(np.diff(times)) <= 2.5 * AGAIN_S
    assert times[-1] >= 0.1
    assert max(patience) <= AGAIN_S
    zero = codec.encode(codec.command([0.0] * 4))
    assert {packet for _, packet in sent} == {zero}
    assert codec.duties(zero[4:-2]) == (0.0,) * 6


def test_a_silent_board_is_waited_for_as_long_as_booting_takes():
    amplifier, sent, _ = reopening(2.9)
    amplifier._open()
    amplifier, sent, _ = reopening(math.inf)
    with pytest.raises(NoAnswerError):
        amplifier._open()
    assert sent[-1][0] == pytest.approx(3.0)


@pytest.mark.parametrize(('baud', 'sample_s'), [
    (10_000_000, 0.0008), (500_000, 0.00185), (9600, 0.09635)])
def test_currents_that_turn_leave_a_quarter_of_the_line_free(baud, sample_s):
    """A packet has 74 bytes of ten bits."""
    amplifier = SerialTransferAmplifier('nowhere', 2.0, baud=baud)
    assert amplifier.sample_s == pytest.approx(sample_s, abs=1e-5)


def test_a_board_that_turns_currents_is_sent_parts_of_full_scale():
    amplifier, sent = SerialTransferAmplifier('nowhere', 4.0), []
    assert amplifier.can_swing
    amplifier._lines = [SimpleNamespace(send=sent.append)]
    parts = [np.array([1.0, 0.0, -1.0, 0.5]) * factor for factor in (1.0, 2.0, -1.0)]
    amplifier.write(np.zeros(4), swing=Swing(*parts, rate=30.0))
    duties = [[0.25, 0.0, -0.25, 0.125], [0.5, 0.0, -0.5, 0.25], [-0.25, 0.0, 0.25, -0.125]]
    assert sent == [codec.encode(codec.turn(duties, 30.0), codec.TURN_ID)]


@pytest.mark.parametrize('channel', range(6))
@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, 4.001])
def test_a_report_that_cannot_be_is_none(channel, value):
    amplifier = SerialTransferAmplifier('nowhere', FULL_SCALE)
    currents = [0.0] * 6
    currents[channel] = value
    hears(amplifier, codec.encode(codec.measurement(currents)))
    assert amplifier.poll() == []
    assert amplifier.counters.crc_errors == 1


def hears(amplifier, data):
    """Let the bytes be all that comes in, as from a port."""
    amplifier._lines = [SimpleNamespace(receive=lambda _: data)]
