"""The log of commands: what is asked of it is there, what is past is gone."""

import numpy as np

from microbot_ros.estimation.online.commands import CommandLog

FIELD = np.array([0.0, 5e-3])


def log_of(*rows):
    log = CommandLog()
    for t, field in rows:
        assert not log.append(t, field)
    return log


def test_a_time_is_ruled_by_the_command_before_it():
    log = log_of((0.0, FIELD), (1.0, -FIELD), (2.0, FIELD))
    assert log.since(1.5).t.tolist() == [1.0, 2.0]
    assert log.since(1.5, delay=0.25).t.tolist() == [1.25, 2.25]
    assert log.since(-1.0).t.tolist() == [0.0, 1.0, 2.0]
    assert len(CommandLog().since(1.0).t) == 0


def test_the_last_field_rules_the_heading_while_there_is_none():
    log = log_of((0.0, -FIELD), (1.0, FIELD), (2.0, 0 * FIELD), (3.0, 0 * FIELD))
    assert log.since(3.5).t.tolist() == [1.0, 3.0]
    assert log.since(2.5).t.tolist() == [1.0, 2.0, 3.0]
    assert log_of((0.0, 0 * FIELD), (1.0, 0 * FIELD)).since(1.5).t.tolist() == [1.0]


def test_an_hour_without_a_field_is_forgotten_but_for_the_last_one():
    log = log_of((0.0, FIELD))
    for tick in range(36_000):
        log.append(1.0 + 0.1 * tick, 0 * FIELD)
        log.forget_before(0.1 * tick - 60)
    kept = log.since(-np.inf)
    assert len(kept.t) < 1200
    np.testing.assert_array_equal(kept.field[0], FIELD)
