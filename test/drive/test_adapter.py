"""A driver is bound to the USB adapters of its first connection."""

from types import SimpleNamespace

import pytest

from bench._emulator import FULL_SCALE_A, MEASURED
from bench._virtual import VirtualAmplifier
from microbot_ros.drive import adapter as adapters
from microbot_ros.drive.adapter import BY_ID, Adapter, adapter_at
from microbot_ros.drive.amplifier import amplifier_class
from microbot_ros.drive.errors import PortMissingError, WrongDeviceError

OWN, OTHER = Adapter(0x0403, 0x6001, 'A6008isP'), Adapter(0x1A86, 0x7523, '')
ZERO = (0.0,) * 4

PROTOCOLS = sorted({*MEASURED, 'sabertooth'})
every_protocol = pytest.mark.parametrize('protocol', PROTOCOLS)


class Ports(dict):
    """Port → adapter, in place of what the system reports."""

    def bind(self, amplifier):
        amplifier.adapter_at = self.get
        return amplifier


@pytest.fixture
def rig(protocol):
    return VirtualAmplifier(protocol)


@pytest.fixture
def ports(rig):
    return Ports({url: Adapter(0x0403, 0x6001, url) for url in rig.urls})


@pytest.fixture
def there(monkeypatch):
    """Every port is a file that is there."""
    monkeypatch.setattr('microbot_ros.drive.amplifier.Path.exists', lambda _: True)


@every_protocol
def test_the_same_adapter_is_reopened(rig, ports):
    amplifier = ports.bind(rig.amplifier())
    for _ in range(3):
        amplifier.connect()
        amplifier.close()


@every_protocol
@pytest.mark.parametrize('other', [OTHER, Adapter(0x0403, 0x6001, 'B'), None])
@pytest.mark.usefixtures('there')
def test_another_adapter_is_refused_by_name_and_sent_nothing(rig, ports, other):
    amplifier = ports.bind(rig.amplifier())
    amplifier.connect()
    amplifier.close()
    for number, url in enumerate(rig.urls):
        own, ports[url] = ports[url], other
        sent = [len(line.sent) for line in rig.lines]
        with pytest.raises(WrongDeviceError) as refusal:
            amplifier.connect()
        found = other or 'a port that is not a USB adapter'
        assert str(refusal.value) == f'{url}: expected the adapter {own}; received {found}'
        assert amplifier.unreachable == (url,)
        for line, before in zip(rig.lines, sent, strict=True):
            # The others are zeroed meanwhile.
            assert (len(line.sent) > before) == (line is not rig.lines[number])
        ports[url] = own
        amplifier.connect()
        amplifier.close()


@every_protocol
def test_a_port_that_is_away_is_missing_and_no_other_device(rig, ports):
    amplifier = ports.bind(rig.amplifier())
    amplifier.connect()
    amplifier.close()
    rig.fault('unplug')
    ports.clear()
    with pytest.raises(PortMissingError):
        amplifier.connect()


@every_protocol
@pytest.mark.usefixtures('there')
def test_only_what_was_connected_is_bound(rig, ports):
    amplifier = ports.bind(rig.amplifier())
    rig.fault('silence')
    rig.fault('wrong_reply')
    if amplifier.reads_back:
        with pytest.raises(Exception, match='expected'):
            amplifier.connect()
        rig.mend()
        ports.update(dict.fromkeys(rig.urls, OTHER))
        amplifier.connect()


@every_protocol
@pytest.mark.usefixtures('there')
def test_a_port_without_identity_has_nothing_to_compare(rig):
    ports = Ports()
    amplifier = ports.bind(rig.amplifier())
    amplifier.connect()
    amplifier.close()
    ports.update(dict.fromkeys(rig.urls, OTHER))
    amplifier.connect()


@every_protocol
def test_a_name_that_is_not_the_adapters_is_refused_at_the_first_connection(protocol):
    count = len(VirtualAmplifier(protocol).urls)
    urls = [f'{BY_ID}usb-FTDI_FT232R_A{number}-if00-port0' for number in range(count)]
    amplifier = amplifier_class(protocol)(','.join(urls), FULL_SCALE_A)
    opened = []

    def open_port(url, *_, **__):
        opened.append(url)
        raise PortMissingError(url, 'no test needs it')

    amplifier.open_port = open_port
    amplifier.adapter_at = {url: Adapter(0x0403, 0x6001, f'A{number}')
                            for number, url in enumerate(urls)}.get
    with pytest.raises(PortMissingError):
        amplifier.connect()
    assert opened == urls
    amplifier.adapter_at = lambda _: Adapter(0x0403, 0x6001, 'B7')
    with pytest.raises(WrongDeviceError, match='the USB adapter that the port names; received '
                       'USB 0403:6001, serial number B7'):
        amplifier.connect()
    assert opened == urls


@pytest.mark.parametrize(('serial_number', 'url', 'right'), [
    ('A6008isP', BY_ID + 'usb-FTDI_FT232R_USB_UART_A6008isP-if00-port0', True),
    ('A6008isQ', BY_ID + 'usb-FTDI_FT232R_USB_UART_A6008isP-if00-port0', False),
    ('7 5(3', BY_ID + 'usb-Arduino_7_5_3-if00', True),
    ('', BY_ID + 'usb-1a86_USB_Serial-if00-port0', True),
    ('A6008isQ', '/dev/ttyUSB0', True),
])
def test_a_name_by_id_contains_the_serial_number(serial_number, url, right):
    assert Adapter(1, 2, serial_number).may_be_named(url) is right


def test_an_adapter_is_found_by_any_name_of_its_port(monkeypatch, tmp_path):
    monkeypatch.setattr(adapters, 'comports', lambda: [
        SimpleNamespace(device='/dev/ttyS0', vid=None, pid=None, serial_number=None),
        SimpleNamespace(device='/dev/ttyUSB3', vid=0x0403, pid=0x6001, serial_number='A6008isP'),
        SimpleNamespace(device='/dev/ttyUSB4', vid=0x1A86, pid=0x7523, serial_number=None)])
    link = tmp_path / 'coils'
    link.symlink_to('/dev/ttyUSB3')
    assert adapter_at('/dev/ttyUSB3') == adapter_at(str(link)) == OWN
    assert adapter_at('/dev/ttyUSB4') == OTHER
    assert (str(OWN), str(OTHER)) == (
        'USB 0403:6001, serial number A6008isP', 'USB 1a86:7523, no number')
    for none in ('/dev/ttyS0', '/dev/nowhere', 'rfc2217://host:1', 'socket://host:1'):
        assert adapter_at(none) is None


def test_an_adapter_that_is_pulled_out_while_it_is_looked_for_is_none(monkeypatch):
    def comports():
        raise OSError('gone')

    monkeypatch.setattr(adapters, 'comports', comports)
    assert adapter_at('/dev/ttyUSB3') is None
