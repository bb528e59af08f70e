"""SerialTransfer packets: golden bytes, damage of every kind, and the two payloads."""

import itertools
import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.drive.amplifiers.serial_transfer import codec

GOLDEN = {
    bytes(68): bytes.fromhex('7e00ff44') + bytes(68) + bytes.fromhex('0081'),
    bytes.fromhex('017e027e03'): bytes.fromhex('7e00010501020200 03ea81'),
}
PAYLOAD = struct.pack('<17f', *range(11), 0.5, -0.25, 1.0, -1.0, 0.0, 0.0)
PACKET = codec.encode(PAYLOAD)


def decode(stream: bytes, length: int = 68, chunk: int = 7) -> tuple[list[bytes], codec.Decoder]:
    decoder = codec.Decoder(length)
    payloads = [payload for i in range(0, len(stream), chunk)
                for payload in decoder.feed(stream[i:i + chunk], 0.0)]
    return payloads, decoder


def long_division(data: bytes) -> int:
    """The remainder of data · x⁸ by x⁸ + x⁷ + x⁴ + x³ + x + 1, as polynomials."""
    remainder = int.from_bytes(data, 'big') << 8
    while remainder.bit_length() > 8:
        remainder ^= 0x19B << (remainder.bit_length() - 9)
    return remainder


@pytest.mark.parametrize(('payload', 'packet'), GOLDEN.items())
def test_golden_bytes_both_ways(payload, packet):
    assert codec.encode(payload) == packet
    payloads, decoder = decode(packet, len(payload))
    assert payloads == [payload]
    assert (decoder.crc_errors, decoder.discarded_bytes) == (0, 0)


@given(st.binary(min_size=1, max_size=254))
@settings(max_examples=50, deadline=None)
def test_crc_is_the_remainder_of_a_long_division(data):
    assert codec.crc8(data) == long_division(data)


@given(st.lists(st.sampled_from([0x7E, 0x7E, 0x81, 0x00, 0xFF, 0x44]), min_size=1, max_size=254),
       st.integers(1, 300))
@settings(max_examples=100, deadline=None)
def test_any_payload_comes_back_in_any_chunks(values, chunk):
    payload = bytes(values)
    assert decode(codec.encode(payload) * 2, len(payload), chunk)[0] == [payload] * 2


@pytest.mark.parametrize('length', [0, 255])
def test_a_payload_of_impossible_length_is_refused(length):
    with pytest.raises(ValueError, match='1 to 254'):
        codec.encode(bytes(length))


@pytest.mark.parametrize('junk', [
    b'', b'\x7e', b'\x7e\x00', b'\x7e\x00\xff', b'\x7e\x00\xff\x44', b'\x81', b'hello\r\n',
    PACKET[:-1], PACKET[1:], PACKET[:40], b'\x7e' * 100, b'\x7e\x00\xff\x18' + bytes(24),
])
def test_no_good_packet_is_lost_behind_junk(junk):
    payloads, _ = decode(PACKET + junk + PACKET + junk + PACKET)
    assert payloads == [PAYLOAD] * 3


def test_no_flipped_bit_passes():
    for index, bit in itertools.product(range(len(PACKET)), range(8)):
        damaged = bytearray(PACKET)
        damaged[index] ^= 1 << bit
        payloads, decoder = decode(bytes(damaged) + PACKET, chunk=200)
        assert payloads == [PAYLOAD]
        assert decoder.discarded_bytes == len(PACKET)


