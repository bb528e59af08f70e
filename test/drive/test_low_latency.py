"""Low latency of serial adapters: asked for on opening, believed only where the kernel says so."""

import errno
import os
import struct
import termios

import pytest
import serial

from microbot_ros.cli.rig import doctor
from microbot_ros.drive import low_latency, transport
from microbot_ros.drive.low_latency import latency_timer_ms
from microbot_ros.drive.transport import Port

# struct serial_struct of linux/serial.h begins int type, int line, unsigned port, int irq,
# int flags; ASYNCB_LOW_LATENCY is bit 13.
FLAGS_AT, LOW_LATENCY = 16, 0x2000


class Kernel:
    """Answers `ioctl` as a serial driver does that keeps flags, or refuses, or forgets them."""

    def __init__(self, manner: str, flags: int = 0x1000_0000) -> None:
        self.manner, self.flags = manner, flags

    def __call__(self, descriptor: int, request: int, buffer: object) -> int:
        held = memoryview(buffer).cast('B')
        if request == termios.TIOCGSERIAL:
            struct.pack_into('=i', held, 0, 4)
            struct.pack_into('=i', held, FLAGS_AT, self.flags)
        elif self.manner == 'refuses':
            raise PermissionError(errno.EPERM, 'Operation not permitted')
        elif self.manner == 'keeps':
            assert struct.unpack_from('=i', held, 0) == (4,)
            self.flags, = struct.unpack_from('=i', held, FLAGS_AT)
        return 0


@pytest.fixture
def terminal():
    """The name of a terminal that somebody holds open."""
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


@pytest.fixture
def adapters(monkeypatch, tmp_path):
    monkeypatch.setattr(low_latency, '_ADAPTERS', tmp_path)
    return tmp_path


def timer(adapters, device, text):
    folder = adapters / os.path.basename(device)
    folder.mkdir()
    (folder / 'latency_timer').write_text(text)


def opened(kernel, monkeypatch, terminal):
    """A port whose serial_struct a kernel of ours keeps; all else of it is the real terminal's."""
    real = transport.request_low_latency

    def ask(port):
        with monkeypatch.context() as patch:
            patch.setattr('fcntl.ioctl', kernel)
            return real(port)

    monkeypatch.setattr(transport, 'request_low_latency', ask)
    return Port(terminal, 115_200)


@pytest.mark.parametrize(('manner', 'granted'), [
    ('keeps', True), ('refuses', False), ('forgets', False)])
def test_what_the_kernel_keeps_is_granted(monkeypatch, terminal, manner, granted):
    kernel = Kernel(manner)
    port = opened(kernel, monkeypatch, terminal)
    assert port.low_latency is granted
    assert kernel.flags == 0x1000_0000 | (LOW_LATENCY if granted else 0)
    port.close()


def test_a_terminal_that_is_no_serial_port_refuses_and_works(terminal):
    port = Port(terminal, 115_200)
    assert port.low_latency is False
    port.send(b'as ever')
    port.close()


def test_a_port_over_a_network_is_not_asked():
    port = serial.serial_for_url('loop://')
    assert low_latency.request_low_latency(port) is False
    port.close()


@pytest.mark.parametrize(('text', 'found'), [('16\n', 16), ('1\n', 1), ('', None), ('a', None)])
def test_the_timer_is_found_by_any_name_of_the_port(adapters, tmp_path, text, found):
    timer(adapters, 'ttyUSB7', text)
    link = tmp_path / 'usb-FTDI_FT232R'
    link.symlink_to('/dev/ttyUSB7')
    assert latency_timer_ms('/dev/ttyUSB7') == latency_timer_ms(str(link)) == found
    assert latency_timer_ms('/dev/ttyUSB8') is None


@pytest.mark.parametrize(('manner', 'held', 'level', 'said'), [
    ('keeps', '1', 'ok', 'answers are delayed by at most 1 ms'),
    ('refuses', '1', 'ok', 'answers are delayed by at most 1 ms'),
    ('refuses', '16', 'warn', 'by up to 16 ms, low latency was refused; see "Low latency"'),
    ('keeps', '16', 'warn', 'by up to 16 ms, low latency was granted without effect'),
    ('keeps', '', 'ok', 'low latency granted, and no latency timer'),
    ('refuses', '', 'ok', 'low latency refused, and no latency timer'),
])
def test_the_doctor_says_what_was_granted(monkeypatch, adapters, terminal, tmp_path, manner, held,
                                          level, said):
    timer(adapters, terminal, held)
    opened(Kernel(manner), monkeypatch, terminal).close()
    found = doctor._latency(rig(tmp_path, terminal))
    assert found.level == level
    assert found.detail.startswith(f'{terminal}: ')
    assert said in found.detail


def test_the_doctor_leaves_a_port_that_is_in_use_alone(terminal, tmp_path):
    port = Port(terminal, 115_200)
    found = doctor._latency(rig(tmp_path, terminal))
    assert (found.level, found.detail) == ('ok', f'{terminal}: in use, not checked')
    port.close()
    assert 'refused' in doctor._latency(rig(tmp_path, terminal)).detail
    gone = doctor._latency(rig(tmp_path, f'/nowhere,{terminal}'))
    assert '/nowhere' in gone.detail
    assert f'{terminal}: low latency refused' in gone.detail
    assert doctor._latency(rig(tmp_path, '')).detail == 'no port configured'


def rig(folder, port):
    file = folder / 'rig.yaml'
    file.write_text(f"coil_driver: {{ros__parameters: {{port: '{port}'}}}}\n")
    return file
