"""The option --namespace of the commands that talk to a running rig."""

from __future__ import annotations

import click

namespace_option = click.option(
    '--namespace', default='/', show_default=True, metavar='NAME',
    help='Which rig, where its nodes run in a ROS namespace of their own.')
