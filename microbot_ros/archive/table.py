"""`archive.parquet`: a row for every particle of every session."""

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
"""Each a column, with its standard deviation and its 95 % interval in three more."""

_PARTS = {'': 'value', '_std': 'std', '_low_95': 'low_95', '_high_95': 'high_95'}


def rows(archive: Archive, present: Mapping[str, list[str]]) -> Iterator[dict[str, Any]]:
    """A row for every particle of every session of an `archive`, by the name of the session.

    Of what `discover` said where it was asked, else of what `fit` said. `present`: {path of a
    recording: effects that the archive as a whole finds in it}.
    """
    fitted, discovered = archive.results('fit'), archive.results('discover')
    names = Counter(entry.name for entry in archive.entries.values())
    for path in sorted({*fitted, *discovered}, key=lambda one: archive.entries[one].name):
        task = 'discover' if 'result' in discovered.get(path, {}) else 'fit'
        result = discovered[path] if task == 'discover' else fitted.get(path, {})
        told = result.get('result') or result.get('fit')
        if not told:
            continue
        baseline = told.get('baseline', told)
        entry = archive.entries[path]
        session = _of_session(entry, path, task, result, told, present.get(path))
        # Folders of the same name may lie in two places.
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
    """Columns of the quantities that are told; what has no interval has that of ± 1.96 std."""
    columns: dict[str, float | None] = {}
    for name in set(QUANTITIES) & set(told):
        one = told[name]
        value, std = one['value'], one['std']
        if 'low_95' not in one and value is not None and std is not None:
            one = {**one, 'low_95': value - 1.96 * std, 'high_95': value + 1.96 * std}
        columns |= {name + part: one.get(key) for part, key in _PARTS.items()}
    return columns


def schema() -> pyarrow.Schema:
    """The columns and their types."""
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
    """Write `all_rows` as the table of an `archive`, whole or not at all; its path."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from microbot_ros.common.files import output_folder

    with output_folder(archive.folder) as folder:
        pq.write_table(pa.Table.from_pylist(all_rows, schema()), folder / TABLE)
    return archive.folder / TABLE


def write_rows(all_rows: list[dict[str, Any]], path: Path) -> None:
    """Write `all_rows`, which have the same columns, as Parquet at a `path`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_pylist(all_rows), path)


def read_table(archive: str | Path) -> pyarrow.Table:
    """The table of the `archive` in a folder; `.to_pandas()` makes a data frame of it.

    InputError where there is none.
    """
    import pyarrow.parquet as pq

    from microbot_ros.common.errors import InputError

    file = Path(archive) / TABLE
    if not file.is_file():
        raise InputError(archive, f'expected an archive: a folder with {TABLE}')
    return pq.read_table(file)
