"""Driver for Kepco BOP supplies in current mode, one serial line for each coil.

The supply has no watchdog: if the host dies it keeps its last current.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from microbot_ros.drive.amplifiers.scpi import codec
from microbot_ros.drive.errors import WrongDeviceError
from microbot_ros.drive.polled import Exchange, PolledAmplifier, Talk

_MAKER = 'KEPCO'
_LIMIT_AGREES = 1e-2
"""Largest relative deviation of the protection limit that is read back: supplies answer with three
digits (manual)."""
_LONG_LINE_S = 0.06
"""Time [s] that the 53 characters that configure a supply take at 9600 baud: 53 × 10 / 9600 =
0.055."""


class ScpiAmplifier(PolledAmplifier):
    """One supply per coil; `full_scale_A` becomes the supplies' own protection limit."""

    baud = 9_600
    """Rate of the line [1/s], the supply's default (manual)."""
    xon_xoff = True
    queues = True  # 1 ms a character
    zero_again = codec.line(codec.current(0.0))
    period_s = 0.05
    """Longest interval [s] between questions for currents. A command, a question and an answer
    take 44 ms."""
    reply_s = 0.08
    """Longest time [s] until an answer. A current and a question are 28 characters, the answer 14;
    two attempts stay below 0.2 s."""

    def _identify(self, device: int) -> Talk[None]:
        yield Exchange(codec.CLEAR_INPUT)
        identity = yield self._query('*IDN?', codec.text, 'an identity')
        if not identity.upper().startswith(_MAKER):
            raise WrongDeviceError(self.urls[device], f'a {_MAKER} supply', identity)

    def _configure(self, device: int) -> Talk[None]:
        limit = float(self.full_scale_A[device])
        yield Exchange(codec.line('FUNC:MODE CURR', codec.current(0.0),
                                  f'CURR:PROT:LIM {limit:.4E}'), rest_s=_LONG_LINE_S)
        taken = yield self._query('CURR:PROT:LIM?', codec.number, 'the protection limit')
        if not abs(taken - limit) <= _LIMIT_AGREES * limit:
            raise WrongDeviceError(self.urls[device], f'a limit of {limit:g} A', f'{taken:g} A')

    def _enable(self, device: int) -> Talk[None]:
        yield Exchange(codec.line('OUTP ON'))

    def _drive(self, device: int, currents_A: np.ndarray) -> Talk[None]:
        yield Exchange(codec.line(codec.current(float(currents_A[0]))))

    def _measure(self, device: int) -> Talk[Sequence[float]]:
        return [(yield self._query('MEAS:CURR?', codec.number, 'a measured current'))]

    def _inspect(self, device: int) -> Talk[str]:
        condition = yield self._query('STAT:QUES:COND?', codec.number,
                                      'the questionable-condition register')
        fault = codec.fault(condition)
        return fault and f'{self.urls[device]}: {fault}'

    def _zeros(self) -> list[bytes]:
        # ESC discards the supply's pending input.
        return [codec.CLEAR_INPUT + codec.line(codec.current(0.0))] * len(self.devices)

    def _switch_off(self, device: int) -> Talk[None]:
        yield Exchange(codec.line('OUTP OFF'))

    def _query(self, query: str, parse: Callable[[bytes], Any | None], expected: str) -> Exchange:
        return Exchange(codec.line(query), parse, expected)
