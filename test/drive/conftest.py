"""Emulated amplifiers as processes of their own, and a way to wait for what they log."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from bench._served import FULL_SCALE_A, LIMITS, Served
from microbot_ros.drive.amplifier import Amplifier, amplifier_class
from microbot_ros.drive.amplifiers.scpi.driver import ScpiAmplifier
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.polled import PolledAmplifier

DEADLINE_S = 20.0


class Emulated:
    """One emulator: its port, its log, its faults."""

    def __init__(self, protocol: str, folder: Path, options: tuple[str, ...]) -> None:
        self.link, self.log = folder / protocol, folder / f'{protocol}.jsonl'
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', 'emulate', protocol, '--link', self.link,
             '--log', self.log, '--full-scale-A', str(FULL_SCALE_A), '--fault', '-', *options],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        *_, places = self.process.stdout.readline().partition(' at ')
        self.url = ','.join(places.split())

    def fault(self, text: str) -> None:
        """Let a fault happen from now on."""
        self.process.stdin.write(text + '\n')
        self.process.stdin.flush()

    def until(self, condition: Callable[[], object]) -> object:
        """The first true value of the condition; fails the test after a generous deadline."""
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            if value := condition():
                return value
            time.sleep(0.002)
        raise AssertionError('the awaited condition never came true')

    def entries(self) -> list[dict]:
        """What was logged so far."""
        return [json.loads(line) for line in self.log.read_text().splitlines(keepends=True)
                if line.endswith('\n')]

    def currents(self) -> list[float]:
        return self.entries()[-1]['currents_A']

    def eventually_at(self, currents: object, cause: str | None = None) -> dict:
        """The last entry, once it has these currents (and this cause)."""
        return self.until(lambda: (last := self.entries()[-1]) and (
            last['currents_A'] == pytest.approx(list(currents), abs=0.011 * FULL_SCALE_A)
            and cause in (None, last['cause']) and last))

    def end(self) -> int:
        if self.process.poll() is None:
            self.process.terminate()
        code = self.process.wait(DEADLINE_S)
        self.process.stdin.close()
        self.process.stdout.close()
        return code


@pytest.fixture
def emulate(tmp_path):
    """A function that starts the emulator of a protocol with options; all end with the test."""
    started = []

    def start(protocol: str, *options: str) -> Emulated:
        started.append(Emulated(protocol, tmp_path, options))
        return started[-1]

    yield start
    for emulated in started:
        emulated.end()


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """A machine that is busy with other tests may pause for longer than a line may, and an answer
    that it brings late spoils the next, which is waited for in vain, then asked for again."""
    monkeypatch.setattr('microbot_ros.drive.transport._WRITE_TIMEOUT_S', 5.0)
    monkeypatch.setattr(Amplifier, 'read_back_s', 2.0)


class Script:
    """Lines that expect exact bytes, answer as written, and let nothing be left over."""

    def __init__(self, exchanges: list[tuple[str, bytes, bytes]]) -> None:
        self.exchanges = exchanges
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
            return self.script._answers.pop(self.url, b'')

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
        # What is due again is no part of a script, though a busy machine takes long over it.
        monkeypatch.setattr('microbot_ros.drive.polled._INSPECT_S', 60.0)
        for kind in (PolledAmplifier, ScpiAmplifier):
            monkeypatch.setattr(kind, 'period_s', 0.3)
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
    device = Served(protocol, tmp_path, watchdog_s)
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
