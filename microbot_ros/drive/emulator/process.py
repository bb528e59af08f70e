"""An emulated amplifier as a process of its own: terminals, log, signals, clean end."""

from __future__ import annotations

import importlib
import signal
from contextlib import ExitStack
from pathlib import Path

from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.device import Device
from microbot_ros.drive.emulator.terminal import Line, serve
from microbot_ros.errors import InputError

DEVICES = {
    'serial_transfer': 'microbot_ros.drive.serial_transfer.board:Board',
}
"""Protocol → emulated device, imported only where it is emulated."""


def run(protocol: str, link: Path, log: Path | None, full_scale_A: float,
        watchdog_s: float | None) -> None:
    """Emulate until SIGINT or SIGTERM; then the coils are at zero and the link is gone.

    A protocol with one port per coil gets the links `link`-1 to `link`-4. Raises InputError for
    a link or a log that cannot be made.
    """
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda received, _frame: signals.append(received))
    module, name = DEVICES[protocol].split(':')
    kind: type[Device] = getattr(importlib.import_module(module), name)
    with ExitStack() as stack:
        try:
            stream = stack.enter_context((log or Path('/dev/null')).open('w', encoding='utf-8'))
        except OSError as error:
            problem = f'expected a file to write the log to ({error.strerror})'
            raise InputError(log or '', problem) from None
        coils = Coils(full_scale_A, watchdog_s, stream)
        lines = []
        for path in links(link, kind.ports):
            lines.append(Line(path))
            stack.callback(lines[-1].close)
        stack.callback(coils.zero, 'power_off')
        print('serving', protocol, 'at', *(line.link for line in lines), flush=True)
        serve(kind(coils), lines, lambda: bool(signals))


def links(link: Path, ports: int) -> list[Path]:
    """The names of the lines of a device with that many ports."""
    if ports == 1:
        return [link]
    return [link.with_name(f'{link.name}-{number}') for number in range(1, ports + 1)]
