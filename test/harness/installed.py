"""A package of the documentation, found by its entry points as one that was installed."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path


def install(project: Path, package: str, folder: Path) -> Path:
    """The `folder` with a `package` of the `project` in it, as an installer leaves it."""
    about = tomllib.loads((project / 'pyproject.toml').read_text())['project']
    shutil.copytree(project / package, folder / package)
    info = folder / f'{about["name"]}-{about["version"]}.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text(
        f'Metadata-Version: 2.1\nName: {about["name"]}\nVersion: {about["version"]}\n')
    (info / 'entry_points.txt').write_text('\n'.join(
        line for group, points in about['entry-points'].items()
        for line in (f'[{group}]', *(f'{name} = {place}' for name, place in points.items()))))
    return folder
