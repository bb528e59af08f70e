"""Files that commands write."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from microbot_ros.common.files import write_json


def test_what_is_not_finite_is_null_in_json_at_any_depth(tmp_path: Path) -> None:
    content = {'v': float('nan'), 'all': [1.5, (np.float64('inf'), {'µ': -float('inf')})],
               'count': 3, 'said': 'NaN', 'known': True, 'none': None}
    write_json(tmp_path / 'new' / 'a.json', content)
    text = (tmp_path / 'new' / 'a.json').read_text(encoding='utf-8')
    assert json.loads(text) == {
        'v': None, 'all': [1.5, [None, {'µ': None}]], 'count': 3, 'said': 'NaN', 'known': True,
        'none': None}
    assert 'µ' in text
    assert text.endswith('}\n')


def test_without_a_file_nothing_is_written(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_json(None, {'a': 1})
    assert not list(tmp_path.iterdir())
