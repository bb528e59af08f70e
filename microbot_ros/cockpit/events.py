"""Events at the rig since the server began: requests of pages, and reports of nodes."""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from microbot_ros.cockpit.faults import remedy

KEPT = 1000
"""Events that are kept. Choice: a day of an operator's work; 1000 of them are 0.2 MB."""
_LEVELS = {'error': 'error', 'stale': 'error', 'warn': 'warning'}
_RIG = {'armed': 'note', 'disarmed': 'note', 'fault': 'error', 'unknown': 'warning'}


def explained(sentence: str) -> dict[str, str]:
    """Return cause and cure of a sentence of a node, if the catalogue contains it.

    Parameters
    ----------
    sentence : str
        The sentence.

    Returns
    -------
    dict of str to str
        `cause` and `cure`, or empty.
    """
    found = remedy(sentence)
    return {'cause': found.cause, 'cure': found.cure} if found else {}


class Events:
    """The last `KEPT` events: number, time [s since 1970], origin, level and sentence of each."""

    def __init__(self) -> None:
        self.kept: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._count = itertools.count(1)
        self._rig: tuple[Any, Any] = (None, None)
        self._levels: dict[str, str] = {}
        self._seen: dict[str, Any] = {}

    def add(self, origin: str, level: str, text: str) -> None:
        """Add an event.

        Parameters
        ----------
        origin : str
            Its origin.
        level : str
            One of ok, refused, note, warning, error.
        text : str
            Its sentence.
        """
        help_ = explained(text) if level in ('refused', 'warning', 'error') else {}
        self.kept.append({'number': next(self._count), 'time_s': time.time(), 'origin': origin,
                          'level': level, 'text': text, **help_})

    def since(self, number: int) -> list[dict[str, Any]]:
        """Return the events after a number.

        Parameters
        ----------
        number : int
            Number of an event.

        Returns
        -------
        list of dict of str to object
            Events, oldest first.
        """
        new = itertools.takewhile(lambda one: one['number'] > number, reversed(self.kept))
        return list(new)[::-1]

    def see(self, state: Mapping[str, Any]) -> None:
        """Add the events that a state of the rig shows.

        Parameters
        ----------
        state : mapping of str to object
            The state.
        """
        self._see_rig(state.get('rig'), state.get('sentence') or '')
        for node in state.get('health') or []:
            self._see_node(node['name'], node['level'], node['sentence'])
        controller, recording = state.get('controller') or {}, state.get('recording') or {}
        self._see_change('controller', (controller.get('name') or '').replace('_', ' ') or None,
                         'controller', '{} drives')
        self._see_change('recorder', recording.get('on'), 'recorder', {
            True: 'Recording began', False: 'Recording ended'})
        discovery = state.get('discovery') or {}
        self._see_change('discovery', discovery.get('sentence'), 'discovery', '{}')

    def _see_rig(self, rig: Any, sentence: str) -> None:
        # The driver reports the reason after disarming: a new sentence of a fault is a change too.
        now = (rig, sentence if rig == 'fault' else None)
        if now != self._rig:
            known, self._rig = self._rig[0] is not None, now
            if known or rig == 'fault':
                text = {'armed': 'Armed', 'disarmed': 'Disarmed'}.get(str(rig), sentence)
                self.add('coil_driver', _RIG.get(str(rig), 'note'), text)

    def _see_node(self, name: str, level: str, sentence: str) -> None:
        before = self._levels.get(name, 'ok')
        self._levels[name] = level
        if (name == 'coil_driver' and level == 'error') or before == level:
            return  # faults of the driver are those of the rig
        if level in _LEVELS:
            self.add(name, _LEVELS[level], sentence)
        elif before in _LEVELS:
            self.add(name, 'ok', f'Well again: {sentence}')

    def _see_change(self, key: str, value: Any, origin: str, words: Any) -> None:
        if value is None or self._seen.get(key) == value:
            return
        known = key in self._seen or key == 'discovery'
        self._seen[key] = value
        if known:
            self.add(origin, 'note', words.format(value) if isinstance(words, str)
                     else words[value])
