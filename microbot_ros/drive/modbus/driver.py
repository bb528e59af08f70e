"""Driver for four Modbus RTU H-bridges, slaves 1 to 4 on one line.

The bridges have no watchdog: when the host dies they keep their last duty.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from microbot_ros.drive.modbus import codec
from microbot_ros.drive.polled import PolledAmplifier

SLAVES = (1, 2, 3, 4)
_HOTTEST_C = 85.0
"""What electronics of the industrial grade are made for."""


class ModbusAmplifier(PolledAmplifier):
    """Duty −1 … 1, in steps of 1 %, is ± `full_scale_A` of each coil."""

    baud = 1_000_000
    resolution_A = 0.001

    def _identify(self) -> None:
        for slave in SLAVES:
            self._set(slave, codec.DUTY_PERCENT, 0)
            self._set(slave, codec.ENABLE, 1)

    def _drive(self, currents_A: np.ndarray) -> None:
        duties = (currents_A / self.full_scale_A).tolist()
        for slave, duty in zip(SLAVES, duties, strict=True):
            self._set(slave, codec.DUTY_PERCENT, codec.duty_percent(duty))

    def _measure(self) -> np.ndarray:
        return np.ravel([self._get(slave, range(codec.CURRENT_MA, codec.CURRENT_MA + 1))
                         for slave in SLAVES]) * 1e-3

    def _inspect(self) -> str:
        for slave in SLAVES:
            hottest = max(self._get(slave, codec.TEMPERATURES)) * 1e-2
            if not hottest <= _HOTTEST_C:
                return f'slave {slave} is too hot: {hottest:g} °C, at most {_HOTTEST_C:g}'
        return ''

    def _disable(self) -> None:
        for slave in SLAVES if self._lines else ():
            self._set(slave, codec.ENABLE, 0)

    def _get(self, slave: int, registers: range) -> tuple[int, ...]:
        count = len(registers)
        return self._ask([codec.read(slave, registers.start, count)],
                         partial(codec.values, slave, count),
                         f'registers {registers} of slave {slave}')[0]

    def _set(self, slave: int, register: int, value: int) -> None:
        request = codec.write(slave, register, value)
        self._ask([request], partial(codec.written, slave, request), f'an echo of slave {slave}')
