"""Driver for RoboClaw controllers on one line, with two coils each.

Coils 1 and 2 are at address 0x80, 3 and 4 at 0x81, and so on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from microbot_ros.drive.amplifier import Watchdog
from microbot_ros.drive.amplifiers.roboclaw import codec
from microbot_ros.drive.errors import NoAnswerError, WrongDeviceError
from microbot_ros.drive.polled import Exchange, PolledAmplifier, Talk

ADDRESSES = range(0x80, 0x88)
"""Addresses of the controllers, each of which has two channels (user manual)."""
_WATCHDOG_S = 0.1
"""Timeout of the controllers [s]. Choice: the shortest they have, which is twice the refresh of
commands."""
_MODEL = 'roboclaw'
_HOTTEST_C = 85.0
"""Temperature [°C] above which the controller gives less current than commanded (user manual,
temperature limits)."""


class RoboclawAmplifier(PolledAmplifier):
    """Controllers whose duty −1 … 1 is ± `full_scale_A` of each coil.

    The driver arms their own timeout.
    """

    watchdog = Watchdog.ARMED
    channels_per_device = 2
    """Channels of a controller (user manual)."""
    share_a_line = True
    resolution_A = 0.01
    """Step of the reported currents [A], `codec.CURRENT_STEP_A`."""

    def _identify(self, device: int) -> Talk[None]:
        question = codec.ask(ADDRESSES[device], codec.GET_VERSION)
        name = yield self._query(question, codec.version, 'a version')
        if _MODEL not in name.lower():
            raise WrongDeviceError(self.url, 'a RoboClaw', name)

    def _configure(self, device: int) -> Talk[None]:
        address = ADDRESSES[device]
        yield self._obeyed(codec.drive(address, 0.0, 0.0))
        yield self._obeyed(codec.set_timeout(address, _WATCHDOG_S))
        armed = yield self._timeout(address)
        if not abs(armed - _WATCHDOG_S) < 1e-6:
            raise WrongDeviceError(self.url, f'a timeout of {_WATCHDOG_S:g} s', f'{armed:g} s')

    def _drive(self, device: int, currents_A: np.ndarray) -> Talk[None]:
        yield self._obeyed(codec.drive(ADDRESSES[device], *self._duties(device, currents_A)))

    def _measure(self, device: int) -> Talk[Sequence[float]]:
        question = codec.ask(ADDRESSES[device], codec.GET_CURRENTS)
        measured: Sequence[float] = yield self._query(question, codec.currents, 'currents')
        return measured

    def _inspect(self, device: int) -> Talk[str]:
        address = ADDRESSES[device]
        armed = yield self._timeout(address)
        if not abs(armed - _WATCHDOG_S) < 1e-6:  # it was reset: connecting arms it again
            raise NoAnswerError(self.url, f'a timeout of {_WATCHDOG_S:g} s at {address:#x} '
                                          f'(it has {armed:g} s: it was reset)')
        question = codec.ask(address, codec.GET_TEMPERATURE)
        found = yield self._query(question, codec.temperature, 'a temperature')
        if not found <= _HOTTEST_C:
            return (f'controller {address:#x} is too hot: {found:.1f} °C, '
                    f'at most {_HOTTEST_C:g}')
        return ''

    def _timeout(self, address: int) -> Exchange:
        return self._query(codec.ask(address, codec.GET_TIMEOUT), codec.timeout, 'its timeout')

    def _zeros(self) -> list[bytes]:
        return [b''.join(codec.drive(ADDRESSES[device], 0.0, 0.0) for device in self.devices)]

    def _obeyed(self, packet: bytes) -> Exchange:
        return Exchange(packet, lambda received: received == codec.ACKNOWLEDGED or None, 'FF')

    def _query(self, question: bytes, parse: Callable[[bytes, bytes], Any | None],
               expected: str) -> Exchange:
        return Exchange(question, partial(parse, question),
                        f'{expected} from the controller at {question[0]:#x}')
