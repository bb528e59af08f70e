"""Aravis for Python comes from the system's packages, where an environment of pip's has none."""

from __future__ import annotations

import importlib.util
import sys
import sysconfig
from pathlib import Path

_SYSTEM = Path('/usr/lib/python3/dist-packages/gi')


def has_aravis() -> bool:
    """Whether Aravis can be used; `gi` is taken from the system's Python if it is the same."""
    compiled = _SYSTEM / f'_gi{sysconfig.get_config_var("EXT_SUFFIX")}'
    if importlib.util.find_spec('gi') is None and compiled.exists():
        spec = importlib.util.spec_from_file_location(
            'gi', _SYSTEM / '__init__.py', submodule_search_locations=[str(_SYSTEM)])
        assert spec is not None
        assert spec.loader is not None
        sys.modules['gi'] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules['gi'])
    try:
        import gi

        gi.require_version('Aravis', '0.8')
    except (ImportError, ValueError):
        return False
    return True
