"""Address of the page, which contains the token: in a file of its user, and in no log.

A journal may keep the output of a node. Therefore the node writes the address to a file that only
its user can read and prints the path; a command that this user started on a terminal shows the
address there.
"""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from microbot_ros.common.errors import InputError

WORDS = 'the address to open is in '
"""End of a line that names the file, before its path."""


def write(address: str, port: int) -> Path:
    """Write an address into the file of a server.

    The file is `microbot/cockpit-PORT` in `$XDG_RUNTIME_DIR`, or in a folder of this user in the
    folder for temporary files.

    Parameters
    ----------
    address : str
        Address with its token.
    port : int
        Port of the server.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    InputError
        If that folder belongs to another user.
    """
    path = _folder() / f'cockpit-{port}'
    with suppress(FileNotFoundError):
        path.unlink()
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), 'w') as file:
        file.write(address + '\n')
    return path


def shown(line: str, stream: TextIO) -> str:
    """Return a line of a cockpit as it is printed on a stream.

    Parameters
    ----------
    line : str
        Line that names the file.
    stream : TextIO
        Stream to print on.

    Returns
    -------
    str
        With the address in place of its file on a terminal, unchanged elsewhere.
    """
    before, words, path = line.partition(WORDS)
    if words and stream.isatty():
        with suppress(OSError):
            return f'{before}open {Path(path).read_text().strip()}'
    return line


def _folder() -> Path:
    runtime = os.environ.get('XDG_RUNTIME_DIR', '')
    folder = (Path(runtime) / 'microbot' if runtime and Path(runtime).is_dir() else
              Path(tempfile.gettempdir()) / f'microbot-{os.getuid()}')
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if found.st_uid != os.getuid() or found.st_mode & 0o077 or folder.is_symlink():
        raise InputError(folder, 'expected a folder that only this user can open, for the '
                                 "cockpit's address file")
    return folder
