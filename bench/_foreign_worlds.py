"""Sessions of simulators by other people, and of curves that laboratories measured."""

from __future__ import annotations

from bench._judge_cases import Case


def judging_cases(count: int, missing: list[str]) -> list[Case]:
    """Each foreign world `count` times; sentences on what is not installed go to `missing`."""
    return []
