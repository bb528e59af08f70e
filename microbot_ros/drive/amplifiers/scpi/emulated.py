"""Emulated Kepco BOP supplies."""

from __future__ import annotations

from microbot_ros.drive.amplifiers.scpi import codec
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.device import Device

_OVERTEMPERATURE = 8
"""Bit 3 of the questionable condition in the BIT 232 interface (Kepco's manual)."""


class Supplies(Device):
    """Supplies, one per line: outputs off at power-up, no watchdog whatever the host requests.

    Parameters
    ----------
    coils : Coils
        Currents that they drive.
    """

    channels_per_port = 1
    """One supply on each line (the rig's wiring)."""

    def __init__(self, coils: Coils) -> None:
        coils.watchdog_s = None
        super().__init__(coils)

    def reset(self) -> None:
        super().reset()
        self._pending = [b''] * self.ports
        self._limits = [self.coils.full_scale_A] * self.ports
        self._wanted = [0.0] * self.ports
        self._enabled = [False] * self.ports

    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        pending = (self._pending[port] + data).rpartition(codec.CLEAR_INPUT)[2]
        *lines, self._pending[port] = pending.replace(b'\r', b'\n').split(b'\n')
        answers = [self._execute(port, command.strip().decode('ascii', 'replace').upper())
                   for line in lines if len(line) < codec.LONGEST_LINE
                   for command in line.split(b';')]
        return b''.join(answer.encode() + b'\n' for answer in answers if answer)

    def _execute(self, port: int, command: str) -> str:
        match command.split(' '):
            case ['*IDN?']:
                maker = 'HEWLETT-PACKARD' if port in self.wrong_ports else 'KEPCO'
                return f'{maker},BOP 20-5,E1234,3.05'
            case ['CURR?']:
                return f'{self._wanted[port]:.2E}'
            case ['MEAS:CURR?']:
                return f'{self.coils.currents_A[port]:.4E}'
            case ['STAT:QUES:COND?']:
                return str(_OVERTEMPERATURE if self.hot else 0)
            case ['CURR:PROT:LIM?']:
                return f'{self._limits[port]:.4E}'
            case ['CURR', text]:
                self._set(port, text)
            case ['CURR:PROT:LIM', text]:
                limit = codec.number(text.encode() + b'\n')
                if limit is not None and 0.0 <= limit <= self.coils.full_scale_A:
                    self._limits[port] = limit
            case ['OUTP', 'ON' | 'OFF' as state]:
                self._enabled[port] = state == 'ON'
                self._apply(port)
        return ''

    def _set(self, port: int, text: str) -> None:
        current = codec.number(text.encode() + b'\n')
        if current is not None and abs(current) <= self._limits[port]:
            self._wanted[port] = current
            self._apply(port)

    def _apply(self, port: int) -> None:
        self.coils.command({port: self._wanted[port] if self._enabled[port] else 0.0})
