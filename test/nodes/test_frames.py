"""RViz and the tracker agree where a pixel lies."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from microbot_ros.nodes.base import frames
from microbot_ros.nodes.base.lifecycle import LATCHED
from microbot_ros.tracking import ImageToWorkspace

STAMP = Time(sec=1_700_000_000)


@given(st.floats(-np.pi, np.pi), st.booleans())
def test_a_pixel_lies_where_the_tracker_has_it(rotation: float, mirrored: bool) -> None:
    made = frames.camera_transform(rotation, mirrored, STAMP)
    turn = made.transform.rotation
    pixels = np.array([[0.0, 0.0], [100.0, 30.0], [639.0, 479.0]])
    optics = ImageToWorkspace(0.5e-6, 640, 480, rotation, mirrored)
    seen = 0.5e-6 * np.column_stack([pixels - [319.5, 239.5], np.zeros(3)])
    there = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply(seen)
    assert np.allclose(there[:, :2], optics.position(pixels), rtol=0, atol=1e-15)
    assert np.allclose(there[:, 2], 0.0, atol=1e-15)


@pytest.mark.parametrize(('mirrored', 'looks'), [(False, -1.0), (True, 1.0)])
def test_the_camera_looks_down_or_from_below_up(mirrored: bool, looks: float) -> None:
    turn = frames.camera_transform(0.7, mirrored, STAMP).transform.rotation
    axis = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([0.0, 0.0, 1.0])
    assert axis == pytest.approx([0.0, 0.0, looks])


def test_it_is_said_once_and_kept_for_those_who_come_late(monkeypatch: Any) -> None:
    """With a stand-in for tf2_msgs, which the wheels don't have."""
    class TFMessage:
        def __init__(self, transforms: list[TransformStamped]) -> None:
            self.transforms = transforms

    said: list[Any] = []
    node: Any = SimpleNamespace(
        publisher=lambda *how: (said.append(how), SimpleNamespace(publish=said.append))[1],
        get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: STAMP)))
    monkeypatch.setattr(frames, 'TFMessage', TFMessage)
    frames.publish_camera_transform(node, 0.0, False)
    assert said[0] == (TFMessage, '/tf_static', LATCHED)
    assert len(said) == 2
    (only,) = said[1].transforms
    assert (only.header.frame_id, only.child_frame_id) == ('workspace', 'camera')
