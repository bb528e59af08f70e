"""One participant in the graph per process, which lives as long as the process.

Fast DDS 2.14 can deadlock while a participant is deleted: `DomainParticipant::set_listener` holds
the lock that a callback waits for, which has just discovered another process's publisher, and
waits for the callback. It does so with Python's interpreter locked, so that no thread and no
signal handler can help. Of seven hundred clients that came and went beside processes that were
killed, one hung this way. A participant that is never deleted cannot hang: an idle node keeps the
participant, and the system ends it with the process.
"""

from __future__ import annotations

import atexit
import faulthandler
import os
import sys
from contextlib import suppress
from functools import cache
from typing import NoReturn

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from microbot_ros.common.errors import InputError
from microbot_ros.nodes.base.transport import (
    BY_PROFILE,
    CLIENT,
    NODE,
    RANGE,
    asked_reach,
    reached_sockets,
    remove_own_shared_memory,
    transport,
)

_PATIENCE_S = 20.0
"""Time [s] that a program without `leave` has to end. Choice: longer than any orderly end takes
(15 s)."""

_KEPT: list[Node] = []


def join(arguments: list[str] | None) -> None:
    """Join the graph with this process until it ends; call `leave` at the end.

    Parameters
    ----------
    arguments : list of str or None
        ROS arguments, `--ros-args` and what follows.

    Raises
    ------
    InputError
        If other computers could reach the process, unless ROS_AUTOMATIC_DISCOVERY_RANGE requests
        that.
    """
    _join(arguments, NODE, None)


def client_context() -> Context:
    """Return the context that all clients in this process share, one for each ROS domain.

    Returns
    -------
    Context
        The context.

    Raises
    ------
    InputError
        As `join`.
    """
    return _joined(os.environ.get('ROS_DOMAIN_ID', ''))


@cache
def _joined(_: str) -> Context:
    return _join([], CLIENT, Context())


def _join(arguments: list[str] | None, profile: str, context: Context | None) -> Context:
    """Make the participant in a context: on this machine alone, unless more was requested.

    InputError if others reach it all the same, since the `profile` was not read: by another
    version of the middleware, or after another participant in this process.
    """
    asked = asked_reach(get_rmw_implementation_identifier())
    if asked:
        with transport(asked):
            return _participant(arguments, context)
    before = reached_sockets()
    with transport(BY_PROFILE, profile):
        made = _participant(arguments, context)
    if not reached_sockets() <= before:
        _KEPT.pop().destroy_node()
        rclpy.shutdown(context=context)
        raise InputError(RANGE, 'other computers could reach this process: the middleware did not '
                                f'read {profile}; set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET to '
                                'allow that')
    return made


def _participant(arguments: list[str] | None, context: Context | None) -> Context:
    rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
    if not _KEPT:
        atexit.register(_end_in_time)
    # ROS tools do not list names with a leading underscore.
    _KEPT.append(Node(
        f'_microbot_{os.getpid()}', context=context, cli_args=[], use_global_arguments=False,
        enable_rosout=False, start_parameter_services=False,
        parameter_overrides=[Parameter('start_type_description_service', value=False)]))
    return _KEPT[-1].context


def leave(status: int) -> NoReturn:
    """End this process at once; all nodes have been destroyed before.

    Parameters
    ----------
    status : int
        Exit status.
    """
    if not _KEPT:
        sys.exit(status)
    atexit._run_exitfuncs()  # os._exit does not call them
    with suppress(OSError):  # the reader is gone
        sys.stdout.flush()
        sys.stderr.flush()
    remove_own_shared_memory()
    os._exit(status)


def _end_in_time() -> None:
    faulthandler.dump_traceback_later(_PATIENCE_S, exit=True)
