"""Driver for two RoboClaw controllers on one line: coils 1 and 2 at 0x80, 3 and 4 at 0x81."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from microbot_ros.drive.errors import WrongDeviceError
from microbot_ros.drive.polled import PolledAmplifier, Reply
from microbot_ros.drive.roboclaw import codec

ADDRESSES = (0x80, 0x81)
_WATCHDOG_S = 0.1
_MODEL = 'roboclaw'
_HOTTEST_C = 85.0
"""Above this the controller gives less current than it is told (user manual, temperature
limits)."""


class RoboclawAmplifier(PolledAmplifier):
    """Duty −1 … 1 is ± `full_scale_A` of each coil; the controllers' own timeout is armed."""

    resolution_A = 0.01

    def _identify(self) -> None:
        for address in ADDRESSES:
            name = self._query(codec.ask_version(address), codec.version, 'a version')
            if _MODEL not in name.lower():
                raise WrongDeviceError(self.url, 'a RoboClaw', name)
            self._order(codec.drive(address, 0.0, 0.0))
            self._order(codec.set_timeout(address, _WATCHDOG_S))
            armed = self._query(codec.ask_timeout(address), codec.timeout, 'its timeout')
            if not abs(armed - _WATCHDOG_S) < 1e-6:
                expected = f'a timeout of {_WATCHDOG_S:g} s'
                raise WrongDeviceError(self.url, expected, f'{armed:g} s')

    def _drive(self, currents_A: np.ndarray) -> None:
        duties = (currents_A / self.full_scale_A).tolist()
        self._order(codec.drive(ADDRESSES[0], duties[0], duties[1]))
        self._order(codec.drive(ADDRESSES[1], duties[2], duties[3]))

    def _measure(self) -> np.ndarray:
        return np.array([self._query(codec.ask_currents(address), codec.currents, 'currents')
                         for address in ADDRESSES]).ravel()

    def _inspect(self) -> str:
        for address in ADDRESSES:
            found = self._query(codec.ask_temperature(address), codec.temperature, 'a temperature')
            if not found <= _HOTTEST_C:
                return (f'controller {address:#x} is too hot: {found:.1f} °C, '
                        f'at most {_HOTTEST_C:g}')
        return ''

    def _order(self, packet: bytes) -> None:
        self._ask([packet], lambda received: received == codec.ACKNOWLEDGED or None, 'FF')

    def _query(self, question: bytes, parse: Callable[[bytes, bytes], Reply | None],
               expected: str) -> Reply:
        return self._ask([question], partial(parse, question), expected)[0]
