"""The child that discovers: started once, followed, ended; what a page is shown of its result."""

from __future__ import annotations

import asyncio
import json
import stat
import sys
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import psutil
import pytest

from microbot_ros.cockpit.discovery import Discovery, summary
from microbot_ros.cockpit.rig import RefusedError

pytestmark = pytest.mark.rig

RESULT = {
    'verdict': 'named', 'decided': 'settled', 'minutes': 6.1,
    'effects': [{'id': 'alignment_lag', 'parameters': {
        'tau_s': {'value': 0.3, 'std': 0.01, 'low_95': 0.28, 'high_95': 0.32}}},
                {'id': 'uniform_drift'}],
    'gap': {'before_um': 0.38, 'after_um': 0.11}, 'next_experiment': 'repeat at two magnitudes',
    'experiments': [{'odds': {'': 0.5}}, {'odds': {'alignment_lag': 0.92}}],
    'learned': [{'against': 'position', 'sentence': 'A swirl.',
                 'arrows': [[1.0, 2.0, 0.5, -0.5]]}]}


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Runs a program in place of `microbot discover`; its arguments are those of that."""
    def put(program: str) -> None:
        file = tmp_path / 'stand_in'
        file.write_text(f'#!{sys.executable}\nimport json, os, signal, sys, time\n'
                        f'from pathlib import Path\n'
                        f'out = Path(sys.argv[sys.argv.index("--out") + 1])\n{program}\n')
        file.chmod(file.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setattr('microbot_ros.cockpit.discovery.sys.executable', str(file))
    return put


def apart(work: Coroutine[Any, Any, Any]) -> Any:
    """What comes of it in a thread of its own: a browser's driver leaves a loop in this one."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, work).result()


async def ended(discovery: Discovery) -> dict[str, Any]:
    """Its state once it has ended."""
    async with asyncio.timeout(20.0):
        while discovery.running:
            await asyncio.sleep(0.01)
    state = discovery.state({})
    assert state is not None
    return state


def test_a_rig_that_is_not_armed_is_refused_at_once(stand_in: Any, tmp_path: Path) -> None:
    stand_in('time.sleep(60)')

    async def run() -> None:
        discovery = Discovery('/', tmp_path / 'found')
        for state in ('disarmed', 'fault', 'unknown', None):
            with pytest.raises(RefusedError, match='not armed'):
                await discovery.start(1.0, state)
        assert not discovery.running
    apart(run())


def test_odds_and_time_left_are_shown_while_it_drives(stand_in: Any, tmp_path: Path) -> None:
    stand_in('out.mkdir(parents=True)\n'
             'found = {"odds": {"alignment_lag": 0.92, "": 0.075}}\n'
             '(out / "progress.json").write_text(json.dumps(found))\n'
             'print("lag or delay: turns of 180°", flush=True); time.sleep(60)')

    async def run() -> dict[str, Any]:
        discovery = Discovery('/', tmp_path / 'found')
        await discovery.start(2.0, 'armed')
        async with asyncio.timeout(20.0):
            while (state := discovery.state({}) or {})['sentence'] == 'starting':
                await asyncio.sleep(0.01)
        await discovery.end()
        return state
    state = apart(run())
    assert state['sentence'] == 'lag or delay: turns of 180°'
    assert state['odds'] == {'alignment_lag': 0.92, '': 0.075}
    assert 90 < state['left_s'] <= 120
    assert state['folder'].startswith(str(tmp_path / 'found'))


def test_the_report_is_linked_and_no_other_file_is_served(stand_in: Any, tmp_path: Path) -> None:
    stand_in('out.mkdir(parents=True); (out / "report.html").write_text("found")')

    async def run() -> tuple[Discovery, dict[str, Any]]:
        discovery = Discovery('/', tmp_path / 'found')
        await discovery.start(1.0, 'armed')
        return discovery, await ended(discovery)
    discovery, state = apart(run())
    name = state['report'].split('/')[2]
    assert state['report'] == f'/discoveries/{name}/report.html'
    path = discovery.report(name)
    assert path is not None
    assert path.read_text() == 'found'
    (tmp_path / 'report.html').write_text('no')
    assert discovery.report('..') is None
    assert discovery.report('other') is None


