"""Hostile bytes for every codec and every emulated device: nothing may raise, nothing bad pass.

What a codec accepts is checked by rebuilding the frame here, by other means than the codec's.
`python -m bench._fuzz SECONDS` runs longer.
"""

from __future__ import annotations

import logging
import math
import os
import random
import re
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from microbot_ros.drive.amplifiers.modbus import codec as modbus
from microbot_ros.drive.amplifiers.roboclaw import codec as roboclaw
from microbot_ros.drive.amplifiers.roboteq import codec as roboteq
from microbot_ros.drive.amplifiers.sabertooth import codec as sabertooth
from microbot_ros.drive.amplifiers.scpi import codec as scpi
from microbot_ros.drive.amplifiers.serial_transfer import codec as serial_transfer
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.device import Device
from microbot_ros.drive.emulator.process import DEVICES, make_device

FULL_SCALE_A = 2.0
_QUESTION = b'\x80\x31'


@dataclass
class Tally:
    """Cases tried, exceptions raised, bad frames accepted."""

    cases: int = 0
    raised: int = 0
    accepted: int = 0


def run(seconds: float) -> Tally:
    """Fuzz for that long, in equal parts each codec's decoder and each device."""
    logging.getLogger('pymodbus').setLevel(logging.CRITICAL + 1)
    tally, chance = Tally(), random.Random(os.environ.get('FUZZ_SEED', '1'))
    targets = [*_DECODERS, *(partial(_attack, protocol) for protocol in DEVICES)]
    for target in targets:
        end = time.monotonic() + seconds / len(targets)
        while time.monotonic() < end:
            for _ in range(200):
                tally.cases += 1
                try:
                    tally.accepted += target(chance)
                except Exception as error:
                    tally.raised += 1
                    print(f'{target}: {error!r}', file=sys.stderr)
    return tally


def _damaged(frame: bytes, chance: random.Random) -> bytes:
    """A frame with up to three of: a bit flipped, a byte lost, foreign bytes, a cut, a byte
    repeated, now and then more often than a number has digits.
    """
    data = bytearray(frame)
    for _ in range(chance.randrange(4)):
        place = chance.randrange(len(data) + 1)
        match chance.randrange(5):
            case 0 if place < len(data):
                data[place] ^= 1 << chance.randrange(8)
            case 1:
                del data[place:place + 1]
            case 2:
                data[place:place] = data[place:place + 1] * chance.choice((*[1] * 99, 5000))
            case 3:
                data[place:place] = chance.randbytes(chance.randrange(1, 9))
            case 4:
                del data[place:]
    return bytes(data)


def _polynomial(data: bytes, bits: int, generator: int) -> int:
    remainder = int.from_bytes(data, 'big') << bits
    while remainder.bit_length() > bits:
        remainder ^= generator << (remainder.bit_length() - bits - 1)
    return remainder


def _serial_transfer(chance: random.Random) -> int:
    """Frames in a row; what comes out must stand in the stream with a right CRC and stuffing."""
    payloads = [bytes(chance.choices(b'\x7e\x00\xff\x81\x3f\x18', k=24)) for _ in range(2)]
    stream = b''.join(_damaged(serial_transfer.encode(payload), chance) for payload in payloads)
    place, bad = 0, 0
    for payload in serial_transfer.Decoder(24).feed(stream, 0.0):
        marks = [i for i, byte in enumerate(payload) if byte == 0x7E]
        stuffed = bytearray(payload)
        for mark, following in zip(marks, [*marks[1:], None], strict=False):
            stuffed[mark] = 0 if following is None else following - mark
        crc = _polynomial(stuffed, 8, 0x19B)
        frame = bytes((0x7E, 0, marks[0] if marks else 0xFF, 24)) + stuffed + bytes((crc, 0x81))
        place = stream.find(frame, place)
        bad += place < 0
    return bad


