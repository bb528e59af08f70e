"""Content of a column by its name: 'Pos X', 'x_1 [px]', 'Times', 'Rolling Frequency'."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from microbot_ros.common.errors import InputError
from microbot_ros.session.spreadsheets.sheets import Sheet

# Role → possible names, in lower case with single blanks.
_NAMES = {
    'time': ('t', 'time', 'times', 'timestamp', 'elapsed', 'elapsed time', 'dt', 'interval',
             'position t'),
    'frame': ('frame', 'frames', 'frame number', 'frame no', 'slice', 'image'),
    'particle': ('particle', 'particle id', 'id', 'track', 'track id', 'trackid', 'robot',
                 'robot id', 'trajectory', 'blob id', 'blobid'),
    'x': ('x', 'pos x', 'x pos', 'position x', 'x position', 'posx', 'centroid x', 'cx',
          'centre x', 'center x', 'x coordinate', 'x coord'),
    'y': ('y', 'pos y', 'y pos', 'position y', 'y position', 'posy', 'centroid y', 'cy',
          'centre y', 'center y', 'y coordinate', 'y coord'),
    'theta': ('theta', 'heading', 'heading angle', 'orientation', 'yaw'),
    'direction': ('direction', 'alpha', 'field angle', 'field direction', 'rolling direction'),
    'frequency': ('frequency', 'freq', 'rolling frequency', 'rotation frequency',
                  'rolling freq', 'field frequency'),
    'bx': ('bx', 'b x', 'field x'),
    'by': ('by', 'b y', 'field y'),
    'speed': ('vel mag', 'velocity magnitude', 'velocity', 'speed', 'vel', 'vmag'),
    'vx': ('vel x', 'velocity x', 'x velocity', 'vx'),
    'vy': ('vel y', 'velocity y', 'y velocity', 'vy'),
    'tilt': ('gamma', 'tilt', 'axis tilt', 'tilt angle'),
    'cone': ('psi', 'cone angle'),
    'gradient': ('gradient', 'gradient?'),
    'sound': ('acoustic frequency', 'acoustic freq'),
}
ROLES = tuple(_NAMES)
_ROLE_OF = {name: role for role, names in _NAMES.items() for name in names}
_SINGLE = ('time', 'frame', 'particle', 'direction', 'frequency', 'bx', 'by', 'tilt', 'cone',
           'gradient', 'sound')
_WITNESSES = ('speed', 'vx', 'vy', 'tilt', 'cone', 'gradient', 'sound')
"""Roles that only check or complete other columns: of several the first is used."""

# Spelling of a unit → its suffix in `units`.
_UNITS = {
    'px': '_px', 'pixel': '_px', 'pixels': '_px', 'um': '_um', 'µm': '_um', 'μm': '_um',
    'micron': '_um', 'microns': '_um', 'mm': '_mm', 'm': '_m', 's': '_s', 'sec': '_s',
    'seconds': '_s', 'ms': '_ms', 'deg': '_deg', 'degrees': '_deg', '°': '_deg', 'rad': '_rad',
    'radians': '_rad', 'hz': '_hz', 'mt': '_mT', 't': '_T', 'g': '_G', 'gauss': '_G',
    'um/s': '_um_s', 'µm/s': '_um_s', 'μm/s': '_um_s', 'mm/s': '_mm_s', 'px/s': '_px_s',
}
_BRACKETED = re.compile(r'[\[(]\s*([^\])]+?)\s*[\])]')
_NUMBERED = re.compile(r'^(?:(?:robot|particle|track|r|p)?\s*(\d+)\s+(\D+?)|(\D+?)\s*(\d+))$')
_WHOSE = re.compile(r'\b(?:robot|particle|track)\b\s*')


@dataclass(frozen=True)
class Column:
    """Content of column number `index` of a sheet.

    `role` is one of `ROLES`; `unit` a suffix such as '_px', '' if the name has none; `particle`
    the number in its name, or None.
    """

    index: int
    role: str
    unit: str = ''
    particle: int | None = None


def find_columns(sheet: Sheet, named: dict[str, str]) -> list[Column]:
    """Return the columns of a `sheet` with a known role; `named` (role → name) takes precedence.

    Raises InputError if two columns claim one role.

    Parameters
    ----------
    sheet : Sheet
        The sheet.
    named : dict of str to str
        Name by role.

    Returns
    -------
    list of Column
        The columns.
    """
    columns = []
    for index, name in enumerate(sheet.names):
        told = next((role for role, chosen in named.items() if chosen == name), None)
        column = Column(index, told, _split_unit(name)[1]) if told else _recognise(index, name)
        if column and (told or column.role not in named):
            columns.append(column)
    roles = {column.role for column in columns}
    if 'frequency' in roles and not roles & {'x', 'y', 'direction'}:  # a sheet of commands
        columns = [replace(c, role='direction') if c.role == 'theta' else c for c in columns]
    # Next to the identity of a track, a bare 'ID' is a row number.
    identities = [column for column in columns if column.role == 'particle']
    if len(identities) > 1:
        columns = [c for c in columns if c not in identities or _split_unit(
            sheet.names[c.index])[0] != 'id']
    seen: dict[tuple[str, int | None], Column] = {}
    for column in columns:
        key = column.role, None if column.role in _SINGLE else column.particle
        if key in seen and column.role in _WITNESSES:
            continue
        if key in seen:
            first, second = sheet.names[seen[key].index], sheet.names[column.index]
            raise InputError(sheet.place, f"expected one column for {column.role}, found '{first}'"
                                          f" and '{second}'; choose by --column "
                                          f"{column.role}='{first}'")
        seen[key] = column
    return list(seen.values())


def _recognise(index: int, name: str) -> Column | None:
    plain, unit = _split_unit(name)
    if plain in _ROLE_OF:
        return Column(index, _ROLE_OF[plain], unit)
    bare = _WHOSE.sub('', plain).strip()
    if _ROLE_OF.get(bare) in ('x', 'y', 'theta'):  # 'Robot X'
        return Column(index, _ROLE_OF[bare], unit)
    match = _NUMBERED.match(bare) or _NUMBERED.match(plain)
    if match:
        word, number = match[2] or match[3], match[1] or match[4]
        role = _ROLE_OF.get(word.strip())
        if role and role not in _SINGLE:
            return Column(index, role, unit, int(number))
    return None


def _split_unit(name: str) -> tuple[str, str]:
    """Return a name in lower case with single blanks, and its unit as a suffix."""
    bracketed = _BRACKETED.search(name)
    if bracketed and bracketed[1].lower() in _UNITS:
        return _plain(_BRACKETED.sub(' ', name)), _UNITS[bracketed[1].lower()]
    words = _plain(_BRACKETED.sub(r' \1 ', name)).split(' ')
    # A last word can be a unit ('time ms', 'x px') unless the whole is a name ('b x', 'field t').
    if len(words) > 2 and '/'.join(words[-2:]) in _UNITS:  # 'speed um s'
        return ' '.join(words[:-2]), _UNITS['/'.join(words[-2:])]
    if len(words) > 1 and words[-1] in _UNITS and ' '.join(words) not in _ROLE_OF:
        return ' '.join(words[:-1]), _UNITS[words[-1]]
    return ' '.join(words), ''


def _plain(name: str) -> str:
    whole = re.sub(r'(?<![A-Za-z])mT\b', 'mt', name)  # a unit, not two words
    spaced = re.sub(r'(?<=[a-z])(?=[A-Z])', ' ', whole)
    return re.sub(r'[\s_.\-]+', ' ', spaced).strip().lower()