def test_its_end_is_what_result_json_says(stand_in: Any, tmp_path: Path) -> None:
    stand_in(f'out.mkdir(parents=True); print("looking around: steps", file=sys.stderr)\n'
             f'(out / "result.json").write_text({json.dumps(RESULT)!r})\n'
             'print("named: alignment_lag", " ".join(sys.argv[1:]))')

    async def run() -> dict[str, Any]:
        discovery = Discovery('/rig_2', tmp_path / 'found')
        assert discovery.state({}) is None
        before = discovery.state(RESULT)
        assert before is not None
        assert (before['running'], before['effect']) == (False, 'alignment_lag')
        await discovery.start(6.0, 'armed')
        with pytest.raises(RefusedError, match='already'):
            await discovery.start(6.0, 'armed')
        assert discovery.running
        return await ended(discovery)
    state = apart(run())
    assert state == {
        'running': False, 'left_s': None, 'of_s': 360.0, 'folder': state['folder'], 'report': None,
        'sentence': state['sentence'], 'verdict': 'named', 'decided': 'settled',
        'effect': 'alignment_lag', 'gap_um': 0.11, 'odds': {'alignment_lag': 0.92},
        'sizes': [{'name': 'tau', 'unit': 's', 'value': 0.3, 'half': pytest.approx(0.02)}],
        'minutes': 6.1, 'next': 'repeat at two magnitudes',
        'learned': [{'sentence': 'A swirl.', 'arrows': [[1.0, 2.0, 0.5, -0.5]]}]}
    assert 'discover --drive --minutes 6' in state['sentence']
    assert '--namespace /rig_2' in state['sentence']


def test_two_requests_at_once_start_one(stand_in: Any, tmp_path: Path) -> None:
    stand_in(f'Path({str(tmp_path)!r}, str(os.getpid())).touch(); time.sleep(600)')

    async def run() -> tuple[list[Any], list[Path]]:
        discovery = Discovery('/', tmp_path / 'found')
        asked = await asyncio.gather(*(discovery.start(1.0, 'armed') for _ in range(5)),
                                     return_exceptions=True)
        async with asyncio.timeout(20.0):
            while not (started := [one for one in tmp_path.iterdir() if one.name.isdigit()]):
                await asyncio.sleep(0.01)
        await discovery.end()
        return asked, started
    asked, started = apart(run())
    assert [isinstance(one, RefusedError) for one in asked].count(True) == 4
    assert len(started) == 1


def test_one_that_is_being_started_ends_with_the_server(stand_in: Any, tmp_path: Path) -> None:
    stand_in('time.sleep(600)')

    async def run() -> Discovery:
        discovery = Discovery('/', tmp_path)
        starting = asyncio.create_task(discovery.start(1.0, 'armed'))
        await asyncio.sleep(0)
        await discovery.end()
        await starting
        with pytest.raises(RefusedError, match='ending'):
            await discovery.start(1.0, 'armed')
        return discovery
    assert not apart(run()).running


def test_a_refusal_is_shown_in_its_own_words(stand_in: Any, tmp_path: Path) -> None:
    stand_in('sys.exit("microbot: coil_driver: the gate is disarmed")')

    async def run() -> dict[str, Any]:
        discovery = Discovery('/', tmp_path)
        await discovery.start(1.0, 'armed')
        return await ended(discovery)
    state = apart(run())
    assert state['sentence'] == 'ended with status 1: microbot: coil_driver: the gate is disarmed'
    assert state['verdict'] is None


def test_told_to_end_it_may_write_and_at_the_end_nothing_is_left(
        stand_in: Any, tmp_path: Path) -> None:
    """Neither it nor a child of its own, though that ignores the signal."""
    stand_in("""
child = os.fork()
if not child:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    time.sleep(600)
def end(*_):
    print('stopped on request', flush=True)
    sys.exit(0)
signal.signal(signal.SIGTERM, end)
print(child, flush=True)
while True:
    time.sleep(0.1)
""")

    async def run() -> int:
        discovery = Discovery('/', tmp_path)
        with pytest.raises(RefusedError, match='not driving'):
            await discovery.stop()
        await discovery.start(1.0, 'armed')
        while not (told := str((discovery.state({}) or {})['sentence'])).isdigit():
            await asyncio.sleep(0.01)
        await discovery.stop()
        while (discovery.state({}) or {})['sentence'] != 'stopped on request':
            await asyncio.sleep(0.01)
        await discovery.end()
        return int(told)
    child = apart(run())
    deadline = time.monotonic() + 10.0
    while psutil.pid_exists(child) and psutil.Process(child).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize('result', [{}, {'effects': [], 'gap': None, 'experiments': []}])
def test_a_result_of_little_is_shown(result: dict[str, Any]) -> None:
    found = summary(result)
    assert found['effect'] is None
    assert found['sizes'] == []
    assert found['odds'] == {}
