"""Comparing recordings: fields, not bytes, and the first point where they part."""

import dataclasses

import numpy as np
import pytest
from recordings import VECTOR, encode, record, small_session, vector

from microbot_ros.common.records import Session
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.replay.compare import compare


def by_topic(a, b, topics=None, **options):
    with Recording(a) as left, Recording(b) as right:
        found = compare(left, right, topics, **options)
        return {difference.topic: difference for difference in found}


def shifted(session: Session, row: int, by: float) -> Session:
    position = session.tracks.position.copy()
    position[row, 1] += by
    return dataclasses.replace(
        session, tracks=dataclasses.replace(session.tracks, position=position))


def test_two_recordings_of_one_session_are_the_same_nan_and_all(tmp_path):
    session = small_session(rolling=True)
    found = by_topic(record(tmp_path / 'a', session), record(tmp_path / 'b', session))
    assert sorted(found) == ['/field/rotating', '/particles']
    for difference in found.values():
        assert difference.same
        assert difference.first is None
    assert found['/particles'].pairs == len(np.unique(session.tracks.t))


def test_the_first_point_where_they_part_is_named(tmp_path):
    session = small_session()
    row = 101
    other = shifted(shifted(session, row, 3e-6), row + 40, -9e-6)
    found = by_topic(record(tmp_path / 'a', session), record(tmp_path / 'b', other))
    assert found['/field/command'].same
    difference = found['/particles']
    assert (difference.unequal, difference.only_a, difference.only_b) == (2, 0, 0)
    assert difference.first.t_s == pytest.approx(session.tracks.t[row])
    frame = np.flatnonzero(session.tracks.t == session.tracks.t[row])
    assert difference.first.field == f'points.y[{row - frame[0]}]'
    assert float(difference.first.b) - float(difference.first.a) == pytest.approx(3e-6, rel=1e-5)
    assert difference.largest == {'points.y': pytest.approx(9e-6, rel=1e-5)}


def test_messages_without_a_partner_are_counted_and_the_rest_still_paired(tmp_path):
    for name, present in (('a', range(20)), ('b', [0, 1, 5, *range(7, 23)])):
        with RecordingWriter(tmp_path / name) as writer:
            for i in present:
                writer.write('/field/command', VECTOR, i * 1000, vector(i * 1000, i, 0))
    difference = by_topic(tmp_path / 'a', tmp_path / 'b')['/field/command']
    assert (difference.pairs, difference.only_a, difference.only_b) == (16, 4, 3)
    assert difference.unequal == 0
    assert not difference.same


def test_padding_and_times_of_receipt_do_not_count(tmp_path):
    # 4 bytes of encapsulation, 8 of stamp, 4 of length and 10 of 'workspace' leave two of
    # padding before the first double.
    for name, late, padding in (('a', 0, b'\x00\x00'), ('b', 777, b'\xff\xff')):
        data = bytearray(vector(5, 1, 2))
        data[26:28] = padding
        with RecordingWriter(tmp_path / name) as writer:
            writer.write('/field/command', VECTOR, 5 + late, bytes(data))
    assert by_topic(tmp_path / 'a', tmp_path / 'b')['/field/command'].same


def test_text_and_topics_that_one_side_lacks(tmp_path):
    kind = 'std_msgs/msg/String'
    for name, words in (('a', ['x', 'y']), ('b', ['x', 'z'])):
        with RecordingWriter(tmp_path / name) as writer:
            for i, word in enumerate(words):
                writer.write('/said', kind, i * 10**9, encode(kind, word))
            writer.write(f'/{name}', kind, 0, encode(kind, ''))
    found = by_topic(tmp_path / 'a', tmp_path / 'b')
    assert (found['/said'].first.t_s, found['/said'].first.field) == (1.0, 'data')
    assert (found['/said'].first.a, found['/said'].first.b) == ('y', 'z')
    assert (found['/a'].only_a, found['/a'].only_b) == (1, 0)
    assert (found['/b'].only_a, found['/b'].only_b) == (0, 1)
    assert list(by_topic(tmp_path / 'a', tmp_path / 'b', ['/said'])) == ['/said']


def test_only_messages_of_chosen_stamps_count(tmp_path):
    for name, values in (('a', [0, 1, 2]), ('b', [0, 7, 2, 9])):
        with RecordingWriter(tmp_path / name) as writer:
            for i, value in enumerate(values):
                writer.write('/field/command', VECTOR, i * 1000, vector(i * 1000, value, 0))
    found = by_topic(tmp_path / 'a', tmp_path / 'b', stamps={0, 2000})['/field/command']
    assert (found.pairs, found.same) == (2, True)
    found = by_topic(tmp_path / 'a', tmp_path / 'b', stamps={1000, 3000})['/field/command']
    assert (found.pairs, found.unequal, found.only_b) == (1, 1, 1)


def test_a_tolerance_is_a_share_of_the_largest_in_its_field(tmp_path):
    session = small_session()
    row = int(np.argmax(np.abs(session.tracks.position[:, 1])))
    largest = abs(session.tracks.position[row, 1])
    record(tmp_path / 'a', session)
    record(tmp_path / 'b', shifted(session, row, 1e-3 * largest))

    def same(tolerance):
        return by_topic(tmp_path / 'a', tmp_path / 'b', tolerance=tolerance)['/particles'].same
    assert not same(0.0)
    assert not same(0.9e-3)
    assert same(1.1e-3)


def test_no_tolerance_lets_nan_or_infinity_pass_for_a_number(tmp_path):
    for wrong in (np.nan, np.inf, -np.inf):
        for name, value in (('a', 1.0), ('b', wrong)):
            with RecordingWriter(tmp_path / f'{name}{wrong}') as writer:
                writer.write('/field/command', VECTOR, 0, vector(0, value, 0))
        a, b = tmp_path / f'a{wrong}', tmp_path / f'b{wrong}'
        assert not by_topic(a, b, tolerance=1.0)['/field/command'].same
        assert not by_topic(b, a, tolerance=1.0)['/field/command'].same
