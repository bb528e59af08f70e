"""Cause and cure of a fault message, from the one catalogue."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import yaml

CATALOGUE = Path(__file__).with_name('faults.yaml')
"""Part of the rig → sentence, with … for inserted values → [cause, cure]."""
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
_BOUNDARY = re.compile(r'; |: |, ')
_PARAMETERS = re.compile(r' \(\w+_\w+(?:, \w+_\w+)*\)(?=$|:)')
"""Parameters of a limit, which the coil driver writes after the name of a fault."""


@dataclass(frozen=True)
class Remedy:
    """`cause` of a fault and its `cure`, one or two sentences each."""

    cause: str
    cure: str


@cache
def catalogue() -> dict[str, dict[str, tuple[str, str]]]:
    """Return the catalogue: part of the rig → sentence → (cause, cure).

    Returns
    -------
    dict[str, dict[str, tuple[str, str]]]
        Cause and cure by sentence, by part of the rig.
    """
    parts = yaml.load(CATALOGUE.read_text(encoding='utf-8'), Loader=_LOADER)
    return {part: {sentence: (cause, cure) for sentence, (cause, cure) in known.items()}
            for part, known in parts.items()}


@lru_cache(256)
def remedy(sentence: str) -> Remedy | None:
    """Return the remedy for a node's `sentence`, matched whole or in parts between separators.

    If several match, the longest is returned; None if the sentence is unknown.

    Parameters
    ----------
    sentence : str
        The sentence.

    Returns
    -------
    Remedy or None
        Cause and cure, or None.
    """
    parts = {part.rstrip('.') for text in {sentence, _PARAMETERS.sub('', sentence)}
             for part in _parts(text)}
    best, most = None, 0
    for length, pattern, found in _patterns():
        if length > most and any(pattern.fullmatch(part) for part in parts):
            best, most = found, length
    return best


def _parts(text: str) -> Iterator[str]:
    starts = [0, *(found.end() for found in _BOUNDARY.finditer(text))]
    ends = [*(found.start() for found in _BOUNDARY.finditer(text)), len(text)]
    yield from (text[start:end] for start in starts for end in ends if start < end)


@cache
def _patterns() -> list[tuple[int, re.Pattern[str], Remedy]]:
    """Return length, pattern and remedy of each sentence that does not refer to another."""
    return [(len(sentence.replace('…', '').strip()),
             re.compile(re.escape(sentence.rstrip('.')).replace('…', '.+?')), Remedy(*remedies))
            for known in catalogue().values() for sentence, remedies in known.items()
            if not remedies[1].startswith(('See there', 'See the sentence'))]
