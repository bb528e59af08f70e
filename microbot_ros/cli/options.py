"""Options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from microbot_ros.common.plausible import plausible_range

CommandT = TypeVar('CommandT', bound=Callable[..., Any])

class _Path(click.Path):
    """Type of a path, which is not empty and can become a file or a folder if it is to be one.

    What cannot be written is refused before the work on its content.

    Parameters
    ----------
    made : str
        'file', 'json' or 'folder', if the command makes one; '' otherwise. JSON replaces no file
        of another kind.
    """

    def __init__(self, made: str = '') -> None:
        super().__init__(path_type=Path)
        self._made = made

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> Path:
        """Convert a value, or fail as click does."""
        if not str(value):
            self.fail('expected a path, received nothing', param, ctx)
        super().convert(value, param, ctx)
        path = Path(value)
        if self._made in ('file', 'json') and path.is_dir():
            self.fail(f'expected a file to write, {path} is a folder', param, ctx)
        if self._made == 'json' and path.is_file() and not _is_json(path):
            self.fail(f'expected a new file or one of JSON to replace, {path} is another', param,
                      ctx)
        if self._made == 'folder' and path.exists() and not path.is_dir():
            self.fail(f'expected a folder to write to, {path} is a file', param, ctx)
        return path


def _is_json(path: Path) -> bool:
    """Return whether a file is empty or begins as JSON of a command does."""
    with path.open('rb') as file:
        return file.read(1) in (b'', b'{', b'[')


PATH, NEW_FILE, NEW_FOLDER = _Path(), _Path('file'), _Path('folder')

namespace_option = click.option(
    '--namespace', default='/', show_default=True, metavar='NAME',
    help="ROS namespace of the rig's nodes.")


cockpit_option = click.option(
    '--cockpit', is_flag=True, help="Also serve the operator's page; see `microbot cockpit`.")


force_option = click.option(
    '--force', is_flag=True, help='Replace the results of an earlier run.')


def json_option(description: str) -> Callable[[CommandT], CommandT]:
    """Return the option `--json` of a command, which is its argument `json_path`.

    Parameters
    ----------
    description : str
        What the command writes to that file.

    Returns
    -------
    callable
        Decorator of the command.
    """
    return click.option('--json', 'json_path', type=_Path('json'), help=description)


class FiniteFloatRange(click.FloatRange):
    """Type of a number within a range, without NaN, which click's own type accepts."""

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> float:
        """Convert a value, or raise click's `BadParameter` if it is not allowed.

        Parameters
        ----------
        value : object
            Value on the command line.
        param : click.Parameter or None
            Parameter, as click gives it.
        ctx : click.Context or None
            Context, as click gives it.

        Returns
        -------
        float
            The number.
        """
        number: float = super().convert(value, param, ctx)
        return number if math.isfinite(number) else self.fail(f'{value} is no number', param, ctx)


def plausible_number(name: str) -> FiniteFloatRange:
    """Return the type of an option for a number within the plausible range of a rig.

    Parameters
    ----------
    name : str
        Name of the quantity.

    Returns
    -------
    FiniteFloatRange
        The type.
    """
    return FiniteFloatRange(*plausible_range(name))
