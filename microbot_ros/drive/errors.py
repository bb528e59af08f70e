"""What can be wrong with an amplifier, by name. Each message is one line for a person."""

from __future__ import annotations


class AmplifierError(Exception):
    """Base of all: the coils are, or are to be taken as, without control."""


class PortMissingError(AmplifierError):
    """There is no such port `url`, or it cannot be opened, for a `reason`."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f'{url}: expected a serial port to open ({reason})')


class PortBusyError(AmplifierError):
    """Another program, perhaps a second driver, holds the port `url`."""

    def __init__(self, url: str) -> None:
        super().__init__(f'{url}: the port is in use by another program')


class PortLostError(AmplifierError):
    """The port `url` stopped working: unplugged, switched off, taking no bytes; see `reason`."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f'{url}: the port was lost ({reason})')


class NoAnswerError(AmplifierError):
    """The port `url` works and nothing, or nothing in time, came back of what was `expected`."""

    def __init__(self, url: str, expected: str) -> None:
        super().__init__(f'{url}: no answer; expected {expected}')


class WrongDeviceError(AmplifierError):
    """What answers at `url` is not the amplifier `expected`; what it said was `received`."""

    def __init__(self, url: str, expected: str, received: str) -> None:
        super().__init__(f'{url}: expected {expected}; received {received}')
