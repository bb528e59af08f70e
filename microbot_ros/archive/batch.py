"""Run over an archive: find recordings, process those that are new, conclude."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from microbot_ros.archive.cluster import ClusterError, cluster, introduced, run_jobs
from microbot_ros.archive.imports import siblings
from microbot_ros.archive.labels import labels_of, own_answers, stated
from microbot_ros.archive.recordings import (
    Found,
    Refused,
    content_of,
    find,
    in_parallel,
    pairs,
)
from microbot_ros.archive.store import REPORT, Archive
from microbot_ros.archive.work import READS, Job, Task, is_done
from microbot_ros.common.errors import InputError, ReportError
from microbot_ros.common.files import read_yaml, writing_report
from microbot_ros.session.spreadsheets.sheets import Answers
from microbot_ros.session.tables.folder import SessionFile

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class Progress:
    """Progress of a run.

    Attributes
    ----------
    doing : str
        Present activity.
    done : int
        Recordings that are done.
    total : int
        Recordings to do.
    seconds : float
        Time of the activity so far [s].
    note : str
        Sentence that is to stay on the screen.
    """

    doing: str = ''
    done: int = 0
    total: int = 0
    seconds: float = 0.0
    note: str = ''

    @property
    def rate(self) -> float:
        """Recordings per second; 0 before the first."""
        return self.done / self.seconds if self.seconds else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Remaining time [s] at the rate so far; None before the first recording."""
        return (self.total - self.done) / self.rate if self.rate else None


@dataclass
class Summary:
    """Result of a run. Each recording counts once.

    Attributes
    ----------
    task : Task
        The task.
    found : int
        Recordings that were found, with those that cannot be read.
    done : int
        Recordings that were processed in this run.
    kept : int
        Recordings that were processed before.
    aside : int
        Recordings of a kind that the task does not process.
    copy_of : dict of str to str
        Name of the original by name of the copy.
    refused : dict of str to str
        Reason by name, of recordings that could not be read.
    failed : dict of str to str
        Reason by name, of recordings whose worker failed; the next run tries them again.
    summaries : dict of str to str
        Sentence by name, of tables that hold averages and no recording.
    no_report : str
        Why archive.html could not be written; '' if it was.
    """

    task: Task
    found: int = 0
    done: int = 0
    kept: int = 0
    aside: int = 0
    copy_of: dict[str, str] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    summaries: dict[str, str] = field(default_factory=dict)
    no_report: str = ''


def run_batch(task: Task, folders: Sequence[Path], out: Path, settings: dict[str, Any],
              workers: int | None = None, scheduler: str | None = None,
              report: Callable[[Progress], None] = lambda _: None,
              ) -> tuple[Summary, dict[str, Any]]:
    """Run a task on every recording in folders, and keep the results in an archive.

    Recordings that were processed before, by content, settings and version, are not processed
    again. `conclude` returns the conclusions with all numbers.

    Parameters
    ----------
    task : Task
        Name of the task.
    folders : sequence of Path
        Folders of recordings.
    out : Path
        Folder of the archive.
    settings : dict of str to object
        Settings of the task, unless an `archive.yaml` states others: `exposure_s` for fit;
        `answers`, those of `microbot import`, for fit, discover and import; `pixel_size_um`,
        `frame_rate_hz` and `tracker` for track.
    workers : int or None
        Number of workers on this machine; None for its cores.
    scheduler : str or None
        Address of a Dask scheduler to use instead; None for none.
    report : callable
        Function that is called with the progress.

    Returns
    -------
    tuple[Summary, dict of str to object]
        Summary of the run, and the conclusions as in JSON.

    Raises
    ------
    InputError
        If a folder, a scheduler or an archive is not valid.
    OSError
        If the disk is full.
    ClusterError
        If the scheduler is lost.
    """
    archive, summary = Archive(out), Summary(task)
    with archive.locked(), ExitStack() as stack:
        @cache
        def client() -> Client:
            report(Progress('starting workers' if scheduler is None else f'asking {scheduler}'))
            started = stack.enter_context(cluster(workers, scheduler))
            threading.Thread(target=_load_ahead, name='load ahead').start()
            report(Progress(note=introduced(started)))
            return started

        jobs = _look(archive, task, folders, settings, summary, report)
        if not summary.found:
            raise InputError(', '.join(map(str, folders)), 'expected recordings; found none')
        archive.save()
        if (known := archive.findings()) is not None and all(map(is_done, jobs)):
            _count(archive, jobs, summary)
            return summary, known
        stopped: BaseException | None = None
        try:
            _do(archive, jobs, client, summary, report)
            if task == 'discover':
                compared = Summary('measure')
                _do(archive, _measurements(archive, settings), client, compared, report)
                summary.failed |= compared.failed
        except (KeyboardInterrupt, ClusterError) as error:
            stopped = error
            stack.close()  # stop the workers
        report(Progress('concluding'))
        found = _conclude(archive, summary)
        archive.save(found, complete=not (stopped or summary.failed or summary.no_report))
        if stopped:
            raise stopped
    return summary, found


def _load_ahead() -> None:
    """Import the modules of `_conclude` while the workers work, which takes seconds."""
    with suppress(ImportError):  # reported where it is used
        importlib.import_module('microbot_ros.archive.conclusions.report')
        importlib.import_module('pyarrow')


def _conclude(archive: Archive, summary: Summary) -> dict[str, Any]:
    """Write table and report of an archive and return its conclusions.

    If the report fails, the summary contains the reason.
    """
    from microbot_ros.archive.conclusions.conclude import conclude
    from microbot_ros.archive.conclusions.report import write_report
    from microbot_ros.archive.table import write_table

    found = conclude(archive)
    write_table(archive, found.rows)
    try:
        with writing_report(archive.folder / REPORT):
            write_report(archive, found)
    except ReportError as error:
        summary.no_report = str(error)
    return found.as_json()


