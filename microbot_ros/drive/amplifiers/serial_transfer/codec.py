"""The SerialTransfer packet and the payloads that a coil board exchanges in it.

    7E · id · overhead · length · payload · CRC-8 · 81

Only 7E is stuffed: `overhead` is the index of the first 7E in the payload (FF: there is none), and
each 7E is replaced by the distance to the next, the last by 0. The CRC, polynomial 0x9B and
initial value 0, covers the stuffed payload and nothing else. Therefore the decoder also requires
the ids and the payload length of its direction and a consistent chain of stuffed bytes: each
packet that it accepts is byte for byte what `encode` would have sent.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Sequence

START, END = 0x7E, 0x81
"""First and last byte of a packet (SerialTransfer library)."""
PACKET_ID, TURN_ID = 0x00, 0x01
"""Ids of packets: 0 is the library's default, 1 is that of rotating duties in the reference
firmware."""
NOTHING_STUFFED = 0xFF
"""Overhead of a payload without 7E (SerialTransfer library)."""
MAX_PAYLOAD = 254
"""Longest payload [bytes] (SerialTransfer library)."""
STALL_S = 0.05
"""Pause [s] after which a packet is dropped, as in the microcontroller's library."""

_HEADER, _TRAILER = 4, 2
"""Bytes before and after the payload (SerialTransfer library)."""
_COMMAND = struct.Struct('<17f')
_TURN = struct.Struct('<18hf28x')  # as long as a command, by definition of the reference firmware
_WHOLE = 32767  # a duty of 1 among rotating ones: the largest int16
_MEASUREMENT = struct.Struct('<6f')
_FIRST_DUTY = 11  # by the firmware: after amplitude, B, angles, frequency, psi, gradient, 2 modes
COILS = 6
"""Number of coils that a board drives (firmware)."""


def _crc_table() -> bytes:
    table = bytearray()
    for byte in range(256):
        for _ in range(8):
            byte = (byte << 1) ^ 0x9B if byte & 0x80 else byte << 1
        table.append(byte & 0xFF)
    return bytes(table)


_CRC_TABLE = _crc_table()


def crc8(data: bytes) -> int:
    """Return the CRC-8 with polynomial 0x9B, initial value 0, not reflected.

    Parameters
    ----------
    data : bytes
        Bytes.

    Returns
    -------
    int
        The CRC.
    """
    crc = 0
    for byte in data:
        crc = _CRC_TABLE[crc ^ byte]
    return crc


def encode(payload: bytes, packet_id: int = PACKET_ID) -> bytes:
    """Return the packet that carries a payload.

    Parameters
    ----------
    payload : bytes
        1 to 254 bytes.
    packet_id : int
        Id of the packet.

    Returns
    -------
    bytes
        Bytes of the packet.

    Raises
    ------
    ValueError
        If the payload has any other length.
    """
    if not 1 <= len(payload) <= MAX_PAYLOAD:
        raise ValueError(f'payload must be 1 to {MAX_PAYLOAD} bytes; received {len(payload)}')
    stuffed = bytearray(payload)
    overhead, following = NOTHING_STUFFED, 0
    for index in range(len(payload) - 1, -1, -1):
        if payload[index] == START:
            stuffed[index] = following - index if following else 0
            overhead = following = index
    header = bytes((START, packet_id, overhead, len(payload)))
    return header + stuffed + bytes((crc8(bytes(stuffed)), END))


def _unstuff(stuffed: bytes, overhead: int) -> bytes | None:
    """Return the payload before stuffing; None if the chain leaves it or a bare 7E remains."""
    payload = bytearray(stuffed)
    index = overhead
    while index != NOTHING_STUFFED:
        if index >= len(payload):
            return None
        distance = payload[index]
        payload[index] = START
        index = index + distance if distance else NOTHING_STUFFED
    return bytes(payload)


class Decoder:
    """Decoder of bytes, as they arrive, into payloads; it never passes a bad payload.

    After damage it looks for the next start byte directly behind the last one it accepted, so a
    good packet is never lost with a bad one in front of it.

    Parameters
    ----------
    payload_length : int
        Length of a payload [bytes].
    ids : collection of int
        Ids of the packets that occur.
    """

    def __init__(self, payload_length: int, ids: Collection[int] = (PACKET_ID,)) -> None:
        self.crc_errors = 0
        """Number of packets with both end marks in place and a wrong CRC."""
        self.discarded_bytes = 0
        """Number of bytes that were part of no good packet: noise, another protocol, damage."""
        self._length = payload_length
        self._header = (
            {*ids}, {*range(payload_length), NOTHING_STUFFED}, {payload_length})
        self._pending = bytearray()
        self._last_byte_s = -math.inf

    def feed(self, data: bytes, now_s: float) -> list[bytes]:
        """Return the payloads that new bytes complete.

        Parameters
        ----------
        data : bytes
            Bytes that arrived at `now_s`.
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        list of bytes
            Payloads in order of arrival.
        """
        return [payload for _, payload in self.feed_packets(data, now_s)]

    def feed_packets(self, data: bytes, now_s: float) -> list[tuple[int, bytes]]:
        """Return the payloads that new bytes complete, with the ids of their packets.

        Parameters
        ----------
        data : bytes
            Bytes that arrived at `now_s`.
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        list of tuple[int, bytes]
            Id and payload of each packet in order of arrival.
        """
        payloads: list[tuple[int, bytes]] = []
        if self._pending and now_s - self._last_byte_s > STALL_S:
            self._discard(1)
            self._take(payloads)
            self._discard(len(self._pending))
        if data:
            self._pending += data
            self._last_byte_s = now_s
            self._take(payloads)
        return payloads

    def _take(self, payloads: list[tuple[int, bytes]]) -> None:
        """Move every complete payload out of the pending bytes; possible beginnings remain."""
        pending, size = self._pending, _HEADER + self._length + _TRAILER
        while (start := pending.find(START)) >= 0:
            self._discard(start)
            if not self._may_start_a_packet():
                self._discard(1)
            elif len(pending) < size:
                return
            elif (payload := self._payload(bytes(pending[:size]))) is None:
                self._discard(1)
            else:
                payloads.append((pending[1], payload))
                del pending[:size]
        self._discard(len(pending))

    def _discard(self, count: int) -> None:
        self.discarded_bytes += count
        del self._pending[:count]

    def _may_start_a_packet(self) -> bool:
        """Return whether the pending bytes agree with a header, as far as they go."""
        header = self._pending[1:_HEADER]
        return all(byte in allowed for byte, allowed in zip(header, self._header, strict=False))

    def _payload(self, packet: bytes) -> bytes | None:
        stuffed, crc, end = packet[_HEADER:-_TRAILER], packet[-2], packet[-1]
        if end == END and crc != crc8(stuffed):
            self.crc_errors += 1
        payload = _unstuff(stuffed, packet[2])
        return payload if payload is not None and encode(payload, packet[1]) == packet else None


