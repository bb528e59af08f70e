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
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import lowest
import pytest
import release
import yaml

import microbot_ros
from microbot_ros.common.errors import InputError
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


@pytest.mark.rig
def test_colcon_knows_what_it_is() -> None:
    listed = subprocess.run(
        [BIN / 'colcon', 'list', '--base-paths', str(ROOT)], cwd=ROOT, env=_environment(),
        capture_output=True, text=True, timeout=60, check=True)
    assert re.search(r'^microbot_ros\s+\S+\s+\(ros\.ament_python\)$', listed.stdout, re.MULTILINE)


@pytest.mark.rig
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


@pytest.mark.rig
def test_colcon_runs_the_tests(workspace: Path) -> None:
    """With nobody told that they are pytest's it looked for unittest's, found none and was happy.
    """
    tests = workspace / 'src' / 'microbot_ros' / 'test'
    tests.mkdir()
    (tests / 'test_two.py').write_text('def test_one():\n    pass\n\ndef test_two():\n    pass\n')
    for words in (['test', '--base-paths', 'src'], ['test-result', '--verbose', '--all']):
        done = subprocess.run([BIN / 'colcon', *words], cwd=workspace, env=_environment(),
                              capture_output=True, text=True, timeout=100)
        assert done.returncode == 0, done.stdout + done.stderr
    assert 'Summary: 2 tests, 0 errors, 0 failures' in done.stdout


# What the extra `test` doesn't bring, by the names under which it is imported.
MORE = ('axe_playwright_python', 'dask', 'distributed', 'duckdb', 'furo', 'gymnasium', 'magpylib',
        'mm_test_adapters', 'myst_parser', 'onnx', 'onnxruntime', 'playwright', 'polars',
        'pyarrow', 'pymmcore', 'pypylon', 'pysindy', 'sphinx', 'starlette', 'trackpy', 'uvicorn')
NEED_MORE = ('archive/test_batch', 'archive/test_cluster', 'archive/test_imports',
             'control/test_policy',
             'magnetics/test_allocation', 'magnetics/test_shapes', 'magnetics/test_sources',
             'nodes/test_calibrated_coils')
WITHOUT = """
import sys
from importlib.machinery import PathFinder
missing, known = sys.argv.pop(1).split(','), PathFinder.find_spec
PathFinder.find_spec = classmethod(lambda _, name, *more: (
    None if name.partition('.')[0] in missing else known(name, *more)))
import pytest
sys.exit(pytest.main(sys.argv[1:]))
"""


@pytest.mark.rig
@pytest.mark.timeout(300)
def test_all_tests_are_found_where_only_the_extra_for_them_is() -> None:
    """`colcon test` counts what pytest collects: what needs more than that is skipped."""
    found = subprocess.run(
        [sys.executable, '-c', WITHOUT, ','.join(MORE), '--collect-only', '-qq',
         '-p', 'pytest_timeout', '-o', 'addopts=--import-mode=importlib', str(ROOT / 'test')],
        cwd=ROOT, env={**os.environ, 'CI': '', 'PYTEST_DISABLE_PLUGIN_AUTOLOAD': '1'},
        capture_output=True, text=True, timeout=280)
    assert found.returncode == 0, found.stdout[-2000:] + found.stderr
    here = {str(path.relative_to(ROOT)) for path in (ROOT / 'test').rglob('test_*.py')}
    missing = here - set(re.findall(r'^(test/\S+\.py): [1-9]\d*$', found.stdout, re.MULTILINE))
    assert {file for file in missing if not file.startswith(('test/cockpit/', 'test/gym/'))} == {
        f'test/{name}.py' for name in NEED_MORE}


@pytest.mark.rig
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
    assert 'camera: expected the parameter source' in node.stderr


def test_versions_agree() -> None:
    package = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    setup = re.search(r"version='([^']+)'", (ROOT / 'setup.py').read_text())
    assert setup is not None
    assert package == setup.group(1) == microbot_ros.__version__


