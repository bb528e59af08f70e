"""A laboratory to go through."""

from __future__ import annotations

from pathlib import Path

import pytest
from laboratories import fill


@pytest.fixture
def laboratory(tmp_path: Path) -> Path:
    """A folder with six sessions."""
    return fill(tmp_path / 'laboratory', 6)
