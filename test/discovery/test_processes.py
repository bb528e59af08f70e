"""What is found in several processes is what is found in one, and little of it is sent."""

from __future__ import annotations

import os
import pickle
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import pytest

from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.processes import in_processes, serially


@dataclass(frozen=True)
class Found:
    """Something with a thing of its caller's, and something that follows from it."""

    recording: np.ndarray
    number: int

    @cached_property
    def large(self) -> np.ndarray:
        return np.arange(1_000_000) * self.number


def test_what_is_kept_is_the_callers_own_and_what_follows_is_left_behind():
    recording = np.ones(5)

    def find(number):
        found = Found(recording, number)
        assert found.large.size
        return os.getpid(), found, found.recording.copy()

    pids, found, copies = zip(*in_processes(find, [1, 2, 3], [recording], jobs=2), strict=True)
    assert os.getpid() not in pids
    assert [one.number for one in found] == [1, 2, 3]
    assert all(one.recording is recording for one in found)
    assert all(copy is not recording and (copy == recording).all() for copy in copies)
    assert not any('large' in vars(one) for one in found)


def test_items_and_functions_that_no_pickle_takes_are_inherited():
    inside = lambda number: number + 1  # noqa: E731
    with pytest.raises((pickle.PicklingError, AttributeError)):
        pickle.dumps(inside)
    calls = [partial(inside, k) for k in range(4)]
    assert list(in_processes(lambda call: call(), calls, jobs=2)) == [1, 2, 3, 4]


def test_one_item_is_not_worth_a_process():
    assert list(in_processes(lambda _: os.getpid(), [0], jobs=2)) == [os.getpid()]


def test_an_error_reaches_the_caller_and_the_next_call_works():
    def fails(number):
        if number:
            raise ValueError(f'{number} is too much')
        return number

    for run in (serially, partial(in_processes, jobs=2)):
        with pytest.raises(ValueError, match='1 is too much'):
            list(run(fails, [0, 1]))
    assert list(in_processes(fails, [0, 0], jobs=2)) == [0, 0]


@pytest.mark.rig
def test_two_processes_find_what_one_finds(film):
    session, _ = film(5, {'uniform_drift': {'wx_um_s': 0.6, 'wy_um_s': 0.3}}, duration=20.0)
    alone, together = (discover([session], jobs=jobs) for jobs in (1, 2))
    # Sums are made in another order where nothing was remembered.
    assert [e.id for e in alone.effects] == [e.id for e in together.effects] == ['uniform_drift']
    assert together.effects[0].delta_bic == pytest.approx(alone.effects[0].delta_bic, abs=1e-3)
    assert together.effects[0].log_evidence == pytest.approx(
        alone.effects[0].log_evidence, abs=1e-2)
    assert together.gap.after == pytest.approx(alone.gap.after, rel=1e-4)
    ratios = [{c.id: c.likelihood_ratio for c in found.considered} for found in (alone, together)]
    assert ratios[0] == pytest.approx(ratios[1], abs=0.05)
