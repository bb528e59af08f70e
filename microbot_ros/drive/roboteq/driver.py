"""Driver for two Roboteq controllers: coils 1 and 2 on the first line, 3 and 4 on the second."""

from __future__ import annotations

from functools import partial

import numpy as np

from microbot_ros.drive.errors import WrongDeviceError
from microbot_ros.drive.polled import PolledAmplifier
from microbot_ros.drive.roboteq import codec

_WATCHDOG_MS = 100
_MODEL = 'Roboteq'


class RoboteqAmplifier(PolledAmplifier):
    """Command −1000 … 1000 is ± `full_scale_A` of each coil; the controllers' watchdog is armed.

    They report currents in steps of 0.1 A.
    """

    ports = 2
    resolution_A = codec.CURRENT_STEP_A

    def _identify(self) -> None:
        # Once more than needed: the echo of what switches it off comes before the answer.
        self._ask([codec.END + codec.line('^ECHOF 1')] * 2,
                  lambda received: received.endswith(b'+' + codec.END) or None, 'no more echo')
        names = self._ask([codec.line('?FID')] * 2, partial(codec.text, 'FID'), 'a firmware name')
        for port, name in zip(self._lines, names, strict=True):
            if not name.startswith(_MODEL):
                raise WrongDeviceError(port.url, f'a {_MODEL} controller', name)
        self._ask([codec.drive(0.0, 0.0)] * 2, partial(codec.accepted, 2), 'a zero accepted')
        self._ask([codec.line(f'^RWD {_WATCHDOG_MS}')] * 2, partial(codec.accepted, 1),
                  'a watchdog accepted')
        armed = self._ask([codec.line('~RWD')] * 2, partial(codec.text, 'RWD'), 'its watchdog')
        if armed != [str(_WATCHDOG_MS)] * 2:
            raise WrongDeviceError(self.url, f'a watchdog of {_WATCHDOG_MS} ms', f'{armed} ms')

    def _drive(self, currents_A: np.ndarray) -> None:
        first, second, third, fourth = (currents_A / self.full_scale_A).tolist()
        self._ask([codec.drive(first, second), codec.drive(third, fourth)],
                  partial(codec.accepted, 2), 'a command accepted')

    def _inspect(self) -> str:
        found = self._ask([codec.line('?FF')] * 2, codec.faults, 'fault flags')
        return '; '.join(f'{port.url}: {", ".join(faults)}'
                         for port, faults in zip(self._lines, found, strict=True) if faults)

    def _measure(self) -> np.ndarray:
        return np.array(self._ask([codec.line('?A')] * 2, codec.currents, 'currents')).ravel()
