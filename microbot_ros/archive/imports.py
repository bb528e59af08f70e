"""Assumptions and scales of the imports of an archive."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

from microbot_ros.archive.store import Archive
from microbot_ros.archive.work import Job

_DOMINANT = 0.6
"""Share of a folder's recordings of one pixel size from which the others are called different.
Choice: a clear majority."""


def imported(archive: Archive) -> dict[str, Any]:
    """Return a summary of the imports, as in JSON.

    Parameters
    ----------
    archive : Archive
        The archive.

    Returns
    -------
    dict of str to object
        `sessions`: their number; `assumed`: [{sentence, recordings}], the most common first;
        `pixel_sizes`: {folder: {pixel size [µm]: recordings}}; `sentences` on folders with
        several.
    """
    # Two folders may have the same name.
    made = [(archive.entries[path].name, result)
            for path, result in archive.results('import').items() if 'session' in result]
    holders: dict[str, list[str]] = {}
    for name, result in made:
        for sentence in result['remarks']:
            holders.setdefault(sentence, []).append(name)
    sizes: dict[str, dict[float, list[str]]] = {}
    for name, result in made:
        if result.get('pixel_size_um'):
            of = sizes.setdefault(str(Path(name).parent), {})
            of.setdefault(result['pixel_size_um'], []).append(name)
    return {
        'sessions': len(made),
        'assumed': [{'sentence': sentence, 'recordings': of} for sentence, of in
                    sorted(holders.items(), key=lambda item: (-len(item[1]), item[0]))],
        'pixel_sizes': {folder: {f'{size:g}': of for size, of in sorted(found.items())}
                        for folder, found in sorted(sizes.items())},
        'sentences': [_several(folder, found) for folder, found in sorted(sizes.items())
                      if len(found) > 1],
    }


def _several(folder: str, sizes: dict[float, list[str]]) -> str:
    """Return a sentence on a folder whose recordings have several pixel sizes."""
    counts = ', '.join(f'{size:g} µm in {len(of)}' for size, of in sorted(sizes.items()))
    sentence = f'{folder} has pixels of several sizes: {counts}'
    common, most = max(sizes.items(), key=lambda item: len(item[1]))
    if len(most) < _DOMINANT * sum(map(len, sizes.values())):
        return f'{sentence}.'
    odd = [f'{Path(name).name} ({size:g} µm)' for size, of in sorted(sizes.items())
           if size != common for name in of]
    return f'{sentence}; different: {", ".join(odd)}.'


def siblings(archive: Archive, job: Job) -> str:
    """Return the scales of the recordings beside one whose import lacks a scale.

    Parameters
    ----------
    archive : Archive
        The archive.
    job : Job
        The refused job.

    Returns
    -------
    str
        '' if it was refused for another reason, or if no scale is known.
    """
    reason = (archive.result(job.key) or {}).get('refused', '')
    if not re.search(r'^[^:]*: expected --(position-unit|pixel-size-um)', reason):
        return ''
    sizes = Counter(
        result['pixel_size_um'] for path, result in archive.results('import').items()
        if Path(path).parent == job.path.parent and result.get('pixel_size_um'))
    if not sizes:
        return ''
    told = ', '.join(f'{size:g} µm in {count}' for size, count in sizes.most_common())
    return f'; other files in the folder have {told}: state pixel_size_um for it in archive.yaml'
