"""Errors of an amplifier, by name; each message is one line for a person."""

from __future__ import annotations


class AmplifierError(Exception):
    """Base of all errors: the coils are out of control, or must be treated as such."""


class UnreachableError(AmplifierError):
    """Error of a port that cannot be used, so that the device behind it is out of reach.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.
    message : str
        Text for people.
    """

    def __init__(self, url: str, message: str) -> None:
        super().__init__(message)
        self.url = url


class PortMissingError(UnreachableError):
    """Error of a port that does not exist or cannot be opened.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.
    reason : str
        Why, as the system reports it.
    """

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(url, f'{url}: expected a serial port to open ({reason})')


class PortBusyError(UnreachableError):
    """Error of a port that another program holds, perhaps a second driver.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.
    """

    def __init__(self, url: str) -> None:
        super().__init__(url, f'{url}: the port is in use by another program')


class PortLostError(UnreachableError):
    """Error of a port that stopped working: unplugged, switched off, or accepting no bytes.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.
    reason : str
        Why, as the system reports it.
    """

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(url, f'{url}: the port was lost ({reason})')


class NoAnswerError(AmplifierError):
    """Error of a working port on which no answer, or none in time, arrived.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.
    expected : str
        The answer that was expected.
    """

    def __init__(self, url: str, expected: str) -> None:
        super().__init__(f'{url}: no answer; expected {expected}')


class WrongDeviceError(UnreachableError):
    """Error of a port with another device than expected.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.
    expected : str
        The device that was expected.
    received : str
        The answer or the adapter that was found.
    """

    def __init__(self, url: str, expected: str, received: str) -> None:
        super().__init__(url, f'{url}: expected {expected}; received {received}')