COMMAND_BYTES = _COMMAND.size
MEASUREMENT_BYTES = _MEASUREMENT.size


def command(duties: Sequence[float]) -> bytes:
    """Return the payload that sets the duties of coils 1, 2, …; all other fields are zero.

    Parameters
    ----------
    duties : sequence of float
        Up to six duties from −1 to 1.

    Returns
    -------
    bytes
        The payload.

    Raises
    ------
    ValueError
        If a duty is not between −1 and 1, NaN included, or if there are too many.
    """
    if len(duties) > COILS or not all(-1.0 <= duty <= 1.0 for duty in duties):
        raise ValueError(f'duties must be up to {COILS} values in −1 … 1; received {duties}')
    rest = (0.0,) * (COILS - len(duties))
    return _COMMAND.pack(*(0.0,) * _FIRST_DUTY, *duties, *rest)


def duties(payload: bytes) -> tuple[float, ...] | None:
    """Return the six duties of a command's payload.

    Parameters
    ----------
    payload : bytes
        The payload.

    Returns
    -------
    tuple of float or None
        None if a duty is not between −1 and 1, such as NaN.
    """
    values = _COMMAND.unpack(payload)[_FIRST_DUTY:]
    return values if all(-1.0 <= value <= 1.0 for value in values) else None


def turn(parts: Sequence[Sequence[float]], rate: float) -> bytes:
    """Return the payload of duties that rotate: a + b cos t·`rate` + c sin t·`rate`.

    The time t [s] counts from the packet. Only boards with the reference firmware understand it.

    Parameters
    ----------
    parts : sequence of sequence of float
        A, b and c, each for coils 1, 2, … as in `command`.
    rate : float
        Angular velocity [rad/s].

    Returns
    -------
    bytes
        The payload.

    Raises
    ------
    ValueError
        If the duties leave −1 … 1 at any time, or if the rate is not finite.
    """
    if len(parts[0]) > COILS or not (_within(parts, 1.0) and math.isfinite(rate)):
        raise ValueError(f'duties must be up to {COILS} values that stay in −1 … 1, and a finite '
                         f'rate; received {parts} and {rate}')
    rest = (0,) * (COILS - len(parts[0]))
    return _TURN.pack(*(step for part in parts
                        for step in (*(round(_WHOLE * duty) for duty in part), *rest)), rate)


def _within(parts: Sequence[Sequence[float]], bound: float) -> bool:
    return all(abs(a) + math.hypot(b, c) <= bound for a, b, c in zip(*parts, strict=True))


def turning(payload: bytes) -> tuple[list[tuple[float, ...]], float] | None:
    """Return the rotating duties of a payload and their rate.

    Parameters
    ----------
    payload : bytes
        The payload.

    Returns
    -------
    tuple[list of tuple of float, float] or None
        Constant, cosine and sine part of the six duties, and the rate [rad/s]. None if they leave
        −1 … 1 at any time or the rate is not finite.
    """
    *steps, rate = _TURN.unpack(payload)
    parts = [tuple(step / _WHOLE for step in steps[k:k + COILS]) for k in range(0, 18, COILS)]
    rounded = 1.0 + 2 / _WHOLE
    return (parts, rate) if _within(parts, rounded) and math.isfinite(rate) else None


def measurement(currents_A: Sequence[float]) -> bytes:
    """Return the payload with which a board reports its currents.

    Parameters
    ----------
    currents_A : sequence of float, shape (6,)
        Current of each coil [A].

    Returns
    -------
    bytes
        The payload.
    """
    return _MEASUREMENT.pack(*currents_A)


def currents(payload: bytes) -> tuple[float, ...]:
    """Return the six currents of a measurement's payload.

    Parameters
    ----------
    payload : bytes
        The payload.

    Returns
    -------
    tuple of float, shape (6,)
        Currents [A] as they arrived, possibly not finite.
    """
    return _MEASUREMENT.unpack(payload)
