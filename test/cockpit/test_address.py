"""The address with its token: for its user alone, and on a terminal alone."""

from __future__ import annotations

import io
import stat
from pathlib import Path

import pytest

from microbot_ros.cockpit import address
from microbot_ros.common.errors import InputError

HERE = 'http://127.0.0.1:8642/?token=secret'


class Terminal(io.StringIO):
    """A stream that a person reads."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for what a user's programs leave while they run."""
    monkeypatch.setenv('XDG_RUNTIME_DIR', str(tmp_path))
    return tmp_path


@pytest.mark.usefixtures('runtime')
def test_only_its_user_can_read_the_file() -> None:
    path = address.write(HERE, 8642)
    assert path.read_text() == HERE + '\n'
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert address.write(HERE + '2', 8642).read_text() == HERE + '2\n'


def test_a_file_that_others_could_read_is_not_written_through(runtime: Path) -> None:
    other = runtime / 'other'
    other.touch(0o666)
    path = address.write(HERE, 1)
    path.unlink()
    path.symlink_to(other)
    address.write(HERE, 1)
    assert other.read_text() == ''
    assert not path.is_symlink()


def test_a_folder_of_somebody_else_is_refused(runtime: Path) -> None:
    (runtime / 'microbot').mkdir(0o777)
    (runtime / 'microbot').chmod(0o777)
    with pytest.raises(InputError, match='only this user'):
        address.write(HERE, 1)


def test_without_a_runtime_folder_it_is_in_one_of_its_own(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('XDG_RUNTIME_DIR', str(tmp_path / 'none'))
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    assert address.write(HERE, 1).parent.parent == tmp_path


@pytest.mark.usefixtures('runtime')
def test_the_token_is_shown_on_a_terminal_alone() -> None:
    line = f'cockpit: {address.WORDS}{address.write(HERE, 8642)}'
    assert address.shown(line, Terminal()) == f'cockpit: open {HERE}'
    assert address.shown(line, io.StringIO()) == line
    assert 'secret' not in line
    assert address.shown('cockpit: 1 pages', Terminal()) == 'cockpit: 1 pages'
    assert address.shown(f'{address.WORDS}/nowhere', Terminal()) == f'{address.WORDS}/nowhere'
