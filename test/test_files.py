"""Files that commands write."""

from __future__ import annotations

import errno
import json
import os
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from microbot_ros.common.files import output_folder, write_json


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


def test_results_reach_a_folder_on_another_disk_and_leave_nothing_else_there(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk, link = tmp_path / 'disk', tmp_path / 'out'
    disk.mkdir()
    link.symlink_to(disk)
    replace = os.replace

    def replace_on_one_disk(source: Path, target: Path) -> None:
        if len({disk in Path(one).resolve().parents for one in (source, target)}) > 1:
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
        replace(source, target)

    monkeypatch.setattr(os, 'replace', replace_on_one_disk)
    with output_folder(link) as folder:
        (folder / 'a.csv').write_text('1')
    with suppress(KeyboardInterrupt), output_folder(link) as folder:
        (folder / 'b.csv').write_text('2')
        raise KeyboardInterrupt
    assert {path.name: path.read_text() for path in disk.iterdir()} == {'a.csv': '1'}
    assert {path.name for path in tmp_path.iterdir()} == {'disk', 'out'}


def test_a_folder_to_write_to_in_one_that_is_closed(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Root may write everywhere, so that the parent is closed by hand."""
    make = tempfile.mkdtemp

    def make_below(dir: Path, prefix: str) -> str:  # noqa: A002
        if dir == tmp_path:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return make(dir=dir, prefix=prefix)

    (tmp_path / 'own').mkdir()
    monkeypatch.setattr(tempfile, 'mkdtemp', make_below)
    with output_folder(tmp_path / 'own') as folder:
        (folder / 'a.csv').write_text('1')
    assert [path.name for path in (tmp_path / 'own').iterdir()] == ['a.csv']
