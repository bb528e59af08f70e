"""Driver for Modbus RTU H-bridges, slaves 1, 2, … on one line.

The bridges have no watchdog: when the host dies they keep their last duty.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from microbot_ros.drive.modbus import codec
from microbot_ros.drive.polled import Exchange, PolledAmplifier, Talk

EVERY_SLAVE = 0
"""Takes what all slaves are to obey and none answers (Modbus over serial line, 2.1)."""
_HOTTEST_C = 85.0
"""What electronics of the industrial grade are made for."""


class ModbusAmplifier(PolledAmplifier):
    """Duty −1 … 1, in steps of 1 %, is ± `full_scale_A` of each coil."""

    baud = 1_000_000
    gap_s = 0.002
    resolution_A = 0.001

    @property
    def _slaves(self) -> range:
        return range(1, self.channels + 1)

    def _identify(self) -> Talk[None]:
        for slave in self._slaves:
            yield self._set(slave, codec.DUTY_PERCENT, 0)
            yield self._set(slave, codec.ENABLE, 1)

    def _drive(self, currents_A: np.ndarray) -> Talk[None]:
        duties = (currents_A / self.full_scale_A).tolist()
        if not any(duties):
            yield Exchange(self._zeros(), rest_s=self.gap_s)
        for slave, duty in zip(self._slaves, duties, strict=True):
            yield self._set(slave, codec.DUTY_PERCENT, codec.duty_percent(duty))

    def _measure(self) -> Talk[np.ndarray]:
        currents = []
        for slave in self._slaves:
            answer, = yield self._get(slave, range(codec.CURRENT_MA, codec.CURRENT_MA + 1))
            currents.append(answer[0] * 1e-3)
        return np.array(currents)

    def _inspect(self) -> Talk[str]:
        fault = ''
        for slave in self._slaves:
            temperatures, = yield self._get(slave, codec.TEMPERATURES)
            hottest = max(temperatures) * 1e-2
            if not hottest <= _HOTTEST_C:
                fault = f'slave {slave} is too hot: {hottest:g} °C, at most {_HOTTEST_C:g}'
        return fault

    def _zeros(self) -> list[bytes]:
        return [codec.write(EVERY_SLAVE, codec.DUTY_PERCENT, 0)]

    def _switch_off(self) -> Talk[None]:
        for slave in self._slaves:
            yield self._set(slave, codec.ENABLE, 0)

    def _get(self, slave: int, registers: range) -> Exchange:
        count = len(registers)
        return Exchange([codec.read(slave, registers.start, count)],
                        partial(codec.values, slave, count),
                        f'registers {registers} of slave {slave}')

    def _set(self, slave: int, register: int, value: int) -> Exchange:
        request = codec.write(slave, register, value)
        return Exchange([request], partial(codec.written, slave, request),
                        f'an echo of slave {slave}')
