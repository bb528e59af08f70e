"""Driver for Kepco BOP supplies in current mode, one serial line for each coil.

The supply has no watchdog: when the host dies it keeps its last current.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from microbot_ros.drive.errors import WrongDeviceError
from microbot_ros.drive.polled import Exchange, PolledAmplifier, Talk
from microbot_ros.drive.scpi import codec

_MAKER = 'KEPCO'
_LIMIT_AGREES = 1e-2  # supplies answer with three digits


class ScpiAmplifier(PolledAmplifier):
    """A supply a coil; `full_scale_A` becomes their own protection limit."""

    channels_per_port = 1
    baud = 9_600
    xon_xoff = True
    period_s = 0.05
    reply_s = 0.1

    def _identify(self) -> Talk[None]:
        yield Exchange([codec.CLEAR_INPUT] * self.ports)
        identities = yield self._query('*IDN?', codec.text, 'an identity')
        for port, identity in zip(self._lines, identities, strict=True):
            if not identity.upper().startswith(_MAKER):
                raise WrongDeviceError(port.url, f'a {_MAKER} supply', identity)
        limits = self.full_scale_A.tolist()
        yield Exchange([codec.line('FUNC:MODE CURR', codec.current(0.0),
                                   f'CURR:PROT:LIM {limit:.4E}') for limit in limits])
        taken = yield self._query('CURR:PROT:LIM?', codec.number, 'the protection limit')
        for port, limit, value in zip(self._lines, limits, taken, strict=True):
            if not abs(value - limit) <= _LIMIT_AGREES * limit:
                raise WrongDeviceError(port.url, f'a limit of {limit:g} A', f'{value:g} A')
        yield Exchange([codec.line('OUTP ON')] * self.ports)

    def _drive(self, currents_A: np.ndarray) -> Talk[None]:
        yield Exchange([codec.line(codec.current(current)) for current in currents_A.tolist()])

    def _measure(self) -> Talk[np.ndarray]:
        return np.array((yield self._query('MEAS:CURR?', codec.number, 'a measured current')))

    def _inspect(self) -> Talk[str]:
        found = yield self._query('STAT:QUES:COND?', codec.number, 'the questionable condition')
        return '; '.join(f'{port.url}: {fault}' for port, condition
                         in zip(self._lines, found, strict=True)
                         if (fault := codec.fault(condition)))

    def _zeros(self) -> list[bytes]:
        return [codec.CLEAR_INPUT + codec.line('CURR 0')] * self.ports

    def _zero_at_once(self) -> None:
        for port in self._lines:  # 9600 baud: what waits there takes 1 ms a character
            port.discard_output()
        super()._zero_at_once()

    def _switch_off(self) -> Talk[None]:
        yield Exchange([codec.line('OUTP OFF')] * self.ports)

    def _query(self, query: str, parse: Callable[[bytes], Any | None], expected: str) -> Exchange:
        return Exchange([codec.line(query)] * self.ports, parse, expected)