def test_each_criterion_of_a_release_is_evaluated_or_has_a_judge() -> None:
    criteria = release.criteria()
    assert len(criteria) == len(release.CHECKS)
    for criterion in criteria:
        assert [begin for begin in release.CHECKS if criterion.startswith(begin)], criterion


# Where the key of rosdep is not python3- and the name on PyPI.
KEYS = {'opencv-python-headless': 'python3-opencv', 'pyserial': 'python3-serial',
        'pyyaml': 'python3-yaml'}


def test_rosdep_installs_the_core_from_ubuntu() -> None:
    """At most eight libraries beyond ROS, each with a key; no key that calls pip."""
    keys = {item.text or '' for item in ElementTree.parse(ROOT / 'package.xml').iter()
            if item.tag.endswith('_depend')}
    names = {re.split('[=<>]', name)[0] for name in lowest.core()}
    assert {KEYS.get(name, f'python3-{name}') for name in names} == {
        key for key in keys if key.startswith('python3-')} - {
            'python3-hypothesis', 'python3-psutil', 'python3-pytest', 'python3-pytest-timeout'}
    assert len(names) <= 8
    assert not any(key.endswith('-pip') for key in keys)


def test_rosdep_resolves_every_key_to_a_package_of_apt(tmp_path: Path) -> None:
    """`rosdep install --simulate` with the index that is kept in test/data/rosdep."""
    index = ROOT / 'test' / 'data' / 'rosdep'
    (tmp_path / '20-default.list').write_text(f'yaml file://{index}/keys.yaml\n')
    # --ignore-src leaves out what AMENT_PREFIX_PATH has: the wheels of ROS.
    environment = {**_environment(), 'AMENT_PREFIX_PATH': str(tmp_path),
                   'ROS_HOME': str(tmp_path / 'home'), 'ROSDEP_SOURCE_PATH': str(tmp_path),
                   'ROSDISTRO_INDEX_URL': f'file://{index}/index-v4.yaml'}

    def rosdep(*words: str) -> str:
        done = subprocess.run([BIN / 'rosdep', *words, '--rosdistro', 'jazzy'], cwd=tmp_path,
                              env=environment, capture_output=True, text=True, timeout=100)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    shutil.copy(ROOT / 'package.xml', tmp_path)
    rosdep('update')
    said = rosdep('install', '--simulate', '--reinstall', '--from-paths', '.', '--ignore-src',
                  '--os', 'ubuntu:noble', '-y')
    assert re.findall(r'^#\[(\w+)\]', said, re.MULTILINE) == ['apt']
    keys = {item.text or '' for item in ElementTree.parse(ROOT / 'package.xml').iter()
            if item.tag.endswith('_depend')}
    assert set(re.findall(r'apt-get install -y (\S+)$', said, re.MULTILINE)) == {
        key if key.startswith('python3-') else f'ros-jazzy-{key.replace("_", "-")}'
        for key in keys}


