"""Command `microbot doctor`: check whether this machine and the rig are ready."""

from __future__ import annotations

import getpass
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from microbot_ros.cli.options import PATH, json_option
from microbot_ros.common.errors import InputError

if TYPE_CHECKING:
    from microbot_ros.cameras.stream import FrameStream

_WATCH_SECONDS, _TICK_SECONDS, _LATE_MS = 2.0, 0.005, 10.0
"""Duration [s] of the test of the dead-man, its period [s] as in the driver, and the delay [ms]
that is reported. Choice: 10 ms is a tenth of the usual watchdog; a longer test finds rarer
delays."""
_CAMERA_SECONDS = 1.0
"""Duration [s] for which a camera is watched. Choice: some frames of a slow one."""
_ANY_BAUD = 115_200
"""Rate [1/s] at which a port is opened for the test; nothing is sent. Choice: any common rate."""
_UDEV_HINT = 'see "Low latency" in docs/explanation/safety.md for the udev rule that sets it'
_BUSY = [sys.executable, '-c', 'while True: pass']


class Finding(NamedTuple):
    """Result of one check.

    Attributes
    ----------
    what : str
        Its subject.
    level : str
        'ok', 'warn' or 'fail'.
    detail : str
        The result, and what to do.
    """

    what: str
    level: str
    detail: str


@click.command()
@click.option('--config', type=PATH,
              help='Check this rig too: its parameters, coils, port and camera.')
@json_option('Write the findings as JSON to this file.')
def command(config: Path | None, json_path: Path | None) -> None:
    """Check whether this machine, and with --config the rig, is ready. No current flows.

    \b
    Example:
      microbot doctor --config config/rig.yaml
    """
    from microbot_ros.common.files import write_json

    if config:
        _readable(config)
    marks = {'ok': click.style('ok  ', 'green'), 'warn': click.style('warn', 'yellow'),
             'fail': click.style('FAIL', 'red')}
    findings = []
    for finding in _look(config):
        findings.append(finding)
        click.echo(f'{marks[finding.level]} {finding.what}: {finding.detail}')
    write_json(json_path, [finding._asdict() for finding in findings])
    if any(finding.level == 'fail' for finding in findings):
        sys.exit(1)


def _readable(config: Path) -> None:
    """Raise InputError for a file that is not that of a rig, as the rig cannot be checked then."""
    from microbot_ros.nodes.configuration import read_rig

    read_rig(config)


def _look(config: Path | None) -> Iterator[Finding]:
    checks: list[Callable[[], Finding]] = [
        _python, _ros, _real_time, _dead_man, _shared_memory, _disk, _ports]
    if config:
        checks += [lambda: _rig(config), lambda: _camera(config), lambda: _watchdog(config),
                   lambda: _latency(config)]
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
    """Send a message through the middleware and back, as the nodes do."""
    from microbot_ros.nodes.client.graph_client import GraphClient

    with GraphClient('doctor') as client:
        name = client.echo()
    reach = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    return Finding('ros', 'ok', f'{name} echoes; discovery range {reach}')


def _real_time() -> Finding:
    """Request real-time priority in a thread, so that this process keeps its own."""
    from concurrent.futures import ThreadPoolExecutor

    from microbot_ros.common.real_time import set_realtime_priority

    with ThreadPoolExecutor(1) as pool:
        granted = pool.submit(set_realtime_priority).result()
    if granted:
        return Finding('real time', 'ok', 'granted: the loop has priority over other programs')
    return Finding('real time', 'warn', 'not granted: other programs can delay the loop; add '
                                        f'"{getpass.getuser()} - rtprio 10" to '
                                        '/etc/security/limits.conf and log in again')


def _dead_man() -> Finding:
    """Measure how late a thread like the driver's wakes while every core is busy."""
    from concurrent.futures import ThreadPoolExecutor

    from microbot_ros.common.real_time import lateness, set_realtime_priority

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
        f'with {os.cpu_count()} busy programs, woke at most {late_ms:.1f} ms late in '
        f'{_WATCH_SECONDS:g} s; a zero is later by this than command_timeout_ms of the '
        'coil_driver'
        + ('' if late_ms <= _LATE_MS else f', expected {_LATE_MS:g} ms: see real time above, '
                                          'and check what else runs in real time on this '
                                          'machine'))


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
    problems = [] if rig else [f'{config}: expected a section for each node to run']
    for node, name in (('coil_driver', 'port'), ('camera', 'source')):
        device = str(rig.get(node, {}).get(name, ''))
        if device.startswith('/') and not Path(device).exists():
            problems.append(f'{node}.{name} {device} does not exist')
    coils = ''
    if 'coil_driver' in rig:
        try:
            coils = '; ' + _coils(rig['coil_driver'].get('coils_file', ''))
        except InputError as error:
            problems.append(str(error))
    if problems:
        return Finding('rig', 'fail', '; '.join(problems))
    return Finding('rig', 'ok', f'{config}: {", ".join(rig)}{coils}')


