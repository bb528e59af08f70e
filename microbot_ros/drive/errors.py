"""What can be wrong with an amplifier, by name. Each message is one line for a person."""

from __future__ import annotations


class AmplifierError(Exception):
    """Base of all: the coils are, or are to be taken as, without control."""


class UnreachableError(AmplifierError):
    """The port `url` cannot be used, and what is behind it is out of reach, as `message` says."""

    def __init__(self, url: str, message: str) -> None:
        super().__init__(message)
        self.url = url


class PortMissingError(UnreachableError):
    """There is no such port `url`, or it cannot be opened, for a `reason`."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(url, f'{url}: expected a serial port to open ({reason})')


class PortBusyError(UnreachableError):
    """Another program, perhaps a second driver, holds the port `url`."""

    def __init__(self, url: str) -> None:
        super().__init__(url, f'{url}: the port is in use by another program')


class PortLostError(UnreachableError):
    """The port `url` stopped working: unplugged, switched off, taking no bytes; see `reason`."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(url, f'{url}: the port was lost ({reason})')


class NoAnswerError(AmplifierError):
    """The port `url` works and nothing, or nothing in time, came back of what was `expected`."""

    def __init__(self, url: str, expected: str) -> None:
        super().__init__(f'{url}: no answer; expected {expected}')


class WrongDeviceError(UnreachableError):
    """At `url` is not the device `expected`, but what answered or was found: `received`."""

    def __init__(self, url: str, expected: str, received: str) -> None:
        super().__init__(url, f'{url}: expected {expected}; received {received}')
