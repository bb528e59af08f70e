"""Tables that hold a laboratory's results instead of a recording."""

from __future__ import annotations

import re
from collections.abc import Sequence

from microbot_ros.common.errors import InputError
from microbot_ros.session.spreadsheets.columns import Column
from microbot_ros.session.spreadsheets.sheets import Sheet


class SummaryError(InputError):
    """A table holds averages and no recording."""


_MOST_ROWS = 500  # choice: a longer table is a recording
_AVERAGE = re.compile(r'\b(avg|average|mean|median|std|stdev|sd|sem|error|ci)\b', re.IGNORECASE)


def summary_of(parts: Sequence[tuple[Sheet, list[Column]]]) -> str:
    """Return a sentence on the averages in the sheets; '' if there are none.

    `parts` are the sheets with their known columns. A summary has a column of commands, such as a
    frequency, whose values do not repeat, and columns of averages.

    Parameters
    ----------
    parts : sequence of tuple[Sheet, list of Column]
        The sheets with their columns.

    Returns
    -------
    str
        The sentence, or ''.
    """
    for sheet, columns in parts:
        against = next((c for c in columns if c.role in ('frequency', 'bx', 'direction')), None)
        averages = [name for name in sheet.names if _AVERAGE.search(name)]
        if against is None or not averages or len(sheet.rows) > _MOST_ROWS:
            continue
        levels = sheet.witness(against.index)
        if len(set(levels.tolist())) == len(levels):
            return (f"a summary of {len(averages)} columns of averages against "
                    f"'{sheet.names[against.index]}' and no recording; microbot response "
                    '--definition tables computes such a table from recordings')
    return ''
