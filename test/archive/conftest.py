"""A laboratory to go through."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from unittest import mock

import pytest
from laboratories import fill

from microbot_ros.archive import batch, work


@pytest.fixture
def laboratory(tmp_path: Path) -> Path:
    """A folder with six sessions."""
    return fill(tmp_path / 'laboratory', 6)


class Serial:
    """In place of Dask: does jobs one after the other, and counts them."""

    def __init__(self):
        self.done = []
        self.stop_after = None

    def run_jobs(self, _, jobs, report):
        for job in jobs:
            if self.stop_after is not None and len(self.done) == self.stop_after[0]:
                raise self.stop_after[1]
            work.do(job)
            self.done.append(job)
            report(job, '')


@pytest.fixture(name='serial')
def serial_fixture():
    """The jobs of a batch are done in this process."""
    serial = Serial()
    with mock.patch.object(batch, 'cluster', return_value=nullcontext()), \
            mock.patch.object(batch, 'introduced', return_value=''), \
            mock.patch.object(batch, 'run_jobs', serial.run_jobs):
        yield serial
