"""Files of parameters, as a rig has them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml


def write_rig(file: Path, nodes: Mapping[str, Mapping[str, Any]]) -> Path:
    """Write the parameters of each node to a `file`; return the file."""
    file.write_text(yaml.safe_dump(
        {name: {'ros__parameters': dict(values)} for name, values in nodes.items()}))
    return file
