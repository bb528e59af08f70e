"""What pip installs: a wheel and an sdist with all that runs, light, from any folder."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from zipfile import ZipFile

import pytest

import microbot_ros

pytestmark = pytest.mark.rig

ROOT = Path(__file__).parents[1]
SHARED = f'microbot_ros-{microbot_ros.__version__}.data/data/share/microbot_ros'
HEAVY = {'av', 'cv2', 'dask', 'gymnasium', 'matplotlib', 'numba', 'numpy', 'osqp',
         'rclpy', 'rosbags', 'scipy', 'starlette', 'yaml'}


def build(kind: str, sources: Path) -> Path:
    """A distribution of a `kind`, 'wheel' or 'sdist', by what pyproject.toml says builds it."""
    done = subprocess.run(
        [sys.executable, '-c', f'import setuptools.build_meta as by; by.build_{kind}("out")'],
        cwd=sources, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    (made,) = (sources / 'out').glob('*.whl' if kind == 'wheel' else '*.tar.gz')
    return made


@pytest.fixture(scope='module')
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources: building leaves things beside them."""
    folder = tmp_path_factory.mktemp('sources') / 'microbot_ros'
    kept = {path.name for path in ROOT.iterdir() if path.is_file()} | {
        'config', 'launch', 'microbot_ros', 'resource'}
    shutil.copytree(ROOT, folder, ignore=lambda place, names: [
        name for name in names
        if name == '__pycache__' or (Path(place) == ROOT and name not in kept)])
    return folder


@pytest.fixture(scope='module')
def wheel(sources: Path) -> Iterator[ZipFile]:
    with ZipFile(build('wheel', sources)) as opened:
        yield opened


@pytest.fixture(scope='module')
def about(wheel: ZipFile) -> Message:
    """What the wheel says of itself."""
    (name,) = (name for name in wheel.namelist() if name.endswith('.dist-info/METADATA'))
    return message_from_bytes(wheel.read(name))


def test_the_wheel_has_all_that_runs(wheel: ZipFile) -> None:
    needed = {str(path.relative_to(ROOT)) for path in (ROOT / 'microbot_ros').rglob('*')
              if path.is_file() and '__pycache__' not in path.parts}
    needed |= {f'{SHARED}/{path.relative_to(ROOT)}' for folder in ('config', 'launch')
               for path in (ROOT / folder).iterdir() if path.is_file()}
    assert needed <= set(wheel.namelist())


def test_the_sdist_makes_the_same_wheel(
        sources: Path, wheel: ZipFile, tmp_path: Path) -> None:
    with tarfile.open(build('sdist', sources)) as packed:
        packed.extractall(tmp_path, filter='data')
    (unpacked,) = tmp_path.iterdir()
    with ZipFile(build('wheel', unpacked)) as other:
        assert {info.filename: info.CRC for info in other.infolist()} == {
            info.filename: info.CRC for info in wheel.infolist()}


def test_extras_leave_the_core_light(about: Message) -> None:
    needs = [str(value) for value in about.get_all('Requires-Dist', [])]
    assert {'gym', 'cockpit', 'cameras', 'dask'} <= set(about.get_all('Provides-Extra', []))
    core = {value for value in needs if 'extra ==' not in value}
    assert len(core) == 7
    for name, extra in (('gymnasium', 'gym'), ('starlette', 'cockpit'), ('pypylon', 'cameras'),
                        ('distributed', 'dask'), ('rclpy', 'ros'), ('matplotlib', 'analysis'),
                        ('av', 'video'), ('mcap', 'mcap'), ('osqp', 'predictive')):
        assert not any(name in value for value in core), name
        assert any(name in value and f"extra == '{extra}'" in value.replace('"', "'")
                   for value in needs), name


@pytest.fixture(scope='module')
def elsewhere(wheel: ZipFile, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with nothing but the wheel, installed into `site`."""
    folder = tmp_path_factory.mktemp('elsewhere')
    subprocess.run([sys.executable, '-m', 'pip', 'install', '--quiet', '--no-index', '--no-deps',
                    '--disable-pip-version-check', '--target', folder / 'site', wheel.filename],
                   check=True, capture_output=True, timeout=100)
    return folder


def microbot(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """The command of the wheel that was installed in a `folder`, run in it."""
    return subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, capture_output=True, text=True,
        timeout=100, env={**os.environ, 'PYTHONPATH': str(folder / 'site')}, check=True)


def test_the_wheel_runs_from_any_folder(elsewhere: Path, tmp_path: Path) -> None:
    script = elsewhere / 'site' / 'bin' / 'microbot'
    place = microbot(elsewhere, '-c', 'import microbot_ros; print(microbot_ros.__file__)').stdout
    assert place.strip() == str(elsewhere / 'site' / 'microbot_ros' / '__init__.py')
    table = tmp_path / 'table.csv'
    table.write_text('t_s,particle,x_um,y_um\n0,0,1,2\n0.1,0,2,2\n')
    microbot(elsewhere, script, 'import', table, '--out', tmp_path / 'session')
    assert (tmp_path / 'session' / 'tracks.csv').is_file()


def test_help_is_there_at_once(elsewhere: Path) -> None:
    """0.2 s of the processor at most, the least of a few, and nothing is loaded that is not used.
    """
    words = '-m', 'microbot_ros.cli', '--help'
    spent = []
    for _ in range(5):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        microbot(elsewhere, *words)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    assert min(spent) < 0.2
    told = microbot(elsewhere, '-X', 'importtime', *words).stderr
    loaded = {line.rpartition('|')[2].strip().partition('.')[0] for line in told.splitlines()}
    assert 'click' in loaded
    assert not loaded & HEAVY
