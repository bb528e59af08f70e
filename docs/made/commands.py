"""Every command with its options, from click."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import click

from made.text import MADE, code, table
from microbot_ros.cli import microbot


def page() -> str:
    """`commands.md`."""
    parts = [f'# Commands\n\n{MADE} `microbot COMMAND --help` prints the same. Exit status: 0 '
             'done, 1 failed, 2 wrong input, which one line on standard error names. Units: '
             '[glossary](glossary.md#units-of-commands-files-and-parameters).\n']
    return '\n'.join([*parts, *_sections(microbot, click.Context(microbot, info_name='microbot'))])


def _sections(group: click.Group, context: click.Context) -> Iterator[str]:
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context)
        yield _section(command, inner)
        if isinstance(command, click.Group):
            yield from _sections(command, inner)


def _section(command: click.Command, context: click.Context) -> str:
    usage = ' '.join([context.command_path, *command.collect_usage_pieces(context)])
    parts = [f'## `{context.command_path}`\n', f'```text\n{usage}\n```\n', _help(command)]
    records = [found for option in command.get_params(context)
               if '--help' not in option.opts and (found := option.get_help_record(context))]
    if records:
        parts.append(table(('option', 'meaning'), [
            [code(names), meaning] for names, meaning in records]))
    return '\n'.join(parts)


def _help(command: click.Command) -> str:
    """The paragraphs of a command's help; those that click is to leave as they are, as code."""
    shown = []
    for paragraph in inspect.cleandoc(command.help or '').split('\n\n'):
        if not paragraph.startswith('\b\n'):
            shown.append(' '.join(paragraph.split()) + '\n')
            continue
        title, *lines = paragraph.removeprefix('\b\n').splitlines()
        if lines and not lines[0].startswith('  '):
            title, lines = '', [title, *lines]
        shown.append((f'{title}\n\n' if title else '')
                     + '```text\n' + inspect.cleandoc('\n'.join(['', *lines])) + '\n```\n')
    return '\n'.join(shown)
