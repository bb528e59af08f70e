"""Validated YAML input and all-or-nothing file output."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

import yaml

from microbot_ros.common import strict_yaml
from microbot_ros.common.checked import SettingsError, checked
from microbot_ros.common.errors import InputError, ReportError, clipped

_folder: ContextVar[Path] = ContextVar('_folder', default=Path())
"""Folder of the file that is being read."""


def beside(path: Any) -> Any:
    """Return a path in a file that is being read, relative to the folder of that file.

    Parameters
    ----------
    path : object
        The path; what is no path is returned as it is.

    Returns
    -------
    object
        The path.
    """
    return _folder.get() / path if isinstance(path, str | Path) else path


ContentT = TypeVar('ContentT')


def read_yaml(path: str | Path, kind: type[ContentT]) -> ContentT:
    """Read the YAML file `path` as a value of the type `kind`, checked.

    Raises InputError naming file, line, key and what was expected if the file is missing, is not
    YAML or does not fit.

    Parameters
    ----------
    path : str or Path
        YAML file to read.
    kind : type[ContentT]
        Type of the content: settings, or a dict of what `checked` accepts.

    Returns
    -------
    ContentT
        The content.
    """
    path = Path(path)
    tree, content = load_yaml(path)
    content = content or {}
    if not isinstance(content, dict):
        raise InputError(path, 'expected a mapping (key: value) at the top level', 1)
    before = _folder.set(path.parent)
    try:
        found: ContentT = checked(kind, content)
        return found
    except SettingsError as error:
        raise InputError(path, str(error), _line_of(tree, error.place)) from None
    finally:
        _folder.reset(before)


def load_yaml(path: str | Path, loader: type[strict_yaml.StrictLoader] = strict_yaml.StrictLoader,
              ) -> tuple[yaml.Node | None, Any]:
    """Return the tree of the YAML file `path` and its content as `loader` builds it, unchecked.

    Raises InputError with file and line if the file is missing or not plain YAML.

    Parameters
    ----------
    path : str or Path
        YAML file to read.
    loader : type[strict_yaml.StrictLoader]
        Class that builds the content.

    Returns
    -------
    tuple[yaml.Node or None, object]
        Root of the tree, None for an empty file, and the content.
    """
    path = Path(path)
    try:
        if path.stat().st_size > strict_yaml.LARGEST_BYTES:
            raise strict_yaml.YamlError(f'at most {strict_yaml.LARGEST_BYTES // 2**20} MB')
        return strict_yaml.load(path.read_text(encoding='utf-8'), loader)
    except UnicodeDecodeError:
        raise InputError(path, 'expected YAML text, found binary data') from None
    except OSError as error:
        raise InputError(path, f'expected a readable YAML file ({error.strerror})') from None
    except strict_yaml.YamlError as error:
        raise InputError(path, f'expected YAML; {error.problem}', error.line) from None


def line_of(path: str | Path, *keys: int | str) -> int | None:
    """Return the line of the YAML file `path` at the path of `keys`, as far as it exists.

    Parameters
    ----------
    path : str or Path
        YAML file to read.
    *keys : int or str
        Keys and indices from the root on.

    Returns
    -------
    int or None
        Line from 1; None if there is no tree.
    """
    return _line_of(load_yaml(path)[0], keys)


def _line_of(tree: yaml.Node | None, location: tuple[int | str, ...]) -> int | None:
    """Return the line of the deepest existing part of a key path."""
    line = None if tree is None else tree.start_mark.line + 1
    for part in location:
        if isinstance(tree, yaml.MappingNode):
            match = next(((k, v) for k, v in tree.value if k.value == str(part)), None)
            if match is None:
                return line
            line, tree = match[0].start_mark.line + 1, match[1]
        elif isinstance(tree, yaml.SequenceNode) and isinstance(part, int):
            if part >= len(tree.value):
                return line
            tree = tree.value[part]
            line = tree.start_mark.line + 1
    return line


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path` atomically: readers see the old content or the new one.

    Parameters
    ----------
    path : str or Path
        File to write; missing folders are made.
    text : str
        New content of the file.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f'.{path.name}.')
    try:
        with os.fdopen(handle, 'w', encoding='utf-8') as stream:
            stream.write(text)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def write_json(path: str | Path | None, content: Any) -> None:
    """Write `content` to `path` as JSON, atomically; numbers that are not finite become null.

    Parameters
    ----------
    path : str or Path or None
        File to write; None writes nothing.
    content : object
        Dicts, lists, texts, numbers, booleans and None.
    """
    if path is not None:
        write_text(path, json.dumps(_without_nan(content), indent=1, ensure_ascii=False,
                                    allow_nan=False) + '\n')


def _without_nan(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _without_nan(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_without_nan(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


@contextmanager
def writing_report(path: Path) -> Iterator[None]:
    """Context for writing the report `path` after its results.

    Any exception becomes a ReportError that names its place in the code, and an earlier report of
    that name is removed, since it does not belong to the new results.

    Parameters
    ----------
    path : Path
        The report.

    Yields
    ------
    None
        Nothing; the context has no value.
    """
    try:
        yield
    except Exception as error:
        path.unlink(missing_ok=True)
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise ReportError(
            f'{path}: not written, {clipped(f"{type(error).__name__}: {error}")} '
            f'({Path(last.filename).name}:{last.lineno}). The other results are complete; please '
            'report this fault') from error


def refuse_to_overwrite(folder: Path, names: Iterable[str], force: bool) -> None:
    """Raise InputError if `folder` has files of these `names`, unless `force`.

    Parameters
    ----------
    folder : Path
        The folder.
    names : iterable of str
        Names of files, or patterns of such names.
    force : bool
        Whether to accept them.
    """
    there = [path.name for name in names for path in sorted(folder.glob(name))]
    if there and not force:
        raise InputError(folder, f'expected a folder without {", ".join(there)}; --force replaces '
                                 'these files')


@contextmanager
def output_folder(path: str | Path, own: Iterable[str] = ()) -> Iterator[Path]:
    """Context with a folder to fill that gets its name only when everything is written.

    Files are written to a hidden folder in `path`, or beside it if it is new. On success they move
    into `path` one by one, replacing files of the same name and keeping others; on any exception
    nothing remains of them.

    Parameters
    ----------
    path : str or Path
        The folder.
    own : iterable of str
        Names of files that belong to the results: earlier ones that are not replaced are removed.

    Yields
    ------
    Path
        Hidden folder to fill.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(path, 'expected a folder to write to, found a file')
    try:
        # An existing folder may be a mount, a link to another disk, or the only one to write to.
        place = path if path.is_dir() else path.parent
        place.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=place, prefix=f'.{path.name}.'))
    except OSError as error:
        problem = f'expected a writable folder ({error.strerror})'
        raise InputError(path, problem) from None
    try:
        yield scratch
        path.mkdir(exist_ok=True)
        stale = {*own} - {item.name for item in scratch.iterdir()}
        for item in sorted(scratch.iterdir()):
            target = path / item.name
            if target.is_dir():
                shutil.rmtree(target)
            os.replace(item, target)
        for name in stale:
            (path / name).unlink(missing_ok=True)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