class Launched:
    """A launch file as it is run. launch is not on PyPI: its classes are stood in for by ones that
    keep their arguments.
    """

    def __init__(self, name: str, monkeypatch: pytest.MonkeyPatch, **given: str) -> None:
        self.nodes: list[dict[str, Any]] = []
        self.commands: list[list[Any]] = []
        self.delayed: list[Any] = []
        self._given = given
        stand_in: Any = types.ModuleType('stand_in')
        for kind in ('LaunchDescription', 'DeclareLaunchArgument', 'ParameterValue',
                     'SetEnvironmentVariable', 'LaunchContext'):
            setattr(stand_in, kind, lambda *arguments, **_: arguments)
        stand_in.LaunchConfiguration = lambda name: types.SimpleNamespace(
            perform=lambda context: context[name])
        stand_in.OpaqueFunction = lambda function: self.delayed.append(function)
        stand_in.ExecutableInPackage = lambda **arguments: arguments
        stand_in.Shutdown = lambda **_: 'shutdown'
        stand_in.ExecuteProcess = lambda cmd, **_: self.commands.append(cmd)
        stand_in.LifecycleNode = lambda **arguments: self.nodes.append(arguments)
        stand_in.get_package_share_directory = lambda _: str(ROOT)
        for module in ('launch', 'launch.actions', 'launch.substitutions', 'launch_ros',
                       'launch_ros.actions', 'launch_ros.parameter_descriptions',
                       'launch_ros.substitutions', 'ament_index_python',
                       'ament_index_python.packages'):
            monkeypatch.setitem(sys.modules, module, stand_in)
        [self.description] = runpy.run_path(
            str(ROOT / f'launch/{name}_launch.py'))['generate_launch_description']()

    def start(self) -> Launched:
        """What is only decided when it is run."""
        for function in self.delayed:
            function(self._given)
        return self


EXAMPLE = {'config': str(ROOT / 'config' / 'rig.yaml'), 'namespace': '/'}


def test_the_demo_makes_nothing_until_it_runs(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--show-args` only asks for the description."""
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    demo = Launched('demo', monkeypatch)
    assert not list(tmp_path.iterdir())
    [command] = demo.start().commands
    assert command[:3] == [
        {'executable': 'microbot', 'package': 'microbot_ros'}, 'emulate', 'serial_transfer']
    assert len(list(tmp_path.iterdir())) == 1


def test_a_rig_is_the_nodes_that_its_file_names(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = tmp_path / 'rig.yaml'
    config.write_text('/**/camera: {ros__parameters: {source: here}}\n/rig_2/tracker: {}\n')
    for namespace, nodes in (('/rig_2', ['camera', 'tracker']), ('rig_3', ['camera'])):
        rig = Launched('rig', monkeypatch, config=str(config), namespace=namespace).start()
        assert [node['name'] for node in rig.nodes] == nodes
        assert {node['namespace'] for node in rig.nodes} == {f'/{namespace.strip("/")}'}
    with pytest.raises(InputError, match='expected a readable YAML file'):
        Launched('rig', monkeypatch, config='nowhere.yaml', namespace='/').start()


def test_a_replay_ends_with_its_player(monkeypatch: pytest.MonkeyPatch) -> None:
    [player] = [node for node in Launched('replay', monkeypatch).nodes if node['name'] == 'player']
    assert player['on_exit'] == 'shutdown'


@pytest.mark.parametrize('name', ['rig', 'demo', 'replay'])
def test_launch_files_start_nodes_with_parameters_that_exist(
        name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    launched = Launched(name, monkeypatch, **EXAMPLE).start()
    started, description = launched.nodes, launched.description
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


@pytest.mark.timeout(600)
def test_launch_starts_the_demo_and_ends_it() -> None:
    """ROS's own tool for it, which is where ROS is installed."""
    if find_spec('launch_testing') is None:
        pytest.skip('launch_testing comes with an installation of ROS, not from PyPI')
    done = subprocess.run(
        [sys.executable, '-m', 'launch_testing.launch_test', ROOT / 'test/launch/demo_launch.py'],
        cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr


def test_what_rviz_shows_is_what_the_nodes_send() -> None:
    """RViz is not on PyPI: its frame and its topics are held against the nodes'."""
    from microbot_ros.nodes.base.messages import WORKSPACE
    from microbot_ros.nodes.base.topics import TOPICS

    shown = yaml.safe_load((ROOT / 'config' / 'rig.rviz').read_text())['Visualization Manager']
    assert shown['Global Options']['Fixed Frame'] == WORKSPACE
    topics = [item['Topic']['Value'] for item in shown['Displays'] + shown['Tools']
              if 'Topic' in item]
    assert len(topics) == 3
    assert {topic.removeprefix('/') for topic in topics} <= TOPICS.keys()
