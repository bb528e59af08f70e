"""Driver for Modbus RTU H-bridges, slaves 1, 2, … on one line.

The bridges have no watchdog: if the host dies they keep their last duty.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from microbot_ros.drive.amplifiers.modbus import codec
from microbot_ros.drive.polled import Exchange, PolledAmplifier, Talk

EVERY_SLAVE = 0
"""Address of requests that all slaves obey and none answers (Modbus over serial line, 2.1)."""
_HOTTEST_C = 85.0
"""Highest temperature [°C] of industrial-grade electronics (their usual specification)."""


class ModbusAmplifier(PolledAmplifier):
    """Amplifier whose duty −1 … 1, in steps of 1 %, is ± `full_scale_A` of each coil."""

    share_a_line = True
    baud = 1_000_000
    """Rate of the line [1/s], that of the laboratory's firmware."""
    gap_s = 0.002
    """Silence [s] that ends a request: the 1.75 ms of the standard (Modbus over serial line,
    2.5.1.1), with room."""
    resolution_A = 0.001
    """Step of the reported currents [A], that of the register: 1 mA."""

    def _identify(self, device: int) -> Talk[None]:
        """Set the duty to 0, as a bridge has no register that identifies it."""
        yield self._set(device, codec.DUTY_PERCENT, 0)

    def _enable(self, device: int) -> Talk[None]:
        yield self._set(device, codec.ENABLE, 1)

    def _drive(self, device: int, currents_A: np.ndarray) -> Talk[None]:
        if device == self.devices[0] and not self._flowing:
            everywhere, = self._zeros()
            yield Exchange(everywhere, rest_s=self.gap_s)
        duty, = self._duties(device, currents_A)
        yield self._set(device, codec.DUTY_PERCENT, codec.duty_percent(duty))

    def _measure(self, device: int) -> Talk[Sequence[float]]:
        milliamperes = yield self._get(device, range(codec.CURRENT_MA, codec.CURRENT_MA + 1))
        return [value * 1e-3 for value in milliamperes]

    def _inspect(self, device: int) -> Talk[str]:
        temperatures = yield self._get(device, codec.TEMPERATURES)
        hottest = max(temperatures) * 1e-2
        if not hottest <= _HOTTEST_C:
            return f'slave {1 + device} is too hot: {hottest:g} °C, at most {_HOTTEST_C:g}'
        return ''

    def _zeros(self) -> list[bytes]:
        return [codec.write(EVERY_SLAVE, codec.DUTY_PERCENT, 0)]

    def _switch_off(self, device: int) -> Talk[None]:
        yield self._set(device, codec.ENABLE, 0)

    def _get(self, device: int, registers: range) -> Exchange:
        slave, count = 1 + device, len(registers)
        return Exchange(codec.read(slave, registers.start, count),
                        partial(codec.values, slave, count),
                        f'registers {registers} of slave {slave}')

    def _set(self, device: int, register: int, value: int) -> Exchange:
        slave = 1 + device
        request = codec.write(slave, register, value)
        return Exchange(request, partial(codec.written, slave, request),
                        f'an echo of slave {slave}')
