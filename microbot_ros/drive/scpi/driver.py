"""Driver for Kepco BOP supplies in current mode, one serial line for each coil.

The supply has no watchdog: when the host dies it keeps its last current.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from microbot_ros.drive.amplifier import COILS
from microbot_ros.drive.errors import WrongDeviceError
from microbot_ros.drive.polled import PolledAmplifier, Reply
from microbot_ros.drive.scpi import codec

_MAKER = 'KEPCO'
_LIMIT_AGREES = 1e-2  # supplies answer with three digits


class ScpiAmplifier(PolledAmplifier):
    """Four supplies; `full_scale_A` becomes their own protection limit."""

    ports = len(COILS)
    baud = 9_600
    xon_xoff = True
    period_s = 0.05
    reply_s = 0.1

    def _identify(self) -> None:
        for port in self._lines:
            port.send(codec.CLEAR_INPUT)
        identities = self._ask_all('*IDN?', codec.text, 'an identity')
        for port, identity in zip(self._lines, identities, strict=True):
            if not identity.upper().startswith(_MAKER):
                raise WrongDeviceError(port.url, f'a {_MAKER} supply', identity)
        limits = self.full_scale_A.tolist()
        for port, limit in zip(self._lines, limits, strict=True):
            setting = f'CURR:PROT:LIM {limit:.4E}'
            port.send(codec.line('FUNC:MODE CURR', codec.current(0.0), setting))
        taken = self._ask_all('CURR:PROT:LIM?', codec.number, 'the protection limit')
        for port, limit, value in zip(self._lines, limits, taken, strict=True):
            if not abs(value - limit) <= _LIMIT_AGREES * limit:
                raise WrongDeviceError(port.url, f'a limit of {limit:g} A', f'{value:g} A')
            port.send(codec.line('OUTP ON'))

    def _drive(self, currents_A: np.ndarray) -> None:
        for port, current in zip(self._lines, currents_A.tolist(), strict=True):
            port.send(codec.line(codec.current(current)))

    def _measure(self) -> np.ndarray:
        return np.array(self._ask_all('MEAS:CURR?', codec.number, 'a measured current'))

    def _inspect(self) -> str:
        found = self._ask_all('STAT:QUES:COND?', codec.number, 'the questionable condition')
        return '; '.join(f'{port.url}: {fault}' for port, condition
                         in zip(self._lines, found, strict=True)
                         if (fault := codec.fault(condition)))

    def _disable(self) -> None:
        for port in self._lines:
            port.send(codec.line('OUTP OFF'))

    def _ask_all(self, query: str, parse: Callable[[bytes], Reply | None],
                 expected: str) -> list[Reply]:
        return self._ask([codec.line(query)] * self.ports, parse, expected)
