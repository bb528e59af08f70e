"""The pages of the notebooks are what their scripts print today."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.soak

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / 'docs' / 'tutorial' / 'notebooks').glob('*.md'))


@pytest.mark.timeout(600)
def test_executed_anew_the_pages_are_the_same():
    before = {page: page.read_text(encoding='utf-8') for page in PAGES}
    try:
        subprocess.run([sys.executable, 'docs/build.py', '--notebooks'], cwd=ROOT, check=True)
        assert {page: page.read_text(encoding='utf-8') for page in PAGES} == before
    finally:
        for page, text in before.items():
            page.write_text(text, encoding='utf-8')
