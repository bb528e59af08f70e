"""Driver for RoboClaw controllers on one line: coils 1 and 2 at 0x80, 3 and 4 at 0x81, …"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from microbot_ros.drive.amplifier import Watchdog
from microbot_ros.drive.errors import WrongDeviceError
from microbot_ros.drive.polled import Exchange, PolledAmplifier, Talk
from microbot_ros.drive.roboclaw import codec

ADDRESSES = range(0x80, 0x88)
"""Of the controllers; each has two channels."""
_WATCHDOG_S = 0.1
_MODEL = 'roboclaw'
_HOTTEST_C = 85.0
"""Above this the controller gives less current than it is told (user manual, temperature
limits)."""


class RoboclawAmplifier(PolledAmplifier):
    """Duty −1 … 1 is ± `full_scale_A` of each coil; the controllers' own timeout is armed."""

    watchdog = Watchdog.ARMED
    resolution_A = 0.01

    @property
    def _addresses(self) -> range:
        return ADDRESSES[:-(-self.channels // 2)]

    def _identify(self) -> Talk[None]:
        for address in self._addresses:
            name, = yield self._query(codec.ask_version(address), codec.version, 'a version')
            if _MODEL not in name.lower():
                raise WrongDeviceError(self.url, 'a RoboClaw', name)
            yield self._obeyed(codec.drive(address, 0.0, 0.0))
            yield self._obeyed(codec.set_timeout(address, _WATCHDOG_S))
            armed, = yield self._query(codec.ask_timeout(address), codec.timeout, 'its timeout')
            if not abs(armed - _WATCHDOG_S) < 1e-6:
                expected = f'a timeout of {_WATCHDOG_S:g} s'
                raise WrongDeviceError(self.url, expected, f'{armed:g} s')

    def _drive(self, currents_A: np.ndarray) -> Talk[None]:
        duties = [*(currents_A / self.full_scale_A).tolist(), 0.0]  # of a channel that is spare
        for address, first, second in zip(self._addresses, duties[::2], duties[1::2],
                                          strict=False):
            yield self._obeyed(codec.drive(address, first, second))

    def _measure(self) -> Talk[np.ndarray]:
        found = []
        for address in self._addresses:
            found += yield self._query(codec.ask_currents(address), codec.currents, 'currents')
        return np.ravel(found)[:self.channels]

    def _inspect(self) -> Talk[str]:
        fault = ''
        for address in self._addresses:
            found, = yield self._query(codec.ask_temperature(address), codec.temperature,
                                       'a temperature')
            if not found <= _HOTTEST_C:
                fault = (f'controller {address:#x} is too hot: {found:.1f} °C, '
                         f'at most {_HOTTEST_C:g}')
        return fault

    def _zeros(self) -> list[bytes]:
        return [b''.join(codec.drive(address, 0.0, 0.0) for address in self._addresses)]

    def _obeyed(self, packet: bytes) -> Exchange:
        return Exchange([packet], lambda received: received == codec.ACKNOWLEDGED or None, 'FF')

    def _query(self, question: bytes, parse: Callable[[bytes, bytes], Any | None],
               expected: str) -> Exchange:
        return Exchange([question], partial(parse, question), expected)
