"""`microbot emulate`: an amplifier on a pseudo-terminal, for trying the driver without one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from microbot_ros.drive.emulator import process


class _Within(click.FloatRange):
    """A range that NaN is not in, as it is in click's own."""

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> float:
        number: float = super().convert(value, param, ctx)
        return number if math.isfinite(number) else self.fail(f'{value} is no number', param, ctx)


@click.command('emulate')
@click.argument('protocol', type=click.Choice(list(process.DEVICES)))
@click.option('--link', type=click.Path(path_type=Path), required=True,
              help='Name under which a driver opens the line.')
@click.option('--log', type=click.Path(path_type=Path),
              help='File for one line of JSON per change of current.')
@click.option('--full-scale-A', 'full_scale_a', type=_Within(0, 1000, min_open=True),
              default=1.0, show_default=True, help='Current of a coil at full output.')
@click.option('--watchdog-ms', type=_Within(0, 60_000, min_open=True), default=100.0,
              show_default=True, help='Zero the coils this long after the last good command.')
@click.option('--no-watchdog', is_flag=True,
              help='Keep the last command for ever, as much laboratory firmware does.')
@click.option('--fault', 'faults', multiple=True, metavar='KIND[=VALUE][@START][+DURATION]',
              help='What goes wrong, when and for how long [s]; may be repeated. A single - reads '
                   'faults from standard input, one a line, as they come.')
def command(protocol: str, link: Path, log: Path | None, full_scale_a: float, watchdog_ms: float,
            no_watchdog: bool, faults: tuple[str, ...]) -> None:
    """Emulate an amplifier that speaks PROTOCOL on a pseudo-terminal, until Ctrl-C or SIGTERM.

    The device's watchdog is on, as in the project's reference firmware; --no-watchdog models
    the firmware that keeps the last command when its host dies. A host may leave and come back;
    the emulated device keeps its state meanwhile, its watchdog running.

    Faults: drop, flip, double (probability per byte), truncate (per message), delay (ms),
    silence, reset, wrong_reply, over_temperature, open (coil 1 to 4), unplug.

    \b
    Examples:
      microbot emulate serial_transfer --link /tmp/coils --log coils.jsonl
      microbot emulate serial_transfer --link /tmp/coils --fault flip=0.01 --fault unplug@5+2
    """
    watchdog_s = None if no_watchdog else watchdog_ms * 1e-3
    process.run(protocol, link, log, full_scale_a, watchdog_s, list(faults))
