"""`microbot doctor`: is this machine ready, is the rig?"""

from __future__ import annotations

import getpass
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import click

from microbot_ros.errors import InputError

_WATCH_SECONDS, _TICK_SECONDS, _LATE_MS = 2.0, 0.005, 10.0
_BUSY = [sys.executable, '-c', 'while True: pass']


class Finding(NamedTuple):
    """One thing that was looked at: its `level`, 'ok', 'warn' or 'fail', and in `detail` what was
    found and what to do about it."""

    what: str
    level: str
    detail: str


@click.command()
@click.option('--config', type=click.Path(path_type=Path),
              help='Also check this rig: its parameters, coils, port and camera.')
@click.option('--json', 'json_path', type=click.Path(path_type=Path),
              help='Also write the findings as JSON.')
def command(config: Path | None, json_path: Path | None) -> None:
    """Say whether this machine, and with --config the rig, is ready. Moves no current.

    \b
    Example:
      microbot doctor --config config/rig.yaml
    """
    import json

    from rich.console import Console

    from microbot_ros.files import write_text

    if config:
        _readable(config)
    marks = {'ok': '[green]ok  [/]', 'warn': '[yellow]warn[/]', 'fail': '[red]FAIL[/]'}
    console = Console(highlight=False, soft_wrap=True)
    findings = []
    for finding in _look(config):
        findings.append(finding)
        console.print(f'{marks[finding.level]} {finding.what}: {finding.detail}')
    if json_path:
        entries = [finding._asdict() for finding in findings]
        write_text(json_path, json.dumps(entries, indent=1, ensure_ascii=False) + '\n')
    if any(finding.level == 'fail' for finding in findings):
        sys.exit(1)


def _readable(config: Path) -> None:
    """InputError for a file that is not that of a rig: nothing can be said of that rig."""
    from microbot_ros.nodes.configuration import read_rig

    read_rig(config)


def _look(config: Path | None) -> Iterator[Finding]:
    checks: list[Callable[[], Finding]] = [
        _python, _ros, _real_time, _dead_man, _shared_memory, _disk, _ports]
    if config:
        checks += [lambda: _rig(config), lambda: _watchdog(config)]
    for check in checks:
        try:
            yield check()
        except InputError as error:
            yield Finding(check.__name__.strip('_<>').replace('lambda', 'rig'), 'fail', str(error))


def _python() -> Finding:
    version = '.'.join(map(str, sys.version_info[:3]))
    good = (3, 11) <= sys.version_info[:2] <= (3, 12)
    return Finding('python', 'ok' if good else 'warn', f'{version}, {os.cpu_count()} cores')


def _ros() -> Finding:
    """A message through the middleware and back, as the nodes send theirs."""
    from microbot_ros.nodes.graph_client import GraphClient

    with GraphClient('doctor') as client:
        name = client.echo()
    reach = os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE']
    return Finding('ros', 'ok', f'{name} echoes; discovery range {reach}')


def _real_time() -> Finding:
    """Tried in a thread, so that this process stays an ordinary one."""
    from concurrent.futures import ThreadPoolExecutor

    from microbot_ros.drive.real_time import set_realtime_priority

    with ThreadPoolExecutor(1) as pool:
        granted = pool.submit(set_realtime_priority).result()
    if granted:
        return Finding('real time', 'ok', 'granted: the loop comes before all else here')
    return Finding('real time', 'warn', 'not granted: other programs can hold up the loop; add '
                   f'"{getpass.getuser()} - rtprio 10" to /etc/security/limits.conf and log in '
                   'again')


