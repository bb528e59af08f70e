"""What is said of particles that jump: one sentence each, with how often and how far."""

from __future__ import annotations

import pytest

from microbot_ros.estimation.online.jumps import JumpNotes
from microbot_ros.nodes.base.lifecycle import in_one_line


def test_a_jump_is_told_by_its_length_and_more_are_counted():
    notes = JumpNotes(5.0)
    notes.add(1.0, 4, 12.34e-6)
    assert notes.sentences(1.0) == (
        'particle 4 jumped by 12.3 µm: is it still the same one?',)
    for k in range(13):
        notes.add(1.1 + 0.1 * k, 4, (5 + k * 10 / 12) * 1e-6)
        notes.add(1.1 + 0.1 * k, 2, 7e-6)
    assert notes.sentences(2.4) == (
        'particle 2 jumped 13 times, by 7 to 7 µm: is it still the same one?',
        'particle 4 jumped 14 times, by 5 to 15 µm: is it still the same one?')


def test_it_is_forgotten_when_the_particle_stays():
    notes = JumpNotes(5.0)
    notes.add(0.0, 1, 1e-5)
    notes.add(3.0, 2, 1e-5)
    assert [text[:10] for text in notes.sentences(4.9)] == ['particle 1', 'particle 2']
    assert [text[:10] for text in notes.sentences(5.0)] == ['particle 2']
    assert notes.sentences(9.0) == ()


@pytest.mark.parametrize('count', [0, 1, 2, 5, 50, 500])
@pytest.mark.parametrize('length', [1, 30, 90, 399, 400, 4000])
def test_a_status_is_one_line_and_says_what_is_left_out(count, length):
    told = in_one_line([f'{k:x}'.ljust(length, 'x') for k in range(count)])
    assert len(told) <= 400
    assert bool(told) == bool(count)
    if count > 1 and length > 190:
        assert told.endswith(f'; and {count - 1} more')
