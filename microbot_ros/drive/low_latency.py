"""Latency timers of USB serial adapters, and the request for low latency.

Adapters by FTDI hand over bytes when a packet is full or a timer ends, by default 16 ms after the
first byte: as long as a whole answer may take. In low-latency mode (the flag ASYNC_LOW_LATENCY of
`setserial`) the kernel sets that timer to 1 ms. Any user who may open a port may request it.
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
    """Request low latency on an open pyserial port.

    Terminals that are no serial ports, and ports over a network, refuse and stay unchanged.

    Parameters
    ----------
    port : object
        Open pyserial port.

    Returns
    -------
    bool
        Whether the system reports that it is granted.
    """
    state = array.array('i', [0] * 32)
    with suppress(AttributeError, OSError, ValueError):
        port.set_low_latency_mode(True)
        # Some adapters accept the flag and drop it, so read it back.
        fcntl.ioctl(port.fileno(), termios.TIOCGSERIAL, state)
    return bool(state[_FLAGS] & _LOW_LATENCY)


def latency_timer_ms(device: str) -> int | None:
    """Return the time that the adapter behind a device holds bytes back.

    Parameters
    ----------
    device : str
        Device name.

    Returns
    -------
    int or None
        Time [ms]; None if it has no timer.
    """
    timer = _ADAPTERS / Path(device).resolve().name / 'latency_timer'
    try:
        return int(timer.read_text())
    except (OSError, ValueError):
        return None
