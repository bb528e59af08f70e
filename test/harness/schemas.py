"""The published schemas of topics that carry JSON in a std_msgs/String."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

SCHEMAS = Path(__file__).parents[2] / 'docs' / 'reference' / 'schemas'


def schema_file(topic: str) -> Path:
    """The newest schema of a `topic` or service."""
    return sorted(SCHEMAS.glob(f'{topic.replace("/", "-")}.v*.json'))[-1]


def conforming(topic: str, text: str) -> Any:
    """The content of a `text` that was published on a `topic`; fails where it is not as the schema
    says."""
    checker = pytest.importorskip('fastjsonschema', reason='fastjsonschema is not installed')
    content = json.loads(text)
    checker.compile(json.loads(schema_file(topic).read_text(encoding='utf-8')))(content)
    return content
