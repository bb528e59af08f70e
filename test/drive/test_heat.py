"""The heat of the coils over a restart of the driver."""

import errno
import json
import math
import os
import time

import pytest

from microbot_ros.drive import heat
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.heat import HeatRecord

LIMITS = Limits(
    current_A=3.0, step_A=6.0, slew_A_per_s=10.0, command_timeout_s=0.1, deviation_A=0.2,
    settling_s=0.1, feedback_timeout_s=0.2, rated_current_A=1.5, thermal_s=60.0, idle_s=10.0)
MOST = 1.0 - math.exp(-heat._UNSAVED_S / 60.0)
"""Of the way to the heat of the largest current that a coil goes in the time that is not saved."""


@pytest.fixture
def record(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_STATE_HOME', str(tmp_path))
    return HeatRecord('/dev/ttyACM0', LIMITS, 2)


def age(record, **changes):
    content = json.loads(record.path.read_text())
    record.path.write_text(json.dumps({**content, **changes}))


def test_what_was_never_driven_is_cold(record):
    assert record.load() == (0.0, 0.0)


def test_heat_outlives_a_restart_with_what_may_have_come_since_it_was_saved(record):
    record.save((0.5, 0.0))
    loaded = HeatRecord('/dev/ttyACM0', LIMITS, 2).load()
    assert loaded[0] == pytest.approx(0.5 + (4.0 - 0.5) * MOST, rel=1e-3)
    assert loaded[1] == pytest.approx(4.0 * MOST, rel=1e-3)
    assert HeatRecord('/dev/ttyACM1', LIMITS, 2).load() == (0.0, 0.0)


def test_it_cools_by_the_clock_of_the_boot_whatever_the_wall_says(record):
    record.save((1.0, 1.0))
    now_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    age(record, boot_s=now_s - 60.0 - heat._UNSAVED_S, wall_s=time.time() + 1e9)
    assert record.load()[0] == pytest.approx((1.0 + 3.0 * MOST) / math.e, rel=1e-3)


def test_after_a_boot_it_cools_by_the_wall(record):
    record.save((1.0, 1.0))
    age(record, boot_id='another', wall_s=time.time() - 60.0 - heat._UNSAVED_S)
    assert record.load()[0] == pytest.approx((1.0 + 3.0 * MOST) / math.e, rel=1e-3)


@pytest.mark.parametrize('changes', [
    {'heat': [math.nan, 0.0]}, {'heat': [math.inf, 0.0]}, {'heat': [-1.0, 0.0]}, {'heat': [0.5]},
    {'heat': 'hot'}, {'heat': None}, {'boot_id': 'another', 'wall_s': 1e12},
    {'boot_s': 1e12}, {'boot_s': math.nan}, {'boot_s': 'now'}])
def test_what_cannot_be_believed_is_as_hot_as_the_gate_allows(record, changes):
    record.save((0.5, 0.5))
    age(record, **changes)
    assert record.load() == (1.0, 1.0)


@pytest.mark.parametrize('content', ['', '{}', '[]', 'null', '{"heat": [0, 0]'])
def test_so_is_a_file_that_is_none(record, content):
    record.path.parent.mkdir(parents=True)
    record.path.write_text(content)
    assert record.load() == (1.0, 1.0)


@pytest.mark.parametrize('known', [True, False])
def test_so_is_one_that_could_not_be_written(record, monkeypatch, known):
    if known:
        record.save((0.0, 0.0))

    def full(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')
    record.path.parent.mkdir(parents=True, exist_ok=True)
    monkeypatch.setattr(heat.Path, 'write_text', full)
    with pytest.raises(OSError, match='No space'):
        record.save((0.9, 0.9))
    assert record.load() == (1.0, 1.0)


def test_it_is_kept_in_the_state_folder_of_the_user(tmp_path, monkeypatch):
    monkeypatch.delenv('XDG_STATE_HOME', raising=False)
    monkeypatch.setenv('HOME', str(tmp_path))
    path = HeatRecord('/dev/ttyACM0', LIMITS, 2).path
    assert path.parent == tmp_path / '.local/state/microbot_ros/heat'


def test_the_boot_is_named_in_the_file(record):
    record.save((0.5, 0.5))
    assert json.loads(record.path.read_text())['boot_id'] == heat._BOOT_ID.read_text().strip()


def test_files_of_long_ago_are_removed(record):
    record.save((0.5, 0.5))
    other = HeatRecord('/dev/ttyACM1', LIMITS, 2)
    other.save((0.5, 0.5))
    os.utime(record.path, (time.time() - 90_000.0,) * 2)
    other.forget_old()
    assert not record.path.exists()
    assert other.path.exists()
