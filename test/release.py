"""What a release still lacks: `python test/release.py [VERSION]`.

Reads the criteria of `docs/explanation/version_1.md`, evaluates those that a program can evaluate,
and names the command or the person that decides the others. Exit status 1 if one of them fails.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import lowest

ROOT = Path(__file__).parents[1]
CRITERIA = ROOT / 'docs' / 'explanation' / 'version_1.md'
Finding = tuple[bool | None, str]
"""Whether it holds, None where a program cannot tell; and what was found, or who decides."""


def git(*words: str) -> str:
    """Return what git prints."""
    return subprocess.run(['git', *words], cwd=ROOT, capture_output=True, text=True).stdout


def criteria() -> list[str]:
    """Return the criteria of 1.0.0, the first column of their table."""
    rows = re.findall(r'^\| (.+?) \|', CRITERIA.read_text(encoding='utf-8'), re.MULTILINE)
    return [row for row in rows if row != 'criterion' and not row.startswith('-')]


def versions(wanted: str) -> Finding:
    """Whether manifest, setup and package have the version `wanted`."""
    found = {
        str(ElementTree.parse(ROOT / 'package.xml').findtext('version')),
        *re.findall(r"version='([^']+)'", (ROOT / 'setup.py').read_text()),
        *re.findall(r"__version__ = '([^']+)'", (ROOT / 'microbot_ros/__init__.py').read_text())}
    return found == {wanted}, f'package.xml, setup.py, __init__.py: {", ".join(sorted(found))}'


def changelog(wanted: str) -> Finding:
    """Whether the changelog has a section of the version `wanted`."""
    heads = re.findall(r'^(Forthcoming|\d+\.\d+\.\d+.*)\n-+$',
                       (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8'), re.MULTILINE)
    return heads[0].startswith(wanted), f'CHANGELOG.rst begins with {heads[0]}'


def repository(wanted: str) -> Finding:
    """Whether all is committed and the tag of the version `wanted` is free."""
    changed, tags = git('status', '--porcelain').splitlines(), git('tag').split()
    return not changed and wanted not in tags, (
        f'{len(changed)} files not committed; tag {wanted} is '
        f'{"taken" if wanted in tags else "free"}')


def wrong_names(_: str) -> Finding:
    """Whether `make bench ONLY=judge` counted no wrong name among 300 clean sessions."""
    file = ROOT / 'out' / 'bench.json'
    if not file.is_file():
        return None, 'make bench ONLY=judge CASES=300 decides; it has not run here'
    figures = [one for one in json.loads(file.read_text())
               if one['name'].startswith('nothing missing, clean')]
    return (all(one['ok'] for one in figures) if figures else None,
            '; '.join(f'{one["name"]}: {one["value"]}' for one in figures)
            or 'make bench ONLY=judge CASES=300 decides; out/bench.json is of other groups')


def oldest_libraries(_: str) -> Finding:
    """Whether `make lowest` passed on the present commit."""
    file = ROOT / 'out' / 'lowest' / lowest.RESULT
    if not file.is_file():
        return None, 'make lowest decides; it has not run here'
    found = json.loads(file.read_text())
    if not found['commit'] or found['commit'] != lowest.commit():
        return None, 'make lowest decides; it ran on other sources'
    return found['status'] == 0, f'make lowest ended with {found["status"]} on this commit'


def names(_: str) -> Finding:
    """Whether the reference still has every name of the last release."""
    tags = git('tag', '--sort=-creatordate').split()
    if not tags:
        return None, 'no release yet: decided from the second one on'
    lost = {f'{page.name}: {name}' for page in sorted((ROOT / 'docs/reference').glob('*.md'))
            for name in (_first_column(git('show', f'{tags[0]}:docs/reference/{page.name}'))
                         - _first_column(page.read_text(encoding='utf-8')))}
    return not lost, f'missing since {tags[0]}: {", ".join(sorted(lost)) or "none"}'


def _first_column(page: str) -> set[str]:
    return set(re.findall(r'^\| `([^`]+)`', page, re.MULTILINE))


def documents(_: str) -> Finding:
    """Whether the tests of the documents pass."""
    done = subprocess.run([sys.executable, '-m', 'pytest', '-q', 'test/test_documents.py'],
                          cwd=ROOT, capture_output=True, text=True)
    return done.returncode == 0, 'test/test_documents.py'


def decided_by(who: str) -> Callable[[str], Finding]:
    """Return a check that a program cannot make: `who` makes it."""
    return lambda _: (None, who)


CHECKS: dict[str, Callable[[str], Finding]] = {
    'A person who': decided_by('a person: docs/tutorial/first_hour.md, watched by a maintainer'),
    'A group that': decided_by('a person: a report of another group with its recordings'),
    'Currents end': decided_by('a person: docs/explanation/safety_evidence.md on each amplifier'),
    '`colcon build`': decided_by('the job ros of .github/workflows/checks.yml'),
    'Names and files': names,
    'No wrong name': wrong_names,
    'The oldest': oldest_libraries,
    'Documents': documents}
"""Beginning of a criterion → what evaluates it."""


def main(wanted: str) -> int:
    """Print a line for each criterion of a release `wanted`; return the exit status."""
    checks = {'Versions agree': versions, 'The changelog has the version': changelog,
              'All is committed': repository}
    checks |= {row: CHECKS[begin] for row in criteria() for begin in CHECKS
               if row.startswith(begin)}
    failed = 0
    for row, check in checks.items():
        holds, found = check(wanted)
        failed += holds is False
        mark = {True: 'holds', False: 'FAILS', None: 'open '}[holds]
        print(f'{mark}  {row}\n       {found}')
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:2] or ['1.0.0']))