def test_no_two_flipped_bits_of_a_stuffed_payload_pass():
    # Over 24 bytes the polynomial detects every pair: the property that the link budget rests on.
    packet = codec.encode(bytes(range(0x60, 0x78)))
    for first, second in itertools.combinations(range(0, 24 * 8, 5), 2):
        damaged = bytearray(packet)
        for bit in (first, second):
            damaged[4 + bit // 8] ^= 1 << bit % 8
        assert decode(bytes(damaged), 24, 99)[0] == []


def test_only_a_wrong_crc_between_right_ends_counts_as_one():
    assert decode(PACKET[:-2] + bytes((PACKET[-2] ^ 1, PACKET[-1])))[1].crc_errors == 1
    assert decode(PACKET[:-1] + b'\x80')[1].crc_errors == 0


def test_a_stuffing_chain_that_leaves_the_payload_is_refused():
    stuffed = bytearray(24)
    stuffed[3] = 30
    frame = b'\x7e\x00\x03\x18' + stuffed + bytes((codec.crc8(bytes(stuffed)), 0x81))
    payloads, decoder = decode(frame, 24)
    assert (payloads, decoder.crc_errors, decoder.discarded_bytes) == ([], 0, len(frame))


def test_a_bare_start_byte_in_a_payload_is_refused():
    stuffed = bytes.fromhex('017e020003')
    frame = b'\x7e\x00\x03\x05' + stuffed + bytes((codec.crc8(stuffed), 0x81))
    assert decode(frame, 5)[0] == []


@pytest.mark.parametrize(('pause', 'passes'), [
    (0.0, True), (math.nextafter(0.05, 0), True), (0.05, True), (math.nextafter(0.05, 1), False),
    (10.0, False),
])
def test_a_packet_that_stalls_is_dropped(pause, passes):
    decoder = codec.Decoder(68)
    assert decoder.feed(PACKET[:30], 0.0) == []
    assert decoder.feed(PACKET[30:], pause) == ([PAYLOAD] if passes else [])
    assert decoder.feed(PACKET, pause) == [PAYLOAD]


def test_a_good_packet_behind_a_stalled_false_start_survives():
    decoder = codec.Decoder(68)
    assert decoder.feed(b'\x7e\x00\xff\x44' + PACKET[:-10], 0.0) == []
    assert decoder.feed(PACKET[-10:], 0.01) == [PAYLOAD]
    assert decoder.feed(b'\x7e\x00\xff\x44', 0.01) == []
    assert decoder.feed(PACKET, 1.0) == [PAYLOAD]


@given(st.lists(st.one_of(st.just(PACKET), st.binary(max_size=90),
                          st.just(PACKET).flatmap(lambda p: st.builds(
                              lambda i, b: p[:i] + bytes((b,)) + p[i + 1:],
                              st.integers(0, len(p) - 1), st.integers(0, 255)))), max_size=6),
       st.integers(1, 99))
@settings(max_examples=150, deadline=None)
def test_what_passes_stood_in_the_stream_byte_for_byte(parts, chunk):
    stream = b''.join(parts)
    payloads, decoder = decode(stream, chunk=chunk)
    place = 0
    for payload in payloads:
        place = stream.index(codec.encode(payload), place) + 74
    assert 0 <= len(stream) - 74 * len(payloads) - decoder.discarded_bytes < 74


def test_a_command_holds_duties_from_the_twelfth_float_on():
    values = struct.unpack('<17f', codec.command([0.5, -0.25, 1.0, -1.0]))
    assert values == (0.0,) * 11 + (0.5, -0.25, 1.0, -1.0, 0.0, 0.0)
    assert codec.duties(codec.command([0.5, -1.0])) == (0.5, -1.0, 0.0, 0.0, 0.0, 0.0)


OUTSIDE = [math.nan, math.inf, -math.inf, math.nextafter(1.0, 2), -1.5, 1e300]


@pytest.mark.parametrize('duty', OUTSIDE)
@pytest.mark.parametrize('coil', range(4))
def test_a_duty_outside_is_refused_by_either_end(duty, coil):
    duties = [0.0] * 4
    duties[coil] = duty
    with pytest.raises(ValueError, match='−1 … 1'):
        codec.command(duties)
    single = max(min(duty, 3e38), -3e38) if math.isfinite(duty) else duty
    if not math.isfinite(duty) or abs(struct.unpack('<f', struct.pack('<f', single))[0]) > 1:
        raw = [0.0] * 17
        raw[11 + coil] = single
        assert codec.duties(struct.pack('<17f', *raw)) is None


def test_a_command_for_more_coils_than_there_are_is_refused():
    with pytest.raises(ValueError, match='up to 6'):
        codec.command([0.0] * 7)


def test_measured_currents_are_six_little_endian_floats():
    assert codec.measurement([1.0, 0, 0, 0, 0, -2.0])[:4] == bytes.fromhex('0000803f')
    assert codec.currents(codec.measurement([1.0, 0, 0, 0, 0, -2.0])) == (1.0, 0, 0, 0, 0, -2.0)