def _dead_man() -> Finding:
    """How late a thread like the one that zeroes the coils wakes while every core is busy."""
    from concurrent.futures import ThreadPoolExecutor

    from microbot_ros.drive.real_time import lateness, set_realtime_priority

    def watch() -> float:
        set_realtime_priority()
        return max(lateness(_WATCH_SECONDS, _TICK_SECONDS))

    with ExitStack() as stack, ThreadPoolExecutor(1) as pool:
        for _ in range(os.cpu_count() or 1):
            busy = stack.enter_context(subprocess.Popen(_BUSY))
            stack.callback(busy.kill)
        late_ms = pool.submit(watch).result() * 1e3
    return Finding(
        'dead-man', 'ok' if late_ms <= _LATE_MS else 'warn',
        f'beside {os.cpu_count()} busy programs woke at most {late_ms:.1f} ms late in '
        f'{_WATCH_SECONDS:g} s; a zero comes so much later than command_timeout_ms of the '
        'coil_driver says'
        + ('' if late_ms <= _LATE_MS else f', expected {_LATE_MS:g} ms: see real time above, and '
           'what else of this machine runs in real time'))


def _shared_memory() -> Finding:
    free = shutil.disk_usage('/dev/shm').free / 1e6
    if free < 200:
        return Finding('shared memory', 'warn', f'{free:.0f} MB free on /dev/shm, expected 200; '
                       'remove stale /dev/shm/fastrtps_* or enlarge it')
    return Finding('shared memory', 'ok', f'{free:.0f} MB free')


def _disk() -> Finding:
    free = shutil.disk_usage('.').free / 1e9
    level = 'ok' if free > 5 else 'warn'
    return Finding('disk', level, f'{free:.0f} GB free here; frames of 640×480 at 60 Hz take '
                   'about 4 GB in 5 minutes')


def _ports() -> Finding:
    from serial.tools import list_ports

    found = [f'{port.device} ({port.description})' for port in list_ports.comports()]
    closed = [port.device for port in list_ports.comports()
              if not os.access(port.device, os.R_OK | os.W_OK)]
    if closed:
        return Finding('serial ports', 'warn', f'no permission for {", ".join(closed)}; '
                       'add yourself to the group dialout')
    return Finding('serial ports', 'ok', ', '.join(found) or 'none here')


def _rig(config: Path) -> Finding:
    from microbot_ros.nodes.configuration import read_rig

    rig = read_rig(config)
    problems = []
    for node, name in (('coil_driver', 'port'), ('camera', 'source')):
        device = str(rig.get(node, {}).get(name, ''))
        if device.startswith('/') and not Path(device).exists():
            problems.append(f'{node}.{name} {device} is not there')
    coils = ''
    if 'coil_driver' in rig:
        try:
            coils = '; ' + _coils(rig['coil_driver'].get('coils_file', ''))
        except InputError as error:
            problems.append(str(error))
    if problems:
        return Finding('rig', 'fail', '; '.join(problems))
    return Finding('rig', 'ok', f'{config}: {", ".join(rig)}{coils}')


def _coils(file: str) -> str:
    """Whose coils the driver makes its currents by; InputError where it cannot."""
    from microbot_ros.files import read_yaml
    from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings

    coils = CoilSet(read_yaml(file, CoilSettings) if file else None)
    try:
        Allocator(coils)
    except InputError as error:
        raise InputError(file, str(error)) from None
    if not file:
        return 'coils of the default rig, for there is no coils_file'
    return f'coils of {file}: {len(coils.names)}, for fields along {"xyz"[:coils.axes]}'


def _watchdog(config: Path) -> Finding:
    from microbot_ros.drive.amplifier import Watchdog, amplifier_class
    from microbot_ros.drive.coil_driver import WITHOUT_WATCHDOG
    from microbot_ros.nodes.configuration import read_rig

    given = read_rig(config).get('coil_driver', {})
    protocol = given.get('amplifier', 'serial_transfer')
    watchdog = amplifier_class(protocol).watchdog
    if given.get('accept_no_watchdog') and watchdog is not Watchdog.ARMED:
        return Finding('watchdog', 'warn', f'{protocol}, accepted without one: {WITHOUT_WATCHDOG}')
    if watchdog is Watchdog.NONE:
        return Finding('watchdog', 'fail', f'{protocol} has none: {WITHOUT_WATCHDOG}; it is not '
                       'driven unless coil_driver.accept_no_watchdog says that this is accepted')
    return Finding('watchdog', 'ok', f'{protocol}: {watchdog.value}')
