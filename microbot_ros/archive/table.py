"""`archive.parquet`: one row for every particle of every session."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from microbot_ros.archive.store import TABLE, Archive, Entry

if TYPE_CHECKING:
    import pyarrow

QUANTITIES = ('v_um_s', 'gain_um_s_hz', 'phi_rad', 'force_pN', 'diffusion_um2_s',
              'localisation_um')
"""Quantities, each a column, with three more for its standard deviation and its 95 % interval."""

_PARTS = {'': 'value', '_std': 'std', '_low_95': 'low_95', '_high_95': 'high_95'}
"""Suffix of the column of each part of a value; the interval is one of 95 % by definition."""


def rows(archive: Archive, present: Mapping[str, list[str]]) -> Iterator[dict[str, Any]]:
    """Yield one row for every particle of every session, in the order of session names.

    Values are those of `discover` if it was run, else those of `fit`.

    Parameters
    ----------
    archive : Archive
        The archive.
    present : mapping of str to list of str
        Effects that the archive as a whole finds in a recording, by its path.

    Yields
    ------
    dict of str to object
        Row by column.
    """
    fitted, discovered = archive.results('fit'), archive.results('discover')
    names = Counter(entry.name for entry in archive.entries.values())
    searched = [path for path, one in discovered.items() if 'result' in one]
    # A recording may be fitted in one place and its copy be searched in another.
    paths = {archive.entries[path].content: path for path in (*fitted, *searched)}
    for path in sorted(paths.values(), key=lambda one: archive.entries[one].name):
        task = 'discover' if 'result' in discovered.get(path, {}) else 'fit'
        result = discovered[path] if task == 'discover' else fitted.get(path, {})
        told = result.get('result') or result.get('fit')
        if not told:
            continue
        baseline = told.get('baseline', told)
        entry = archive.entries[path]
        session = _of_session(entry, path, task, result, told, present.get(path))
        # Two folders may have the same name.
        session['session'] = entry.name if names[entry.name] == 1 else path
        noise = _numbers(baseline)
        for particle, numbers in baseline['particles'].items():
            yield session | {'particle': particle} | _numbers(numbers) | noise


def _of_session(entry: Entry, path: str, task: str, result: dict[str, Any], told: dict[str, Any],
                present: list[str] | None) -> dict[str, Any]:
    facts = result['facts']
    return {
        'path': path, 'kind': entry.kind,
        'day': entry.day and datetime.date.fromisoformat(entry.day), 'rig': entry.rig,
        'batch': entry.batch, 'particle_kind': entry.particle_kind,
        'task': task, 'propulsion': facts['propulsion'],
        'duration_s': facts['duration_s'], 'frames': facts['frames'],
        'verdict': told.get('verdict'), 'present': present,
        'effects': [{
            'id': effect['id'], 'status': effect['status'], 'parameter': name, **estimate}
            for effect in told.get('effects', []) for name, estimate in
            effect['parameters'].items()],
        'remarks': [*told.get('remarks', told.get('warnings', []))],
        'content': entry.content}


def _numbers(told: dict[str, Any]) -> dict[str, float | None]:
    """Return the columns of quantities; one without interval has that of ± 1.96 std."""
    columns: dict[str, float | None] = {}
    for name in set(QUANTITIES) & set(told):
        one = told[name]
        value, std = one['value'], one['std']
        if 'low_95' not in one and value is not None and std is not None:
            one = {**one, 'low_95': value - 1.96 * std, 'high_95': value + 1.96 * std}
        columns |= {name + part: one.get(key) for part, key in _PARTS.items()}
    return columns


def schema() -> pyarrow.Schema:
    """Return the columns and their types.

    Returns
    -------
    pyarrow.Schema
        The schema.
    """
    import pyarrow as pa

    text, number = pa.string(), pa.float64()
    effect = pa.struct([('id', text), ('status', text), ('parameter', text),
                        *((part, number) for part in _PARTS.values())])
    return pa.schema([
        ('session', text), ('particle', text), ('day', pa.date32()), ('rig', text),
        ('batch', text), ('particle_kind', text), ('task', text), ('propulsion', text),
        ('duration_s', number), ('frames', pa.int64()),
        *((name + part, number) for name in QUANTITIES for part in _PARTS),
        ('verdict', text), ('present', pa.list_(text)), ('effects', pa.list_(effect)),
        ('remarks', pa.list_(text)), ('kind', text), ('path', text), ('content', text)])


def write_table(archive: Archive, all_rows: list[dict[str, Any]]) -> Path:
    """Write the table of an archive, whole or not at all.

    Parameters
    ----------
    archive : Archive
        The archive.
    all_rows : list of dict of str to object
        Its rows.

    Returns
    -------
    Path
        Path of the table.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from microbot_ros.common.files import output_folder

    with output_folder(archive.folder) as folder:
        pq.write_table(pa.Table.from_pylist(all_rows, schema()), folder / TABLE)
    return archive.folder / TABLE


def write_rows(all_rows: list[dict[str, Any]], path: Path) -> None:
    """Write rows as Parquet.

    Parameters
    ----------
    all_rows : list of dict of str to object
        Rows with the same columns.
    path : Path
        Path of the file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_pylist(all_rows), path)


def read_table(archive: str | Path) -> pyarrow.Table:
    """Return the table of an archive; `.to_pandas()` converts it to a data frame.

    Parameters
    ----------
    archive : str or Path
        Folder of the archive.

    Returns
    -------
    pyarrow.Table
        The table.

    Raises
    ------
    InputError
        If there is none.
    """
    import pyarrow.parquet as pq

    from microbot_ros.common.errors import InputError

    file = Path(archive) / TABLE
    if not file.is_file():
        raise InputError(archive, f'expected an archive: a folder with {TABLE}')
    return pq.read_table(file)
