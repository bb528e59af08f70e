"""The kit tries the camera, on a memory that a thread of this test keeps filling."""

import mmap
import threading
import time

import numpy as np
import pytest
from my_cameras.shared_memory import HEAD, SharedMemoryCamera

from microbot_ros.cameras.testkit import exercise


@pytest.fixture
def camera(tmp_path):
    """A path where a picture of 48×64 is renewed every 5 ms."""
    path, ended = tmp_path / 'frames', threading.Event()
    path.write_bytes(HEAD.pack(0, 48, 64, time.monotonic()) + bytes(48 * 64))

    def expose(memory):
        for number in range(1, 100_000):
            if ended.wait(0.005):
                return
            memory[HEAD.size:] = np.full(48 * 64, number % 256, np.uint8).tobytes()
            HEAD.pack_into(memory, 0, number, 48, 64, time.monotonic())

    with open(path, 'r+b') as file, mmap.mmap(file.fileno(), 0) as memory:
        thread = threading.Thread(target=expose, args=[memory])
        thread.start()
        yield str(path)
        ended.set()
        thread.join()


def test_it_keeps_the_contract(camera):
    exercise(SharedMemoryCamera, camera)
