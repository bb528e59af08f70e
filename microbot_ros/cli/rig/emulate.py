"""Command `microbot emulate`: an amplifier on a pseudo-terminal, to test without one."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from microbot_ros.cli.options import NEW_FILE, PATH, FiniteFloatRange
from microbot_ros.drive.emulator import process

_WATCHDOG_MS = 100.0
"""Watchdog time [ms] by default, that of the reference firmware."""


@click.command('emulate')
@click.argument('protocol', type=click.Choice(list(process.DEVICES)))
@click.option('--link', type=PATH, required=True,
              help='Path under which a driver opens the line.')
@click.option('--log', type=NEW_FILE,
              help='File for one line of JSON per change of current.')
@click.option('--full-scale-A', 'full_scale_a', type=FiniteFloatRange(0, 1000, min_open=True),
              default=1.0, show_default=True, help='Current of a coil at full output.')
@click.option('--channels', type=click.IntRange(1, 16), default=4, show_default=True,
              help='Number of coils; serial_transfer at most 6.')
@click.option('--watchdog-ms', type=FiniteFloatRange(0, 60_000, min_open=True),
              help='Zero the coils this long after the last good command.  [default: 100]')
@click.option('--no-watchdog', is_flag=True,
              help='Hold the last command indefinitely (no watchdog), as much laboratory firmware '
                   'does.')
@click.option('--leave-nothing', is_flag=True,
              help='At the end delete the log and, if empty, the folder of the link.')
@click.option('--fault', 'faults', multiple=True, metavar='KIND[=VALUE][/LINE][@START][+DURATION]',
              help='Fault, with its line (1, 2, …; default: all), start and duration [s]; may be '
                   'repeated. A single - reads faults from standard input, one per line, at any '
                   'time.')
def command(protocol: str, link: Path, log: Path | None, full_scale_a: float,
            channels: int, watchdog_ms: float | None, no_watchdog: bool, leave_nothing: bool,
            faults: tuple[str, ...]) -> None:
    """Emulate an amplifier that speaks PROTOCOL on a pseudo-terminal, until a signal.

    It ends on Ctrl-C, SIGTERM or SIGHUP.

    The watchdog of a serial_transfer board is on, as in the project's reference firmware;
    --no-watchdog models firmware that keeps the last command when its host dies. Of the other
    protocols roboclaw, roboteq and sabertooth arm one, scpi and modbus have none.

    A host may disconnect and return; the device keeps its state meanwhile, and its watchdog keeps
    running. A protocol with several ports uses the links PATH-1, PATH-2 and so on.

    Faults: drop, flip, double (probability per byte), truncate (per message), delay (ms), silence,
    reset, wrong_reply, over_temperature, open, reversed, half_gain (of a coil), unplug.

    \b
    Examples:
      microbot emulate serial_transfer --link /tmp/coils --log coils.jsonl
      microbot emulate serial_transfer --link /tmp/coils --fault flip=0.01 --fault unplug@5+2
    """
    if no_watchdog + (watchdog_ms is not None) > (protocol == 'serial_transfer'):
        raise click.UsageError('expected either --watchdog-ms or --no-watchdog, and for '
                               'serial_transfer only')
    if protocol == 'serial_transfer' and channels > 6:
        raise click.UsageError('expected at most 6 channels of a serial_transfer board')
    watchdog_s = None if no_watchdog else (watchdog_ms or _WATCHDOG_MS) * 1e-3
    process.run(protocol, link, log, full_scale_a, watchdog_s, list(faults), channels)
    if leave_nothing:
        if log is not None:
            log.unlink(missing_ok=True)
        with suppress(OSError):  # the folder is not empty
            link.parent.rmdir()
