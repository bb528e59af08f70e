"""The `microbot` command: one file per command, imported only when it is called.

Examples
--------
>>> from click.testing import CliRunner
>>> from microbot_ros.cli import microbot
>>> CliRunner().invoke(microbot, ['fit', '--help']).output.splitlines()[0]
'Usage: microbot fit [OPTIONS] SESSION'
"""

from __future__ import annotations

import errno
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import click

from microbot_ros import __version__
from microbot_ros.common import extras
from microbot_ros.common.errors import InputError, ReportError, RigError, one_line

# Errors of a path given by the user, and of a disk.
_WRONG_PLACE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT, errno.ENOTDIR, errno.EISDIR,
                errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP)
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)

_CLEAN_UP_S = 20
"""Time [s] that a command has to clean up when it is ended. Choice: more than the 15 s of the
nodes."""

# Command → the module that defines `command`, and one line for `microbot --help`.
_COMMANDS = {
    'demo': ('demo.demo', 'Run the closed loop on the virtual rig.'),
    'run': ('rig.run', 'Run the nodes beside a real rig.'),
    'cockpit': ('rig.cockpit', "Open the operator's page of a running rig."),
    'replay': ('replay.replay', 'Play a recording on its topics.'),
    'record': ('rig.record', 'Start and stop a recording of a running rig.'),
    'arm': ('rig.arm', 'Arm or disarm the gate of a running rig.'),
    'set': ('rig.set', 'Change a parameter of a running node.'),
    'goal': ('rig.goal', 'Send goals to the running controller.'),
    'track': ('track.track', 'Track the particles of a video or of images.'),
    'simulate': ('simulate', 'Simulate particles, camera and hidden effects as a session.'),
    'discover': ('discover.discover', 'Find, name and add the effect that the model is missing.'),
    'batch': ('batch', 'Track, fit, discover or import all recordings of an archive.'),
    'response': ('response', 'Measure speed and slip at each plateau of the command.'),
    'fit': ('fit', 'Fit v, φ and F of every particle of a session.'),
    'paper': ('paper', "Repeat the paper's experiment and compare with its numbers."),
    'import': ('import_', 'Convert the tables of a laboratory into a session.'),
    'info': ('info', 'Show what is in a session or recording.'),
    'doctor': ('rig.doctor', 'Check whether this machine and the rig are ready.'),
    'calibrate': ('calibrate.calibrate', 'Determine constants of the rig from measurements.'),
    'reach': ('reach', 'Compute what particles under one field can and cannot reach.'),
    'emulate': ('rig.emulate', 'Emulate an amplifier on a pseudo-terminal.'),
}


class _LazyGroup(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module = importlib.import_module(f'microbot_ros.cli.{_COMMANDS[cmd_name][0]}')
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section('Commands'):
            formatter.write_dl([(name, line) for name, (_, line) in _COMMANDS.items()])


@click.group(cls=_LazyGroup, context_settings={'help_option_names': ['-h', '--help']})
@click.version_option(__version__)
def microbot() -> None:
    """Closed-loop coil control of magnetic microrobots, from the microscope to the amplifier."""


def main() -> None:
    """Run the command line and exit.

    The exit status is 0 if done, 1 if failed, 2 for bad input, with one line on standard error.
    """
    # For matrices of a hundred rows several threads take four times the processor time, and leave
    # none to other processes of a rig. OpenBLAS reads this when the command imports numpy.
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    try:
        with _cleaned_up_on(signal.SIGTERM, signal.SIGHUP):
            status = microbot.main(standalone_mode=False)
    except InputError as error:
        status = _failed('microbot', str(error), 2)
    except (RigError, ReportError) as error:
        status = _failed('microbot', str(error), 1)
    except ModuleNotFoundError as error:
        if (missing := extras.advice(error)) is None:
            raise
        status = _failed('microbot', missing, 2)
    except click.UsageError as error:
        status = _failed(_name_of(error.ctx), f'{error.format_message()} (see --help)', 2)
    except OSError as error:
        if error.errno not in (*_DISK, *_WRONG_PLACE):
            raise
        place = f'{error.filename}: ' if error.filename else ''
        status = _failed('microbot', f'{place}{error.strerror}', 1 if error.errno in _DISK else 2)
    except (click.Abort, KeyboardInterrupt) as end:
        # Click treats a truncated file like Ctrl-D, but nothing is read from the terminal here.
        if isinstance(end.__cause__, EOFError):
            raise end.__cause__ from None
        status = 130
    sys.exit(status)


def _name_of(context: click.Context | None) -> str:
    """Return the name of a command with those of its groups."""
    if context is None or context.parent is None:
        return 'microbot'
    return f'{_name_of(context.parent)} {context.info_name}'


def script() -> None:
    """Run the program `microbot`: `main`, and then end this process, whatever hangs."""
    try:
        main()
    except SystemExit as end:
        graph = sys.modules.get('microbot_ros.nodes.base.participant')
        if graph and isinstance(end.code, int | None):
            graph.leave(end.code or 0)
        raise


def _failed(who: str, sentence: str, status: int) -> int:
    print(one_line(f'{who}: {sentence}'), file=sys.stderr)
    return status


@contextmanager
def _cleaned_up_on(*signals: int) -> Iterator[None]:
    """Raise SystemExit at the first of the signals, so that no folder stays half filled.

    KeyboardInterrupt is raised at every SIGINT. During an import both wait for its end, at most
    `_CLEAN_UP_S`, since modules in C may swallow exceptions while they load. Where C calls Python,
    as llvmlite and weak references do, an exception is ignored: it is raised again 10 ms later.
    `_CLEAN_UP_S` after SystemExit the process ends in any case: a library in C may swallow that
    too. Forked workers end at once.
    """
    ours = os.getpid()
    ignored = sys.unraisablehook

    def end(number: int, frame: FrameType | None) -> None:
        if os.getpid() != ours:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        error: BaseException = KeyboardInterrupt()
        if number != signal.SIGINT:
            error = SystemExit(128 + number)
            for one in before:
                signal.signal(one, signal.SIG_IGN)
        say(error, frame, time.monotonic() + _CLEAN_UP_S)

    def say(error: BaseException, frame: FrameType | None, latest: float) -> None:
        if _imports(frame) and time.monotonic() < latest:
            later(error, latest)
            return
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(_CLEAN_UP_S if isinstance(error, SystemExit) else 0)
        raise error.with_traceback(None)

    def later(error: BaseException, latest: float) -> None:
        signal.signal(signal.SIGALRM, lambda _, frame: say(error, frame, latest))
        signal.setitimer(signal.ITIMER_REAL, 0.01)

    def again(lost: sys.UnraisableHookArgs) -> None:
        if (isinstance(lost.exc_value, SystemExit | KeyboardInterrupt)
                and threading.current_thread() is threading.main_thread()):
            later(lost.exc_value, time.monotonic() + _CLEAN_UP_S)
        else:
            ignored(lost)

    sys.unraisablehook = again
    # `nohup` ignores one of them.
    before = {one: signal.signal(one, end) for one in (*signals, signal.SIGINT)
              if signal.getsignal(one) in (signal.SIG_DFL, signal.default_int_handler)}
    try:
        yield
    finally:
        signal.alarm(0)
        sys.unraisablehook = ignored
        for one, handler in before.items():
            signal.signal(one, handler)


def _imports(frame: FrameType | None) -> bool:
    """Return whether a module is being imported in this frame or in one that waits for it."""
    while frame and frame.f_code.co_filename != '<frozen importlib._bootstrap>':
        frame = frame.f_back
    return frame is not None
