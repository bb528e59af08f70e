"""Emulated Roboteq controllers, one on each line."""

from __future__ import annotations

import re

from microbot_ros.drive.amplifiers.roboteq import codec
from microbot_ros.drive.emulator.device import Device

_COMMAND = re.compile(r'!G ([12]) (-?\d{1,4})')
_POWER_UP_WATCHDOG_MS = 1000
"""Watchdog time at power-up [ms] (user manual, RWD)."""


class Controllers(Device):
    """Controllers of which only `!` commands feed the watchdog.

    After it fires the next command drives again. Both controllers have one watchdog here, as the
    driver sets them alike.
    """

    channels_per_port = 2
    """Channels of a controller (user manual)."""

    def reset(self) -> None:
        super().reset()
        self._pending = [b''] * self.ports
        self._echo = [True] * self.ports
        self._watchdog_ms = _POWER_UP_WATCHDOG_MS
        self.coils.watchdog_s = _POWER_UP_WATCHDOG_MS * 1e-3

    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        *lines, self._pending[port] = (self._pending[port] + data).split(codec.END)
        answers = b''
        for line in lines:
            if self._echo[port]:
                answers += line + codec.END
            text = line.decode('ascii', 'replace')
            answers += codec.line(self._execute(port, text)) if text else b''
        return answers

    def _execute(self, port: int, text: str) -> str:
        command = _COMMAND.fullmatch(text)
        if command:
            return self._drive(port, int(command[1]), int(command[2]))
        match text.split(' '):
            case ['?FID']:
                wrong = port in self.wrong_ports
                return 'FID=' + ('Sabertooth' if wrong else 'Roboteq v2.1 SDC2130')
            case ['?A']:
                both = (*self.coils.currents_A, 0.0)[2 * port:2 * port + 2]
                tenths = [round(current / codec.CURRENT_STEP_A) for current in both]
                return f'A={tenths[0]}:{tenths[1]}'
            case ['?FF']:
                return f'FF={int(self.hot)}'
            case ['~RWD']:
                return f'RWD={self._watchdog_ms}'
            case ['^RWD', value] if re.fullmatch('[0-9]{1,5}', value):
                self._watchdog_ms = int(value)
                self.coils.watchdog_s = self._watchdog_ms * 1e-3 if self._watchdog_ms else None
                return '+'
            case ['^ECHOF', '0' | '1' as off]:
                self._echo[port] = off == '0'
                return '+'
        return '-'

    def _drive(self, port: int, channel: int, value: int) -> str:
        if not -codec.FULL_COMMAND <= value <= codec.FULL_COMMAND:
            return '-'
        current = value / codec.FULL_COMMAND * self.coils.full_scale_A
        self.coils.command({2 * port + channel - 1: current})
        return '+'
