"""One participant in the graph for a process, which ends with it and not before.

Fast DDS 2.14 can deadlock while a participant is deleted: `DomainParticipant::set_listener` holds
the lock that a callback waits for, which has just heard of somebody else's publisher, and waits
for the callback. It does so with Python's interpreter locked, so that no thread and no signal
handler can help. Of seven hundred clients that came and went beside processes that were killed,
one hung so. What is never deleted cannot hang: a node that does nothing keeps the participant,
and the system ends it with the process.
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

from microbot_ros.nodes.transport import remove_own_shared_memory, stay_local

_PATIENCE_S = 20.0
"""How long a program that ends without `leave` may take for it."""

_KEPT: list[Node] = []


def join(arguments: list[str] | None, context: Context | None = None) -> None:
    """Let this process take part in the graph, until it ends.

    `arguments` are those of ROS; the `context` is the default one where none is given. Call
    `leave` at the end.
    """
    stay_local()
    rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
    if not _KEPT:
        atexit.register(_end_in_time)
    # Named as ROS names what its tools are not to list.
    _KEPT.append(Node(
        f'_microbot_{os.getpid()}', context=context, cli_args=[], use_global_arguments=False,
        enable_rosout=False, start_parameter_services=False,
        parameter_overrides=[Parameter('start_type_description_service', value=False)]))


def client_context() -> Context:
    """What all clients in this process share; one for each ROS domain that it was in."""
    return _joined(os.environ.get('ROS_DOMAIN_ID', ''))


@cache
def _joined(_: str) -> Context:
    context = Context()
    join([], context)
    return context


def leave(status: int) -> NoReturn:
    """End this process with that exit `status` at once; all nodes have been destroyed before."""
    if not _KEPT:
        sys.exit(status)
    atexit._run_exitfuncs()  # whoever else has something to close; the system does not call them
    with suppress(OSError):  # nobody reads any more
        sys.stdout.flush()
        sys.stderr.flush()
    remove_own_shared_memory()
    os._exit(status)


def _end_in_time() -> None:
    faulthandler.dump_traceback_later(_PATIENCE_S, exit=True)
