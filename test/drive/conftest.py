"""Emulated amplifiers for one test, scripted ports, and drivers of them."""

import pytest

from bench._emulator import FULL_SCALE_A, LIMITS, EmulatorProcess, Served
from bench._virtual import VirtualClock
from microbot_ros.drive.amplifier import amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.polled import PolledAmplifier


@pytest.fixture
def emulate(tmp_path, patience):
    """A function that starts the emulator of a protocol with options; all end with the test.

    A machine that is busy with other tests may pause for longer than a line may, and an answer
    that it brings late spoils the next, which is waited for in vain, then asked for again.
    """
    patience(write_s=5.0, read_back_s=2.0)
    started = []

    def start(protocol: str, *options: str) -> EmulatorProcess:
        started.append(EmulatorProcess(tmp_path, protocol, *options))
        return started[-1]

    yield start
    for emulated in started:
        emulated.end()


class Script:
    """Lines that expect exact bytes, answer as written, and let nothing be left over."""

    def __init__(self, exchanges: list[tuple[str, bytes, bytes]]) -> None:
        self.exchanges = exchanges
        self.clock = VirtualClock()
        self.opened: list[tuple[str, int, bool]] = []
        self._answers: dict[str, bytes] = {}

    def port(self, url: str, baud: int, *, xon_xoff: bool = False) -> 'Script.Port':
        self.opened.append((url, baud, xon_xoff))
        return Script.Port(self, url)

    class Port:
        def __init__(self, script: 'Script', url: str) -> None:
            self.script, self.url = script, url

        def send(self, data: bytes) -> None:
            assert self.script.exchanges, f'unexpected bytes to {self.url}: {data!r}'
            url, expected, answer = self.script.exchanges.pop(0)
            assert (self.url, data) == (url, expected)
            self.script._answers[self.url] = answer

        def receive(self, timeout_s: float = 0.0) -> bytes:
            if not (answer := self.script._answers.pop(self.url, b'')):
                self.script.clock.sleep(timeout_s)
            return answer

        def discard_output(self) -> None:
            pass

        def discard_input(self) -> None:
            assert not self.script._answers.get(self.url)

        def close(self) -> None:
            pass


@pytest.fixture
def scripted(monkeypatch):
    """A function that lets polled drivers talk to a script; leftovers fail the test."""
    scripts = []

    def install(exchanges: list[tuple[str, bytes, bytes]]) -> Script:
        scripts.append(Script(list(exchanges)))
        monkeypatch.setattr(PolledAmplifier, 'open_port', scripts[-1].port)
        monkeypatch.setattr(PolledAmplifier, 'clock', scripts[-1].clock)
        return scripts[-1]

    yield install
    assert all(not script.exchanges and not any(script._answers.values()) for script in scripts)


@pytest.fixture
def protocol():
    """Of the device that a thread of this process serves."""
    return 'serial_transfer'


@pytest.fixture
def watchdog_s():
    return 0.1


@pytest.fixture
def device(protocol, tmp_path, watchdog_s):
    device = Served(tmp_path, protocol, watchdog_s=watchdog_s)
    yield device
    device.end()


@pytest.fixture
def amplifier(protocol, device):
    amplifier = amplifier_class(protocol)(device.url, FULL_SCALE_A)
    # A loaded machine is slower than a device.
    amplifier.reply_s = 0.3
    amplifier._boot_s = 5.0
    yield amplifier
    amplifier._release()


@pytest.fixture
def drivers(amplifier):
    """A function that starts a driver, in other limits if told; it ends with the test."""
    started = []

    def start(on_reading=lambda _: None, on_sent=lambda _: None, *, self_check=False,
              accept_no_watchdog=True, **limits):
        driver = CoilDriver(amplifier, Limits(**{**vars(LIMITS), **limits}), on_reading,
                            on_sent=on_sent, self_check=self_check,
                            accept_no_watchdog=accept_no_watchdog)
        driver.start()
        started.append(driver)
        return driver

    yield start
    for driver in started:
        driver.stop()


@pytest.fixture
def driver(drivers):
    return drivers()
