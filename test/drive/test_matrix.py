"""The fault matrix, some cells of it: `make bench ONLY=drive` prints all."""

import math

import pytest

from bench import _matrix


@pytest.mark.parametrize(('changes', 'until_s', 'away', 'longest_s'), [
    ([(0.0, (0.0, 0.0))], 9.0, set(), 0.0),
    ([(0.0, (1.0, 0.0)), (0.1, (0.0, 0.0))], 9.0, set(), 0.1),
    ([(0.0, (1.0, 0.0)), (0.1, (0.0, -1.0)), (0.3, (0.0, 0.0))], 9.0, set(), 0.3),
    ([(0.0, (1.0, 0.0)), (0.1, (0.0, -1.0)), (0.3, (0.0, 0.0))], 9.0, {0}, 0.2),
    ([(0.0, (0.0, 0.0)), (0.1, (0.0, 1.0))], 9.0, set(), 8.9),
    ([(0.0, (math.nan, 0.0))], 9.0, set(), 9.0),
    ([(0.0, (math.inf, 0.0))], 9.0, set(), 9.0),
])
def test_the_longest_current_is_found(changes, until_s, away, longest_s):
    assert _matrix.longest_s(changes, until_s, away) == pytest.approx(longest_s)


def test_a_cell_holds_only_in_time_and_with_true_answers():
    assert not _matrix.Cell().ok
    assert _matrix.Cell([0.0, 0.2]).ok
    assert not _matrix.Cell([0.0, 0.201]).ok
    assert not _matrix.Cell([math.nan]).ok
    assert not _matrix.Cell([0.0], wrong=['confirmed']).ok
