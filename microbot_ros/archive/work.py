"""Work on one recording, by any process on any machine: a job and its result.

A job is named by its content, its settings and its version; its result is a file of that name,
which exists whole or not at all. A worker that receives the job twice finds it done.
"""

from __future__ import annotations

import errno
import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from microbot_ros import __version__
from microbot_ros.archive.recordings import MARK, Kind
from microbot_ros.common.errors import InputError, ReportError
from microbot_ros.common.files import output_folder, write_text, writing_report
from microbot_ros.session.spreadsheets.summary import SummaryError

if TYPE_CHECKING:
    from microbot_ros.common.records import Session
    from microbot_ros.discovery.result import Discovery

Task = Literal['track', 'fit', 'discover', 'import', 'measure']

READS: dict[Task, tuple[Kind, ...]] = {
    'track': ('film',), 'import': ('table',),
    'fit': ('session', 'recording', 'table'), 'discover': ('session', 'recording', 'table'),
    'measure': ('session', 'recording', 'table'),
}
"""Kinds of recordings that a task processes."""

SESSIONS = 'sessions'
"""Folder of an archive with the sessions that were made of films and tables."""

REPORTS = 'reports'
"""Folder of an archive with the report of each session that was searched."""

_MAKE_SESSIONS = ('track', 'import')
"""Tasks that make a session."""
_MADE_BY = '.job'
"""Hidden file of a made session with the key of its job: another job, of the same recording with
other settings, makes its session in the same folder."""

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class VersionError(RuntimeError):
    """Error of a worker whose version is not that of the client."""


@dataclass(frozen=True)
class Job:
    """A task on a recording.

    Attributes
    ----------
    task : Task
        Name of the task.
    kind : Kind
        Kind of the recording.
    path : Path
        Path of the recording.
    files : tuple of Path
        Its files.
    content : str
        Digest of its content.
    archive : Path
        Archive that receives the result.
    settings : dict of str to object
        Settings of the task, as in JSON.
    version : str
        Version of the client.
    table : Path or None
        Table of the same name beside a film; its digest and the answers for its import are in the
        settings. None for none.
    """

    task: Task
    kind: Kind
    path: Path
    files: tuple[Path, ...]
    content: str
    archive: Path
    settings: dict[str, Any] = field(default_factory=dict)
    version: str = __version__
    table: Path | None = None

    @property
    def key(self) -> str:
        """Name of the work, the same for the same content, settings and version."""
        named = json.dumps([self.task, self.content, self.settings, self.version], sort_keys=True)
        return f'{self.task}-{hashlib.sha256(named.encode()).hexdigest()[:40]}'

    @property
    def result(self) -> Path:
        """File of its result."""
        return result_file(self.archive, self.key)


def result_file(archive: Path, key: str) -> Path:
    """Return the file of a result.

    Parameters
    ----------
    archive : Path
        Folder of the archive.
    key : str
        Key of the job.

    Returns
    -------
    Path
        Path of the file.
    """
    return archive / MARK / key.split('-')[-1][:2] / f'{key}.json'


