"""A virtual rig whose inside is not that of the library: `python -m bench._software_timed_rig`.

Fields act on whole frames: what flows when a frame is exposed is taken to have flowed since the
frame before. A program stamps the frames, late by an exponential time of 3 ms in the mean.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from microbot_ros.nodes import virtual_rig
from microbot_ros.nodes.base.participant import leave
from microbot_ros.nodes.process import run

LATE_S = 3e-3
"""Mean lateness [s] of a stamp. Choice: that of USB cameras stamped on arrival is 1 to 10 ms."""
_BEFORE_ALL_S = -1e9


class SoftwareTimedRig(virtual_rig.VirtualRigNode):
    """The node `virtual_rig` with another clock inside."""

    def setup(self) -> None:
        super().setup()
        self._log: Any = _Newest(self._log)
        self._images: Any = _Late(self._images, np.random.default_rng(self.settings.seed))


class _Newest:
    """Log of an amplifier: its newest currents only, as if they had always flowed."""

    def __init__(self, log: Any) -> None:
        self._log, self.close = log, log.close

    def read(self) -> list[tuple[float, np.ndarray]]:
        return [(_BEFORE_ALL_S, currents) for _, currents in list(self._log.read())[-1:]]


class _Late:
    """Publisher of frames that are stamped late."""

    def __init__(self, publisher: Any, rng: np.random.Generator) -> None:
        self._publisher, self._rng = publisher, rng

    def publish(self, image: Any) -> None:
        stamp = image.header.stamp
        at_ns = stamp.sec * 10**9 + stamp.nanosec + round(1e9 * self._rng.exponential(LATE_S))
        stamp.sec, stamp.nanosec = divmod(at_ns, 10**9)
        self._publisher.publish(image)


def main() -> None:
    """Run it in place of the node."""
    virtual_rig.VirtualRigNode = SoftwareTimedRig  # type: ignore[misc]
    leave(run('virtual_rig', sys.argv[1:]))


if __name__ == '__main__':
    main()
