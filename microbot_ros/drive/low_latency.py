"""How long a USB serial adapter holds bytes back, and asking it not to.

Adapters by FTDI hand bytes over when a packet is full or a timer ends, 16 ms after the first from
the factory: as long as a whole answer may take. In low-latency mode (the flag ASYNC_LOW_LATENCY of
`setserial`) the kernel sets that timer to 1 ms. Whoever may open a port may ask for it.
"""

from __future__ import annotations

import array
import fcntl
import termios
from contextlib import suppress
from pathlib import Path
from typing import Any

_ADAPTERS = Path('/sys/bus/usb-serial/devices')
_FLAGS, _LOW_LATENCY = 4, 1 << 13  # integers into `struct serial_struct`; linux/tty_flags.h


def request_low_latency(port: Any) -> bool:
    """Ask for low latency on an open pyserial `port`; whether the system says it is granted.

    Terminals that are no serial ports, and ports over a network, refuse, and stay as they are.
    """
    state = array.array('i', [0] * 32)
    with suppress(AttributeError, OSError, ValueError):
        port.set_low_latency_mode(True)
        # Some adapters take the flag and forget it: what counts is what the system says after.
        fcntl.ioctl(port.fileno(), termios.TIOCGSERIAL, state)
    return bool(state[_FLAGS] & _LOW_LATENCY)


def latency_timer_ms(device: str) -> int | None:
    """How long [ms] the adapter behind a `device` holds bytes back; None where it has no timer."""
    timer = _ADAPTERS / Path(device).resolve().name / 'latency_timer'
    try:
        return int(timer.read_text())
    except (OSError, ValueError):
        return None
