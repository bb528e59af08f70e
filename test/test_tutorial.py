"""Whoever follows the first hour, command by command, in a folder of their own, gets there."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.rig

PAGE = Path(__file__).parents[1] / 'docs' / 'tutorial' / 'first_hour.md'
BLOCKS = re.compile(r'(?:Save this as `([\w.]+)`:\n\n)?^```(\w+)\n(.*?)^```',
                    re.MULTILINE | re.DOTALL)


def _sentences(text):
    """As words, whatever the width of the terminal, with all numbers alike."""
    return re.sub(r'[-−]?\d+(\.\d+)?', '#', ' '.join(text.split()))


@pytest.mark.timeout(600)
def test_the_first_hour(tmp_path):
    """Blocks of `sh` are typed, those with a name are saved; blocks of `text` are what is read."""
    path = f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}'
    said, shown = '', []
    for name, language, text in BLOCKS.findall(PAGE.read_text(encoding='utf-8')):
        if name:
            (tmp_path / name).write_text(text, encoding='utf-8')
        elif language == 'sh':
            typed = subprocess.run(
                ['bash', '-euo', 'pipefail', '-c', text],
                cwd=tmp_path, env={**os.environ, 'PATH': path},
                capture_output=True, text=True, timeout=300)
            assert typed.returncode == 0, text + typed.stderr
            said += typed.stdout
        elif not re.match(r'git |microbot ', text):
            shown.append(text)
    assert len(shown) == 3
    assert [text for text in shown if _sentences(text) not in _sentences(said)] == []

    found = json.loads((tmp_path / 'found' / 'result.json').read_text())
    assert found['verdict'] == 'named'
    [drift] = found['effects']
    assert drift['id'] == 'uniform_drift'
    for parameter, hidden in (('wx_um_s', 0.6), ('wy_um_s', -0.4)):
        value = drift['parameters'][parameter]
        assert value['low_95'] <= hidden <= value['high_95'], parameter
    nothing = json.loads((tmp_path / 'nothing_found' / 'result.json').read_text())
    assert (nothing['verdict'], nothing['effects']) == ('consistent', [])


def test_its_pictures_are_there():
    pictures = re.findall(r'!\[[^]]+\]\(([^)]+)\)', PAGE.read_text(encoding='utf-8'))
    assert len(pictures) >= 3
    assert [one for one in pictures if not (PAGE.parent / one).is_file()] == []
