"""It is an ordinary ROS package: colcon builds it, and what it installs runs."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import types
import xml.etree.ElementTree as ElementTree
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

import microbot_ros
from microbot_ros.nodes.configuration import node_class

ROOT = Path(__file__).parents[1]
BIN = Path(sys.executable).parent


def _environment() -> dict[str, str]:
    # What the wheels' bootstrap sets would follow us into the tools of colcon.
    left_out = ('LD_LIBRARY_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE')
    kept = {name: value for name, value in os.environ.items() if name not in left_out}
    return {**kept, 'AMENT_PREFIX_PATH': str(BIN.parent),
            'PATH': f'{BIN}{os.pathsep}{os.environ["PATH"]}'}


@pytest.fixture(scope='module')
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A colcon workspace with a copy of the sources, built."""
    folder = tmp_path_factory.mktemp('workspace')
    ignored = shutil.ignore_patterns(
        '.*', 'out', 'build', 'install', 'log', '__pycache__', '*.egg-info', 'test', 'bench')
    shutil.copytree(ROOT, folder / 'src' / 'microbot_ros', ignore=ignored)
    built = subprocess.run(
        [BIN / 'colcon', 'build', '--base-paths', 'src', '--event-handlers', 'console_direct+'],
        cwd=folder, env=_environment(), capture_output=True, text=True, timeout=100)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


def test_colcon_knows_what_it_is() -> None:
    listed = subprocess.run(
        [BIN / 'colcon', 'list', '--base-paths', str(ROOT)], cwd=ROOT, env=_environment(),
        capture_output=True, text=True, timeout=60, check=True)
    assert re.search(r'^microbot_ros\s+\S+\s+\(ros\.ament_python\)$', listed.stdout, re.MULTILINE)


def test_colcon_installs_what_ros_looks_for(workspace: Path) -> None:
    installed = workspace / 'install' / 'microbot_ros'
    share = installed / 'share' / 'microbot_ros'
    assert (installed / 'share/ament_index/resource_index/packages/microbot_ros').is_file()
    assert (share / 'package.xml').is_file()
    assert {path.name for path in (share / 'launch').iterdir()} == {
        'demo_launch.py', 'replay_launch.py', 'rig_launch.py'}
    assert (share / 'config' / 'rig.yaml').is_file()
    scripts = {path.name for path in (installed / 'lib' / 'microbot_ros').iterdir()}
    nodes = {'camera', 'coil_driver', 'controller', 'model', 'player', 'recorder', 'tracker',
             'virtual_rig'}
    assert {f'{node}_node' for node in nodes} | {'microbot'} <= scripts


def test_scripts_run_from_the_install_space(workspace: Path) -> None:
    installed = workspace / 'install' / 'microbot_ros'
    site = next((installed / 'lib').glob('python3*/site-packages'))
    environment = {**_environment(), 'PYTHONPATH': str(site)}
    version = subprocess.run(
        [sys.executable, installed / 'lib/microbot_ros/microbot', '--version'],
        cwd=workspace, env=environment, capture_output=True, text=True, timeout=60)
    assert microbot_ros.__version__ in version.stdout, version.stderr
    # A node that lacks its parameter says so in one line and ends with 2.
    node = subprocess.run(
        [sys.executable, installed / 'lib/microbot_ros/camera_node'],
        cwd=workspace, env=environment, capture_output=True, text=True, timeout=60)
    assert node.returncode == 2
    assert 'camera: expected a parameter source' in node.stderr


def test_versions_agree() -> None:
    package = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    setup = re.search(r"version='([^']+)'", (ROOT / 'setup.py').read_text())
    assert setup is not None
    assert package == setup.group(1) == microbot_ros.__version__


@pytest.mark.parametrize('name', ['rig', 'demo', 'replay'])
def test_launch_files_start_nodes_with_parameters_that_exist(
        name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """launch is not on PyPI: its classes are stood in for by one that keeps its arguments."""
    started: list[dict[str, Any]] = []
    stand_in = types.ModuleType('stand_in')
    for kind in ('LaunchDescription', 'DeclareLaunchArgument', 'LaunchConfiguration',
                 'ExecuteProcess', 'ParameterValue', 'SetEnvironmentVariable'):
        setattr(stand_in, kind, lambda *arguments, **_: arguments)
    stand_in.LifecycleNode = lambda **arguments: started.append(arguments)  # type: ignore[attr-defined]
    stand_in.get_package_share_directory = lambda _: str(ROOT)  # type: ignore[attr-defined]
    for module in ('launch', 'launch.actions', 'launch.substitutions', 'launch_ros',
                   'launch_ros.actions', 'launch_ros.parameter_descriptions',
                   'ament_index_python', 'ament_index_python.packages'):
        monkeypatch.setitem(sys.modules, module, stand_in)
    [description] = runpy.run_path(
        str(ROOT / f'launch/{name}_launch.py'))['generate_launch_description']()
    assert description[0] == ('MICROBOT_PARENT', str(os.getpid()))  # nodes end with the launcher
    scripts = {entry.name for entry in entry_points(group='console_scripts')}
    assert started
    for node in started:
        assert node['executable'] in scripts
        assert node['executable'] == f'{node["name"]}_node'
        known = node_class(node['name']).known_parameters()
        for parameters in node['parameters']:
            if isinstance(parameters, dict):
                assert set(parameters) <= set(known) | {'use_sim_time'}


@pytest.mark.parametrize('page', ['parameters', 'effects'])
def test_the_tables_in_the_docs_are_those_of_the_code(page) -> None:
    made = subprocess.run(
        [sys.executable, '-c', f'import build; print(build.{page}(), end="")'],
        cwd=ROOT / 'docs', capture_output=True, text=True, timeout=60, check=True)
    written = (ROOT / 'docs' / f'{page}.md').read_text()
    assert made.stdout == written, 'run `python docs/build.py`'