def _measurements(archive: Archive, settings: dict[str, Any]) -> list[Job]:
    """Return the jobs that measure all recurring effects in each explained session."""
    from microbot_ros.archive.conclusions.recurring import (
        candidates_for_all,
        common_reference,
        is_complete,
    )

    discovered = archive.results('discover')
    effects = candidates_for_all(discovered)
    for entry in archive.entries.values():
        entry.jobs.pop('measure', None)
    jobs = []
    for path, result in discovered.items():
        entry = archive.entries[path]
        if not effects or not is_complete(result):
            continue
        asked = {'effects': effects, 'known': result['effects'],
                 'reference_field': common_reference(discovered)}
        own = {}
        if entry.kind == 'table':
            found = Found(Path(path), 'table', Path(entry.top), tuple(map(Path, entry.files)))
            own['answers'] = own_answers(found, settings['answers'])
        job = Job('measure', entry.kind, Path(path), tuple(map(Path, entry.files)), entry.content,
                  archive.folder, own | asked)
        entry.jobs['measure'] = job.key
        jobs.append(job)
    return jobs


def _look(archive: Archive, task: Task, folders: Sequence[Path], settings: dict[str, Any],
          summary: Summary, report: Callable[[Progress], None]) -> list[Job]:
    """Return the jobs on all recordings that are found, and register these in the archive.

    A film and the table of its name are one recording.
    """
    report(Progress('looking for recordings'))
    everything = list(find(folders, archive.cards))
    found = [one for one in everything if isinstance(one, Found)]
    refused = {one.name: one for one in everything if isinstance(one, Refused)}
    wanted = [one for one in found if one.kind in READS[task]]
    jobs, there = [], {str(one.path) for one in found}
    beside = pairs(found)
    for one in in_parallel(wanted, archive.cards, lambda what: report(Progress(what))):
        if isinstance(one, Refused):
            refused[one.name] = one
            continue
        recording, content = one
        labels = labels_of(recording)
        try:
            own = _settings(task, recording, settings)
            table = beside.get(recording.path)
            if table is not None:
                own |= {'table': content_of(table, archive.cards),
                        'answers': own_answers(table, asdict(Answers()))}
        except (InputError, OSError) as error:
            refused[recording.name] = Refused.of(recording.path, recording.top, str(error))
            continue
        entry = archive.note(recording, content, labels)
        job = Job(task, recording.kind, recording.path, recording.files, content, archive.folder,
                  own, table=None if table is None else table.path)
        entry.jobs[task] = job.key
        jobs.append(job)
    archive.forget([folder.resolve() for folder in folders], there)
    archive.refused |= refused
    summary.found = len(everything) - len(beside)
    summary.aside = len(found) - len(beside) - len(wanted)
    summary.refused |= {name: one.reason for name, one in refused.items()}
    return jobs


def _settings(task: Task, recording: Found, settings: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that concern one job, which its key contains.

    InputError for a `session.yaml` beside a film that is not valid.
    """
    if task == 'track':
        beside = recording.path if recording.path.is_dir() else recording.path.parent
        known, said = SessionFile(), stated(recording)
        if (beside / 'session.yaml').exists():
            known = read_yaml(beside / 'session.yaml', SessionFile)
        return {'tracker': settings['tracker']} | {
            name: said.get(name) or settings[name] or getattr(known, name)
            for name in ('pixel_size_um', 'frame_rate_hz')}
    own = {}
    if recording.kind == 'table':
        own['answers'] = own_answers(recording, settings['answers'])
    return own | ({'exposure_s': settings['exposure_s']} if task == 'fit' else {})


def _do(archive: Archive, jobs: Sequence[Job], client: Callable[[], Client], summary: Summary,
        report: Callable[[Progress], None]) -> None:
    """Run the jobs that are not done."""
    missing = [job for job in {job.key: job for job in jobs}.values() if not is_done(job)]
    doing, began = {'measure': 'comparing'}.get(summary.task, summary.task), time.monotonic()
    finished: set[str] = set()

    def told(job: Job, problem: str) -> None:
        if problem:
            summary.failed[archive.entries[str(job.path)].name] = problem
        else:
            finished.add(job.key)
        report(Progress(doing, len(finished) + len(summary.failed), len(missing),
                        time.monotonic() - began))

    if missing:
        working = client()
        began = time.monotonic()
        report(Progress(doing, 0, len(missing)))
        run_jobs(working, missing, told)
    _count(archive, jobs, summary, finished)


def _count(archive: Archive, jobs: Sequence[Job], summary: Summary,
           finished: AbstractSet[str] = frozenset()) -> None:
    """Add the present state of the jobs to the summary, and publish the sessions that were made.

    `finished` are the keys of the jobs that this run finished.
    """
    different = {job.key: job for job in jobs}
    summary.copy_of = {archive.entries[str(job.path)].name: archive.entries[str(one.path)].name
                       for job in jobs if (one := different[job.key]) is not job}
    for job in different.values():
        name, result = archive.entries[str(job.path)].name, archive.result(job.key)
        if result is None:
            continue
        if 'refused' in result:
            summary.refused[name] = result['refused'] + siblings(archive, job)
        elif 'summary' in result:
            summary.summaries[name] = result['summary']
        elif job.key in finished:
            summary.done += 1
        else:
            summary.kept += 1
        if 'session' in result:
            archive.publish(job.path, result['session'])
