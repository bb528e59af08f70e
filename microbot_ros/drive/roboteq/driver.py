"""Driver for Roboteq controllers: coils 1 and 2 on the first line, 3 and 4 on the second, …"""

from __future__ import annotations

from functools import partial

import numpy as np

from microbot_ros.drive.amplifier import Watchdog
from microbot_ros.drive.errors import WrongDeviceError
from microbot_ros.drive.polled import Exchange, PolledAmplifier, Talk
from microbot_ros.drive.roboteq import codec

_WATCHDOG_MS = 100
_MODEL = 'Roboteq'


class RoboteqAmplifier(PolledAmplifier):
    """Command −1000 … 1000 is ± `full_scale_A` of each coil; the controllers' watchdog is armed.

    They report currents in steps of 0.1 A.
    """

    watchdog = Watchdog.ARMED
    channels_per_port = 2
    resolution_A = codec.CURRENT_STEP_A

    def _identify(self) -> Talk[None]:
        # Once more than needed: the echo of what switches it off comes before the answer.
        yield Exchange([codec.END + codec.line('^ECHOF 1')] * self.ports,
                       lambda received: received.endswith(b'+' + codec.END) or None,
                       'no more echo')
        names = yield Exchange([codec.line('?FID')] * self.ports, partial(codec.text, 'FID'),
                               'a firmware name')
        for port, name in zip(self._lines, names, strict=True):
            if not name.startswith(_MODEL):
                raise WrongDeviceError(port.url, f'a {_MODEL} controller', name)
        yield Exchange([codec.drive(0.0, 0.0)] * self.ports, partial(codec.accepted, 2),
                       'a zero accepted')
        yield Exchange([codec.line(f'^RWD {_WATCHDOG_MS}')] * self.ports,
                       partial(codec.accepted, 1), 'a watchdog accepted')
        armed = yield Exchange([codec.line('~RWD')] * self.ports, partial(codec.text, 'RWD'),
                               'its watchdog')
        if armed != [str(_WATCHDOG_MS)] * self.ports:
            raise WrongDeviceError(self.url, f'a watchdog of {_WATCHDOG_MS} ms', f'{armed} ms')

    def _drive(self, currents_A: np.ndarray) -> Talk[None]:
        shares = [*(currents_A / self.full_scale_A).tolist(), 0.0]  # of a channel that is spare
        yield Exchange([codec.drive(first, second) for first, second
                        in zip(shares[::2], shares[1::2], strict=False)],
                       partial(codec.accepted, 2), 'a command accepted')

    def _measure(self) -> Talk[np.ndarray]:
        found = yield Exchange([codec.line('?A')] * self.ports, codec.currents, 'currents')
        return np.ravel(found)[:self.channels]

    def _inspect(self) -> Talk[str]:
        found = yield Exchange([codec.line('?FF')] * self.ports, codec.faults, 'fault flags')
        return '; '.join(f'{port.url}: {", ".join(faults)}'
                         for port, faults in zip(self._lines, found, strict=True) if faults)

    def _zeros(self) -> list[bytes]:
        return [codec.END + codec.drive(0.0, 0.0)] * self.ports
