"""A run over an archive: find, do what is not done yet, conclude."""

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
from microbot_ros.archive.work import READS, Job, Task
from microbot_ros.common.errors import InputError, ReportError
from microbot_ros.common.files import read_yaml, writing_report
from microbot_ros.session.spreadsheets.sheets import Answers
from microbot_ros.session.tables.folder import SessionFile

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class Progress:
    """How far a run is: `done` of `total` in `seconds`, at what (`doing`).

    `note`: a sentence that is to stay.
    """

    doing: str = ''
    done: int = 0
    total: int = 0
    seconds: float = 0.0
    note: str = ''

    @property
    def rate(self) -> float:
        """Recordings a second; 0 before the first."""
        return self.done / self.seconds if self.seconds else 0.0

    @property
    def seconds_left(self) -> float | None:
        """By the rate so far; None before the first."""
        return (self.total - self.done) / self.rate if self.rate else None


@dataclass
class Summary:
    """What a run did: a `task` on `found` recordings, of which some were `done` now and others
    `kept` from before.

    `refused`: {name: reason} of what could not be read; `failed` likewise, where a worker failed,
    which is tried again next time; `aside`: how many are of a kind that the task does not take;
    `copies` of others that were done once; `summaries`: {name: sentence} of tables that hold
    averages and no recording. Each recording counts once. `no_report`: why archive.html could not
    be written, '' where it was.
    """

    task: Task
    found: int = 0
    done: int = 0
    kept: int = 0
    aside: int = 0
    copies: int = 0
    refused: dict[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    summaries: dict[str, str] = field(default_factory=dict)
    no_report: str = ''


def run_batch(task: Task, folders: Sequence[Path], out: Path, settings: dict[str, Any],
              workers: int | None = None, scheduler: str | None = None,
              report: Callable[[Progress], None] = lambda _: None,
              ) -> tuple[Summary, dict[str, Any]]:
    """Do a `task` on every recording in `folders`, and keep the results in the archive `out`.

    `settings` of the task, where an `archive.yaml` states no others: `exposure_s` for fit;
    `answers`, those of `microbot import`, for fit, discover and import; `pixel_size_um`,
    `frame_rate_hz` and `tracker` for track. On so many `workers` here, or on a `scheduler`'s.
    `report` is told the progress. What was done before, by content, settings and version, is not
    done again. Returns what was done and what the archive says as a whole, as JSON has it;
    `conclude` gives that with all numbers. InputError for a folder, a scheduler or an archive
    that is not as it must be, OSError for a full disk, ClusterError.
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
        if not (summary.found or summary.refused):
            raise InputError(', '.join(map(str, folders)), 'expected recordings; found none')
        archive.save()
        if (known := archive.findings()) is not None:
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
            stack.close()  # nobody works on meanwhile
        report(Progress('concluding'))
        found = _conclude(archive, summary)
        archive.save(found, complete=not (stopped or summary.failed or summary.no_report))
        if stopped:
            raise stopped
    return summary, found


def _load_ahead() -> None:
    """Load what `_conclude` needs while the workers work: figures and tables take seconds."""
    with suppress(ImportError):  # said where it is used
        importlib.import_module('microbot_ros.archive.report')
        importlib.import_module('pyarrow')


def _conclude(archive: Archive, summary: Summary) -> dict[str, Any]:
    """Write table and report of an `archive` and return what they say.

    Where the report fails, the `summary` says why.
    """
    from microbot_ros.archive.conclusions import conclude
    from microbot_ros.archive.report import write_report
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
    """Return the second look: each session that is explained is asked for all recurring effects.
    """
    from microbot_ros.archive.recurring import candidates_for_all, common_reference, is_complete

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
    """The jobs on all that is found; what is found is noted in the archive.

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
    summary.found = len(found) - len(beside)
    summary.aside = summary.found - len(wanted)
    summary.refused |= {name: one.reason for name, one in refused.items()}
    return jobs


def _settings(task: Task, recording: Found, settings: dict[str, Any]) -> dict[str, Any]:
    """Those of a recording's own job: what does not touch it is not in its key.

    InputError for a `session.yaml` beside a film that is none.
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
    """Do of `jobs` what is not done; the rest is kept."""
    missing = [job for job in {job.key: job for job in jobs}.values() if not job.result.exists()]
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
    """Into the `summary` what became of the `jobs` by now; the sessions made get what is known.

    `finished` are the keys of those that were done in this run.
    """
    different = {job.key: job for job in jobs}
    summary.copies = len(jobs) - len(different)
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
