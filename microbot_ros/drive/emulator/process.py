"""Emulated amplifier as a process: terminals, log, signals, clean end."""

from __future__ import annotations

import importlib
import os
import sys
import threading
import time
from contextlib import ExitStack
from io import TextIOBase
from pathlib import Path
from queue import SimpleQueue
from typing import TextIO, cast

from microbot_ros.common.ending import Ending, find_launcher
from microbot_ros.common.errors import InputError
from microbot_ros.common.real_time import SAFETY, set_realtime_priority_of_all
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.device import Device
from microbot_ros.drive.emulator.faults import Faults, parse
from microbot_ros.drive.emulator.line import Line
from microbot_ros.drive.emulator.server import Server

_LOG = b'{"t_monotonic_s": '
"""First bytes of a log, which `Coils` writes."""

DEVICES = {
    'serial_transfer': 'microbot_ros.drive.amplifiers.serial_transfer.emulated:Board',
    'scpi': 'microbot_ros.drive.amplifiers.scpi.emulated:Supplies',
    'roboclaw': 'microbot_ros.drive.amplifiers.roboclaw.emulated:Controllers',
    'modbus': 'microbot_ros.drive.amplifiers.modbus.emulated:Bridges',
    'sabertooth': 'microbot_ros.drive.amplifiers.sabertooth.emulated:Controllers',
    'roboteq': 'microbot_ros.drive.amplifiers.roboteq.emulated:Controllers',
}
"""Emulated device by protocol, imported only when it is emulated."""


def make_device(protocol: str, coils: Coils) -> Device:
    """Return the emulated amplifier that speaks a protocol.

    Parameters
    ----------
    protocol : str
        Name of the protocol.
    coils : Coils
        Currents that it drives.

    Returns
    -------
    Device
        The device.
    """
    module, name = DEVICES[protocol].split(':')
    device: Device = getattr(importlib.import_module(module), name)(coils)
    return device


def run(protocol: str, link: Path, log: Path | None, full_scale_A: float,
        watchdog_s: float | None, faults: list[str], channels: int = 4) -> None:
    """Emulate until a signal or the launcher ends the process (`Ending`).

    At the end the coils are at zero and the link is gone.

    Parameters
    ----------
    protocol : str
        Name of the protocol.
    link : Path
        Path of the link. A protocol with several ports uses the links `link`-1, `link`-2 and so
        on.
    log : Path or None
        File of the log; None for none.
    full_scale_A : float
        Largest current of the device [A].
    watchdog_s : float or None
        Watchdog time of the device [s]; None for no watchdog.
    faults : list of str
        Faults as `parse` reads them. `-` means that more arrive on standard input, one per line.
    channels : int
        Number of coils N.

    Raises
    ------
    InputError
        If a link or a log cannot be made or would replace something else, or if a fault is
        invalid.
    """
    started = time.monotonic()
    planned = [parse(text, started) for text in faults if text != '-']
    with Ending(launcher=find_launcher()) as ending, ExitStack() as stack:
        diary = stack.enter_context(_Diary())
        coils = Coils(full_scale_A, watchdog_s, cast(TextIO, diary),
                      channels=channels)
        device = make_device(protocol, coils)
        for fault in planned:
            fault.check(channels, device.ports)
        lines = []
        for path in links(link, device.ports):
            lines.append(Line(path))
            stack.callback(lines[-1].unplug)
        diary.begin(_open_log(log))  # an earlier log stays where no line can be made
        stack.callback(coils.zero, 'power_off')
        # A real board is not delayed by other programs of this machine.
        set_realtime_priority_of_all(SAFETY)
        more = sys.stdin.fileno() if '-' in faults else None
        server = Server(device, lines, Faults(planned), more)
        print('serving', protocol, 'at', *(line.link for line in lines), flush=True)
        server.run(lambda: ending.due)


class _Diary(TextIOBase):
    """Log whose lines a thread writes, in order: a board must not wait for a busy disk."""

    def __init__(self) -> None:
        self._lines: SimpleQueue[str | None] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def begin(self, file: TextIO) -> None:
        """Write everything to a file, which is closed at the end."""
        self._thread = threading.Thread(
            target=self._write_down, args=(file,), name='log', daemon=True)
        self._thread.start()

    def write(self, line: str) -> int:
        self._lines.put(line)
        return len(line)

    def close(self) -> None:
        self._lines.put(None)
        if self._thread is not None:
            self._thread.join()
        super().close()

    def _write_down(self, file: TextIO) -> None:
        with file:
            for line in iter(self._lines.get, None):
                file.write(line)
                file.flush()


def _open_log(log: Path | None) -> TextIO:
    try:
        if log and log.is_file():
            with log.open('rb') as before:
                if before.read(len(_LOG)) not in (b'', _LOG):
                    raise InputError(log, 'expected a new file or the log of an emulator, which '
                                          'is replaced; found another file')
        return (log or Path(os.devnull)).open('w', encoding='utf-8')
    except OSError as error:
        problem = f'expected a file to write the log to ({error.strerror})'
        raise InputError(log or '', problem) from None


def links(link: Path, ports: int) -> list[Path]:
    """Return the names of the lines of a device.

    Parameters
    ----------
    link : Path
        Path of the link.
    ports : int
        Number of lines.

    Returns
    -------
    list of Path
        One path per line.
    """
    if ports == 1:
        return [link]
    return [link.with_name(f'{link.name}-{number}') for number in range(1, ports + 1)]