def _camera(config: Path) -> Finding:
    """Open the camera as its node does, watch it for a moment, and close it."""
    from microbot_ros.cameras.camera import CameraSettings, camera_class, kind_of
    from microbot_ros.cameras.stream import FrameStream
    from microbot_ros.common.settings import defaults
    from microbot_ros.nodes.configuration import read_rig

    given = read_rig(config).get('camera')
    if given is None:
        return Finding('camera', 'ok', f'none in {config}')
    wanted = CameraSettings(**{
        name: value for name, value in given.items() if name in defaults(CameraSettings)})
    odd: list[str] = []
    try:
        kind = kind_of(given.get('camera', ''), wanted.source)
        stream = FrameStream(camera_class(kind)(wanted, odd.append))
        try:
            seen = _watch_camera(stream)
        finally:
            stream.close()
    except InputError as error:
        return Finding('camera', 'fail', str(error))
    form = stream.format
    return Finding(
        'camera', 'warn' if odd or stream.lost else 'ok',
        '; '.join([f'{kind} {wanted.source}: {form.width}×{form.height} {form.pixel_format}, '
                   f'{seen}, {stream.lost} lost', f'clock: {form.clock}', *odd]))


def _watch_camera(stream: FrameStream) -> str:
    """Return the frame rate of an opened stream; its end is no fault."""
    from microbot_ros.cameras.camera import EndOfFrames

    moments: list[float] = []
    end = time.monotonic() + _CAMERA_SECONDS
    with suppress(EndOfFrames):
        while time.monotonic() < end:
            if found := stream.read(0.1):
                moments.append(found[1])
    if len(moments) < 2:
        return f'{len(moments)} frames in {_CAMERA_SECONDS:g} s'
    return f'{(len(moments) - 1) / (moments[-1] - moments[0]):.1f} frames/s'


def _coils(file: str) -> str:
    """Return the coils of the driver as text; InputError if they cannot be used."""
    from microbot_ros.common.files import read_yaml
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
    from microbot_ros.drive.coil_driver import UNWATCHABLE, WITHOUT_FEEDBACK, WITHOUT_WATCHDOG
    from microbot_ros.drive.transport import has_descriptor
    from microbot_ros.nodes.configuration import read_rig

    given = read_rig(config).get('coil_driver', {})
    protocol = given.get('amplifier', 'serial_transfer')
    amplifier = amplifier_class(protocol)
    watchdog = amplifier.watchdog
    if (watchdog is Watchdog.UNCONFIRMED and not given.get('accept_no_watchdog')
            and not all(map(has_descriptor, str(given.get('port', '')).split(',')))):
        return Finding('watchdog', 'fail', f'{protocol} at {given["port"]}: {UNWATCHABLE}; it is '
                                           'driven only with coil_driver.accept_no_watchdog: true')
    if not amplifier.reads_back:
        accepted = given.get('accept_no_feedback')
        then = ('accepted' if accepted else
                'it is driven only with coil_driver.accept_no_feedback: true')
        return Finding('watchdog', 'warn' if accepted else 'fail',
                       f'{protocol} measures no currents: {WITHOUT_FEEDBACK}; {then}')
    if given.get('accept_no_watchdog') and watchdog is not Watchdog.ARMED:
        return Finding('watchdog', 'warn', f'{protocol}, accepted without a watchdog: '
                                           f'{WITHOUT_WATCHDOG}')
    if watchdog is Watchdog.NONE:
        return Finding('watchdog', 'fail', f'{protocol} has no watchdog: {WITHOUT_WATCHDOG}; it '
                                           'is driven only with coil_driver.accept_no_watchdog: '
                                           'true')
    return Finding('watchdog', 'ok', f'{protocol}: {watchdog.value}')


def _latency(config: Path) -> Finding:
    """Open the port of the amplifier, as the driver does, and close it; nothing is sent."""
    from microbot_ros.drive.errors import AmplifierError, PortBusyError
    from microbot_ros.nodes.configuration import read_rig

    ports = str(read_rig(config).get('coil_driver', {}).get('port', '')).split(',')
    told, level = [], 'ok'
    for port in filter(None, ports):
        try:
            slow, sentence = _asked_for_low_latency(port)
        except PortBusyError:
            slow, sentence = False, 'in use, not checked'
        except AmplifierError as error:
            slow, sentence = True, f'not checked, {str(error).removeprefix(f"{port}: ")}'
        level = 'warn' if slow else level
        told.append(f'{port}: {sentence}')
    return Finding('low latency', level, '; '.join(told) or 'no port configured')


def _asked_for_low_latency(port: str) -> tuple[bool, str]:
    """Return whether an adapter is slower than it could be, and the result as text."""
    from microbot_ros.drive.low_latency import latency_timer_ms
    from microbot_ros.drive.transport import Port

    line = Port(port, _ANY_BAUD)
    try:
        granted, held_ms = line.low_latency, latency_timer_ms(port)
    finally:
        line.close()
    if held_ms is not None and held_ms > 1:
        return True, (f'the adapter delays answers by up to {held_ms} ms, low latency was '
                      + ('granted without effect' if granted else 'refused')
                      + f'; {_UDEV_HINT}')
    if held_ms is not None:
        return False, f'answers are delayed by at most {held_ms} ms'
    return False, ('low latency granted' if granted else 'low latency refused') + (
        ', and no latency timer that could delay answers')
