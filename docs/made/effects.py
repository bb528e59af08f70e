"""A table of the built-in effects, from their classes."""

from __future__ import annotations

import inspect

from made.text import MADE, code, table
from microbot_ros.model.effects import BUILT_IN

_HEAD = ('effect', 'term', 'parameters', 'visible under', 'looks like')


def page() -> str:
    """`effects.md`."""
    rows = [
        [code(kind.id), ' '.join((inspect.getdoc(kind) or '').split('\n\n')[0].split()),
         ', '.join(code(p.name) for p in kind.parameters()), kind.required_excitation,
         ', '.join(map(code, kind.confounded_with))]
        for kind in BUILT_IN]
    return (f'# Effects\n\n{MADE} What an effect is, and how to add one: '
            '[your own effect](../how-to/effect.md). p position, θ heading, B field, θ_B its '
            'direction, v speed.\n\n' + table(_HEAD, rows))