def read_result(path: Path) -> dict[str, Any] | None:
    """Return a result.

    Parameters
    ----------
    path : Path
        Its file.

    Returns
    -------
    dict of str to object or None
        The result; None if there is none, or if the file is damaged, as by a power failure: the
        job is then done again.
    """
    try:
        found = json.loads(path.read_text(encoding='utf-8'))
    except (FileNotFoundError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def do(job: Job) -> str:
    """Run a job, unless it is done.

    A refused recording is a result too, and so is a table that holds averages only.

    Parameters
    ----------
    job : Job
        The job.

    Returns
    -------
    str
        Key of the job.

    Raises
    ------
    OSError
        If the disk is full.
    VersionError
        If the client has another version.
    """
    if job.version != __version__:
        raise VersionError(f'microbot_ros {__version__}; the client has {job.version}')
    if not is_done(job):
        if job.task in _MAKE_SESSIONS:
            (made_session(job) / _MADE_BY).unlink(missing_ok=True)
        try:
            outcome = _TASKS[job.task](job)
        except SummaryError as error:
            outcome = {'summary': error.expected}
        except InputError as error:
            outcome = {'refused': _reason(error)}
        except OSError as error:
            if error.errno in _DISK:
                raise
            outcome = {'refused': error.strerror or str(error)}
        if job.task in _MAKE_SESSIONS and 'session' in outcome:
            write_text(made_session(job) / _MADE_BY, job.key)
        write_text(job.result, json.dumps(outcome, ensure_ascii=False) + '\n')
    return job.key


def is_done(job: Job) -> bool:
    """Return whether a job has its result, and its session if it makes one.

    Parameters
    ----------
    job : Job
        The job.

    Returns
    -------
    bool
        Whether it is done.
    """
    result = read_result(job.result)
    if result is None:
        return False
    if job.task not in _MAKE_SESSIONS or 'session' not in result:
        return True
    mark = made_session(job) / _MADE_BY
    return mark.is_file() and mark.read_text(encoding='utf-8') == job.key


def _reason(error: InputError) -> str:
    """Return the text of an error without folders, as the recording may move."""
    name = Path(error.source).name
    place = f'{name}:{error.line}' if error.line else name
    return f'{place}: {error.expected}' if place else error.expected


def _read(job: Job) -> Session:
    """Return the session of a recording or of a table."""
    from microbot_ros.session.mcap.from_recording import session_of
    from microbot_ros.session.mcap.recording import Recording
    from microbot_ros.session.tables.folder import read_folder

    if job.kind == 'session':
        return read_folder(job.path)
    if job.kind == 'recording':
        with Recording(job.path) as recording:
            return session_of(recording)
    session, said = _imported(job.files, job.settings['answers'])
    return replace(session, name=job.path.stem,
                   remarks=(*session.remarks, *(f'assumed: {one}' for one in said)))


def _imported(files: Sequence[Path], given: dict[str, Any]) -> tuple[Session, list[str]]:
    """Return the session of a table in `files` by the `given` answers, and the assumptions."""
    from microbot_ros.session.spreadsheets.assemble import import_session
    from microbot_ros.session.spreadsheets.sheets import Answers

    answers = Answers(**given)
    with tempfile.TemporaryDirectory() as scratch:
        # Readers rely on endings, which may be wrong; other tables may lie beside these.
        for file in files:
            with file.open('rb') as stream:
                ending = '.xlsx' if stream.read(2) == b'PK' else '.csv'
            link = Path(scratch) / f'{file.stem}{ending}'
            if link.is_symlink():  # run.csv beside run.txt
                link = link.with_name(f'{file.name}{ending}')
            link.symlink_to(file)
        single = next(Path(scratch).iterdir()) if len(files) == 1 else Path(scratch)
        return import_session(single, answers)


def _facts(session: Session) -> dict[str, Any]:
    """Return the properties of a session."""
    t = session.tracks.t
    return {
        'propulsion': session.conditions.propulsion, 'duration_s': float(t[-1] - t[0]),
        'frames': len(set(t.tolist())), 'positions': len(t), 'remarks': list(session.remarks)}


def _fit(job: Job) -> dict[str, Any]:
    from microbot_ros.estimation import report
    from microbot_ros.estimation.batch import fit

    session = _read(job)
    found = fit(session, job.settings['exposure_s'])
    return {'facts': _facts(session), 'fit': report.as_json(found)}


def _discover(job: Job) -> dict[str, Any]:
    from microbot_ros.discovery.discover import discover
    from microbot_ros.model.io.effect_table import write_effects

    session = _read(job)
    found = discover([session])
    return {
        'facts': _facts(session), 'result': found.as_json(),
        'report': _write_report(job, session, found),
        'reference_field': found.model.reference_field,
        'effects': write_effects(found.model.effects),
    }


def _write_report(job: Job, session: Session, found: Discovery) -> str | None:
    """Write the report of a session and return its place in the archive.

    None if the report fails: the result of the search counts without it.
    """
    from microbot_ros.discovery.report.page import page

    place = f'{REPORTS}/{job.path.stem}-{job.content[:8]}.html'
    try:
        with writing_report(job.archive / place):
            write_text(job.archive / place, page(found, [session], [job.path]))
    except ReportError:
        return None
    return place


def _measure(job: Job) -> dict[str, Any]:
    from microbot_ros.archive.measure import measure

    wanted = {name: job.settings[name] for name in ('effects', 'known', 'reference_field')}
    return measure(_read(job), **wanted)


def _import(job: Job) -> dict[str, Any]:
    from microbot_ros.common.units import exact_display
    from microbot_ros.session import write_session

    session, said = _imported(job.files, job.settings['answers'])
    write_session(made_session(job), session)
    pixel = session.conditions.pixel_size
    return {'facts': _facts(session), 'session': made_session(job).name, 'remarks': said,
            'pixel_size_um': pixel and float(exact_display('pixel_size_um', pixel))}


def made_session(job: Job) -> Path:
    """Return the folder of the session that a job makes, whatever its assumptions.

    Parameters
    ----------
    job : Job
        The job.

    Returns
    -------
    Path
        Path of the folder.
    """
    return job.archive / SESSIONS / f'{job.path.stem}-{job.content[:8]}'


def _track(job: Job) -> dict[str, Any]:
    from microbot_ros.archive.films import track_film
    from microbot_ros.common.units import to_si
    from microbot_ros.tracking import TrackerSettings

    width, problem, table = job.settings['pixel_size_um'], '', None
    pixel_size = None if width is None else to_si('_um', width)
    if job.table is not None:
        try:
            table, _ = _imported([job.table], job.settings['answers'])
        except InputError as error:
            problem = f'not compared with the table of the same name: {_reason(error)}'
        else:
            pixel_size = pixel_size or table.conditions.pixel_size
    with output_folder(made_session(job)) as folder:
        told = track_film(job.files, folder / 'tracks.csv', pixel_size,
                          job.settings['frame_rate_hz'],
                          TrackerSettings(**job.settings['tracker']), table)
        if table is not None and job.table is not None:
            _beside_table(told, table, job.table.name)
            _write_commands(folder, job, table, told)
    if problem:
        told['remarks'].append(problem)
    return {'film': told, 'session': made_session(job).name}


def _beside_table(told: dict[str, Any], table: Session, name: str) -> None:
    """Add the agreement of a film with its table to its result, as JSON and sentences."""
    agreed = told.pop('beside_table', None)
    if agreed is None:
        said = [f'not compared with {name}: no pixel size is known']
    else:
        left = len(table.tracks.particles) - len(agreed)
        said = [one.sentence(name) for one in agreed]
        said += [f'{left} robots of {name} were not found in the film'] if left else []
    told['table'] = {'name': name, 'robots': [one.as_json() for one in agreed or ()],
                     'sentences': said}


def _write_commands(folder: Path, job: Job, table: Session, told: dict[str, Any]) -> None:
    """Write the statements of a film's table, and their agreement, into a session.

    A `commands.csv` or `session.yaml` beside the film is kept, as people wrote it.
    """
    from microbot_ros.session import write_session

    beside = job.path if job.path.is_dir() else job.path.parent
    said = [f'positions are from the film, commands from {told["table"]["name"]}',
            *told['table']['sentences']]
    with tempfile.TemporaryDirectory() as scratch:
        write_session(Path(scratch) / 'table', replace(table, assumed=(*table.assumed, *said)))
        for name in ('commands.csv', 'session.yaml'):
            made = Path(scratch) / 'table' / name
            if made.exists() and not (beside / name).exists():
                shutil.copyfile(made, folder / name)


_TASKS: dict[Task, Callable[[Job], dict[str, Any]]] = {
    'track': _track, 'fit': _fit, 'discover': _discover, 'import': _import, 'measure': _measure}