def _roboclaw(chance: random.Random) -> int:
    data = struct.pack('>hh', chance.randrange(-32768, 32768), chance.randrange(-32768, 32768))
    received = _damaged(roboclaw.answer(_QUESTION, data), chance)
    if (currents := roboclaw.currents(_QUESTION, received)) is None:
        return 0
    accepted = struct.pack('>hh', *(round(current * 100) for current in currents))
    crc = _polynomial(_QUESTION + accepted, 16, 0x11021)
    return received != accepted + crc.to_bytes(2, 'big')


def _modbus(chance: random.Random) -> int:
    count = chance.choice((1, 4))
    answer = struct.pack('>BBB', 3, 3, 2 * count) + chance.randbytes(2 * count)
    received = _damaged(_with_crc(answer), chance)
    if (accepted := modbus.values(3, count, received)) is None:
        return 0
    return received != _with_crc(struct.pack(f'>BBB{count}h', 3, 3, 2 * count, *accepted))


def _with_crc(body: bytes) -> bytes:
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return body + crc.to_bytes(2, 'little')


def _roboteq_faults(chance: random.Random) -> int:
    received = _damaged(f'FF={chance.randrange(256)}\r'.encode(), chance)
    accepted = roboteq.faults(received)
    return accepted is not None and re.fullmatch(rb'FF=[0-9]+\r', received) is None


def _roboteq(chance: random.Random) -> int:
    text = f'A={chance.randrange(-999, 999)}:{chance.randrange(-999, 999)}\r'
    received = _damaged(text.encode(), chance)
    if (currents := roboteq.currents(received)) is None:
        return 0
    return re.fullmatch(rb'A=-?[0-9]+:-?[0-9]+\r', received) is None or not all(
        math.isfinite(current) for current in currents)


def _scpi(chance: random.Random) -> int:
    received = _damaged(f'{chance.uniform(-5, 5):.4E}\r\n'.encode(), chance)
    if (number := scpi.number(received)) is None:
        return 0
    line = re.fullmatch(rb'[\r\n]* *([+-]?[0-9]+\.?[0-9]*(E[+-]?[0-9]+)?) *[\r\n]+', received)
    return line is None or not math.isfinite(number) or number != float(line[1])


_DECODERS = (_serial_transfer, _roboclaw, _modbus, _roboteq, _roboteq_faults, _scpi)
_FRAMES: dict[str, Callable[[random.Random], bytes]] = {
    'serial_transfer': lambda chance: serial_transfer.encode(struct.pack(
        '<17f', *(chance.choice([0.0, 0.5, -1.0, 1e9, math.nan, math.inf]) for _ in range(17)))),
    'roboclaw': lambda chance: roboclaw.packet(
        chance.randrange(0x80, 0x83), chance.randrange(64), chance.randbytes(4)),
    'modbus': lambda chance: _with_crc(bytes((chance.randrange(6), chance.choice((3, 6, 16))))
                                       + struct.pack('>HH', chance.randrange(13),
                                                     chance.randrange(65536))),
    'sabertooth': lambda chance: sabertooth.packet(
        chance.randrange(0x80, 0x83), chance.randrange(16), chance.randrange(128)),
    'roboteq': lambda chance: (f'!G {chance.randrange(4)} {chance.randrange(-1100, 1100)}\r'
                               .encode()),
    'scpi': lambda chance: f'CURR {chance.uniform(-3, 3):.3E};OUTP ON\n'.encode(),
}
_devices: dict[str, Device] = {}


def _attack(protocol: str, chance: random.Random) -> int:
    """Damaged frames to a device; its coils must stay within their full scale."""
    if protocol not in _devices:
        log = open(os.devnull, 'w', encoding='utf-8')  # noqa: SIM115 — for the process's life
        _devices[protocol] = make_device(protocol, Coils(FULL_SCALE_A, None, log))
    device = _devices[protocol]
    received = _damaged(_FRAMES[protocol](chance), chance)
    device.receive(chance.randrange(device.ports), received, time.monotonic())
    return not all(abs(current) <= FULL_SCALE_A * 1.0001 for current in device.coils.currents_A)


if __name__ == '__main__':
    print(run(float(sys.argv[1])))
