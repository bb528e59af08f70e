"""Driver for Roboteq controllers, with two coils each.

Coils 1 and 2 are on the first line, 3 and 4 on the second, and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from microbot_ros.drive.amplifier import Watchdog
from microbot_ros.drive.amplifiers.roboteq import codec
from microbot_ros.drive.errors import WrongDeviceError
from microbot_ros.drive.polled import Exchange, PolledAmplifier, Talk

_WATCHDOG_MS = 100
"""Watchdog time [ms]. Choice: twice the refresh of commands (40 ms) fits in it; shorter would zero
coils when this machine is busy."""
_MODEL = 'Roboteq'


class RoboteqAmplifier(PolledAmplifier):
    """Controllers whose command −1000 … 1000 is ± `full_scale_A` of each coil.

    The driver arms their watchdog. They report currents in steps of 0.1 A.
    """

    watchdog = Watchdog.ARMED
    channels_per_device = 2
    """Channels of a controller (user manual)."""
    resolution_A = codec.CURRENT_STEP_A

    def _identify(self, device: int) -> Talk[None]:
        # The echo of this command itself precedes the answer.
        yield Exchange(codec.END + codec.line('^ECHOF 1'),
                       lambda received: received.endswith(b'+' + codec.END) or None,
                       'the echo switched off')
        name = yield Exchange(codec.line('?FID'), partial(codec.text, 'FID'), 'a firmware name')
        if not name.startswith(_MODEL):
            raise WrongDeviceError(self.urls[device], f'a {_MODEL} controller', name)

    def _configure(self, device: int) -> Talk[None]:
        yield Exchange(codec.drive(0.0, 0.0), partial(codec.accepted, 2), 'a zero accepted')
        yield Exchange(codec.line(f'^RWD {_WATCHDOG_MS}'), partial(codec.accepted, 1),
                       'a watchdog accepted')
        armed = yield Exchange(codec.line('~RWD'), partial(codec.text, 'RWD'), 'its watchdog')
        if armed != str(_WATCHDOG_MS):
            raise WrongDeviceError(self.urls[device], f'a watchdog of {_WATCHDOG_MS} ms',
                                   f'{armed} ms')

    def _drive(self, device: int, currents_A: np.ndarray) -> Talk[None]:
        yield Exchange(codec.drive(*self._duties(device, currents_A)), partial(codec.accepted, 2),
                       'a command accepted')

    def _measure(self, device: int) -> Talk[Sequence[float]]:
        measured: Sequence[float] = yield Exchange(codec.line('?A'), codec.currents, 'currents')
        return measured

    def _inspect(self, device: int) -> Talk[str]:
        faults = yield Exchange(codec.line('?FF'), codec.faults, 'fault flags')
        return f'{self.urls[device]}: {", ".join(faults)}' if faults else ''

    def _zeros(self) -> list[bytes]:
        return [codec.END + codec.drive(0.0, 0.0)] * len(self.devices)
