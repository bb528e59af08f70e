"""Tables that hold a laboratory's results instead of a recording."""

from __future__ import annotations

import re
from collections.abc import Sequence

from microbot_ros.common.errors import InputError, counted
from microbot_ros.session.spreadsheets.columns import Column
from microbot_ros.session.spreadsheets.sheets import Sheet


class SummaryError(InputError):
    """A table holds averages and no recording."""


_MOST_ROWS = 500  # choice: a longer table is a recording
_AVERAGE = re.compile(r'\b(avg|average|mean|median|std|stdev|sd|sem|error|ci)\b', re.IGNORECASE)


def summary_of(parts: Sequence[tuple[Sheet, list[Column]]]) -> str:
    """Return a sentence on the averages in the sheets; '' if there are none.

    `parts` are the sheets with their known columns. A summary has neither times nor positions, but
    a column of commands, such as a frequency, and columns of results. The commands do not repeat,
    unless the results are named averages and a column names the robots.

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
        roles = {column.role for column in columns}
        against = next((c for c in columns if c.role in ('frequency', 'bx', 'direction')), None)
        if against is None or roles & {'x', 'y', 'time', 'frame'} or len(sheet.rows) > _MOST_ROWS:
            continue
        averages = [name for name in sheet.names if _AVERAGE.search(name)]
        results = averages or [name for k, name in enumerate(sheet.names)
                               if name and k not in {c.index for c in columns
                                                     if c.role not in ('speed', 'vx', 'vy')}]
        levels = sheet.witness(against.index)
        once = len(set(levels.tolist())) == len(levels)
        if results and (once or (averages and 'particle' in roles)):
            return (f"a summary of {counted(len(results), 'column')} of averages against "
                    f"'{sheet.names[against.index]}' and no recording; microbot response "
                    '--definition tables computes such a table from recordings')
    return ''
