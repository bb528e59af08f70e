"""Every frame once, every lost one counted, none of another size."""

import dataclasses
import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.cameras.camera import (
    CameraDriver,
    CameraFormat,
    CameraFrame,
    CameraSettings,
    Clock,
)
from microbot_ros.cameras.stream import FrameStream
from microbot_ros.common.errors import InputError

FORM = CameraFormat(4, 6, 'mono8', 'Mono8', Clock.NONE)
PICTURE = np.zeros((4, 6), np.uint8)


class Scripted(CameraDriver):
    """Gives the frames of a list, then None."""

    def __init__(self, *frames, form=FORM, wraps_after=0, dropped=0):
        self.said = []
        super().__init__(CameraSettings('scripted'), self.said.append)
        self.left, self.form = list(frames), form
        self.wraps_after, self.now_dropped = wraps_after, dropped

    def open(self):
        return self.form

    def read(self, timeout):
        return self.left.pop(0) if self.left else None

    @property
    def dropped(self):
        return self.now_dropped

    def close(self):
        pass


def frame(number, image=PICTURE, exposed=math.nan):
    return CameraFrame(number, image, time.monotonic(), exposed)


def numbers(*given, **how):
    camera = Scripted(*(frame(number) for number in given), **how)
    stream = FrameStream(camera)
    kept = [found[0].number for found in (stream.read(0.0) for _ in given) if found]
    return kept, stream, camera


@given(st.sets(st.integers(0, 300), min_size=1))
def test_what_lies_between_two_frames_and_never_came_is_lost(came):
    kept, stream, _ = numbers(*sorted(came))
    assert kept == sorted(came)
    assert stream.lost == len(set(range(min(came), max(came))) - came)


@given(st.integers(1, 65535), st.lists(st.integers(1, 300), max_size=30))
def test_numbers_that_begin_anew_lose_none(first, steps):
    """As GigE Vision counts: 1 to 65535, and 1 again."""
    true = np.cumsum([first, *steps])
    kept, stream, camera = numbers(*((true - 1) % 65535 + 1).tolist(), wraps_after=65535)
    assert len(kept) == len(true)
    assert stream.lost == sum(steps) - len(steps)
    assert camera.said == []


def test_a_repeat_is_not_passed_on():
    kept, stream, _ = numbers(1, 2, 2, 2, 3)
    assert kept == [1, 2, 3]
    assert (stream.lost, stream.repeated) == (0, 2)


def test_a_repeat_under_a_new_number_is_one_by_its_stamp():
    form = CameraFormat(4, 6, 'mono8', 'Mono8', Clock.DEVICE)
    camera = Scripted(frame(1, exposed=5.0), frame(2, exposed=5.0), frame(3, exposed=5.1),
                      frame(4), frame(5), form=form)
    stream = FrameStream(camera)
    kept = [bool(stream.read(0.0)) for _ in range(5)]
    assert kept == [True, False, True, True, True], 'no stamp is no stamp that repeats'
    assert (stream.lost, stream.repeated) == (0, 1)


def test_the_same_picture_for_ever_is_a_repeat_whatever_number_and_stamp_it_has():
    noise = np.random.default_rng(0).integers(90, 110, (3, 4, 6)).astype(np.uint8)
    form = dataclasses.replace(FORM, clock=Clock.DEVICE)
    pictures = [noise[0], noise[1], noise[1], noise[1].copy(), noise[2]]
    stream = FrameStream(Scripted(*(
        frame(k, picture, k / 100) for k, picture in enumerate(pictures, 1)), form=form))
    kept = [found[0].number for found in (stream.read(0.0) for _ in pictures) if found]
    assert (kept, stream.repeated, stream.lost) == ([1, 2, 5], 2, 0)


def test_a_lens_cap_is_no_repeat():
    form = dataclasses.replace(FORM, clock=Clock.DEVICE)
    stream = FrameStream(Scripted(*(frame(k, exposed=k / 100) for k in (1, 2)), form=form))
    assert all(stream.read(0.0) for _ in range(2))


def test_a_counter_that_is_set_back_is_said():
    kept, stream, camera = numbers(100, 101, 0, 1)
    assert kept == [100, 101, 0, 1]
    assert stream.lost == 0
    assert camera.said == ['scripted: frame numbers went back from 101 to 0; frames lost in '
                           'between are not counted']


def test_what_the_computer_dropped_is_lost_once():
    assert numbers(1, 2, 9, dropped=2)[1].lost == 6, 'seen by its numbers'
    assert numbers(1, 2, 3, dropped=2)[1].lost == 2, 'not seen by them'


@pytest.mark.parametrize('other', [
    np.zeros((6, 4), np.uint8), np.zeros((4, 6), np.uint16), np.zeros((4, 6, 3), np.uint8),
    np.zeros((5, 6), np.uint8), np.zeros(24, np.uint8)])
def test_another_size_ends_it_with_a_sentence(other):
    stream = FrameStream(Scripted(frame(1), frame(2, other)))
    assert stream.read(0.0)
    with pytest.raises(InputError, match=r'^scripted: frame 2 is [\d×]+ \w+, expected 6×4 mono8$'):
        stream.read(0.0)


def test_silence_is_a_lost_camera_unless_it_may_be_silent():
    impatient = CameraFormat(4, 6, 'mono8', 'Mono8', Clock.NONE, patience=0.0)
    with pytest.raises(InputError, match='scripted: no frame for'):
        FrameStream(Scripted(form=impatient)).read(0.0)
    triggered = CameraFormat(4, 6, 'mono8', 'Mono8', Clock.NONE, patience=math.inf)
    assert FrameStream(Scripted(form=triggered)).read(0.0) is None


def test_without_a_clock_the_moment_is_the_arrival_less_the_exposure():
    form = CameraFormat(4, 6, 'mono8', 'Mono8', Clock.NONE, least_delay=0.25)
    only = frame(1)
    found = FrameStream(Scripted(only, form=form)).read(0.0)
    assert found is not None
    assert found[1] == only.arrived - 0.25
