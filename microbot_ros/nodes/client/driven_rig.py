"""A running rig as discovery drives it: through the controller `experiment`, and by topics."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType

import numpy as np
from sensor_msgs.msg import PointCloud2

from microbot_ros.common.errors import InputError, RigError
from microbot_ros.common.patience import PATIENCE
from microbot_ros.common.records import Commands, Session
from microbot_ros.control.contract import Workspace
from microbot_ros.discovery.driven.design import Range
from microbot_ros.discovery.driven.drive import Played
from microbot_ros.discovery.driven.plan import Plan, marking_time
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.nodes.client.live_session_buffer import LiveSessionBuffer

CONTROLLER, AT_REST = 'experiment', 'hold'
"""Controller that drives, and controller that is active afterwards."""

_LONGEST = 600.0
"""Longest experiment that is kept [s]. Choice: bounds the memory; a longer experiment loses its
beginning."""


class DrivenRig:
    """Rig of the graph of a client.

    Use it as a context: it activates the controller `experiment`, and leaves the rig at rest,
    unless an operator has taken over.

    Parameters
    ----------
    client : GraphClient
        Client of the graph.
    keep : callable
        Function that is called with the recording of each experiment.

    Raises
    ------
    RigError
        On entering, if the gate is not armed, no particle is seen or the controller is missing.
    """

    def __init__(self, client: GraphClient, keep: Callable[[Session], None]) -> None:
        self._client, self._keep = client, keep
        self._recent = LiveSessionBuffer(client, _LONGEST, applied=True)
        self._conditions = self._recent.conditions()
        self._origin = math.nan
        self._armed: bool | None = None
        self._said: dict[str, str] = {}
        self._heard = self._seen = self._told = -math.inf
        self._complaint, self._ending = '', False
        self._thinking = threading.Event()
        self._listener: threading.Thread | None = None
        node = client.node
        node.create_subscription(PointCloud2, 'particles', self._on_particles, 10)
        client.watch_progress(self._on_progress)
        client.watch_health(self._on_health)
        self.limits = self._range()

    def _range(self) -> Range:
        told = self._client.get('controller', 'max_field_mT', 'max_frequency_hz', 'workspace_um')
        field = min(told['max_field_mT'] * 1e-3, self._conditions.reference_field or math.inf)
        view = np.array(told['workspace_um'], float) * 1e-6
        rolling = self._conditions.propulsion == 'rolling'
        most = float(told['max_frequency_hz'])
        return Range(field, Workspace(view[:2], view[2:]),
                     (min(1.0, most), min(20.0, most)) if rolling else None)

    def __enter__(self) -> DrivenRig:
        if not self._client.until(lambda: self._armed is not None, PATIENCE.state_s):
            raise RigError('coil_driver does not report its gate: is it running?')
        if not self._armed:
            raise RigError('the gate is not armed; run: microbot arm')
        if not self._client.until(lambda: self._seen > 0, PATIENCE.state_s):
            raise RigError(f'no particle was seen for {PATIENCE.state_s:g} s')
        self._client.set('controller', controller=CONTROLLER)
        if not self._client.until(
                lambda: self._said.get('controller') == CONTROLLER, PATIENCE.state_s):
            raise RigError(f'the controller did not report that {CONTROLLER} is active')
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._attend()
        if self._said.get('controller', CONTROLLER) == CONTROLLER:
            self._client.set('controller', controller=AT_REST)

    def tell_to_end(self) -> None:
        """Make the present experiment the last; callable from any thread, or a signal handler."""
        self._ending = True

    @property
    def seconds(self) -> float:
        """Time [s] since the first frame of the first experiment, on the rig's clock."""
        now = self._client.node.get_clock().now().nanoseconds * 1e-9
        return now - self._origin if math.isfinite(self._origin) else 0.0

    def play(self, plan: Plan) -> Played:
        """Make the controller play a plan to its end, or until something stops it.

        Then the particles mark time until the next plan; this is part of the next recording.

        Parameters
        ----------
        plan : Plan
            The plan.

        Returns
        -------
        Played
            The recording, and why it stopped.
        """
        self._attend()
        if stopped := self._trouble():
            return Played(self._recorded(), stopped)
        rolling = self.limits.frequency
        after = marking_time(float(plan.angle[-1]), self.limits.field, rolling and rolling[1])
        self._seen = self._heard = self._told = time.monotonic()
        self._client.send_plan(_ended(plan.then(after)))
        deadline = time.monotonic() + plan.duration
        while not stopped and (left := deadline - time.monotonic()) > 0:
            self._client.spin(min(left, 0.05))
            stopped = self._trouble()
        session = self._recorded()
        self._recent.go_on()
        if len(session.tracks.t):
            try:
                self._keep(session)
            except (OSError, InputError) as error:
                stopped = stopped or f'the experiment could not be written ({error})'
        self._listen()
        return Played(session, stopped)

    def _listen(self) -> None:
        """Receive messages in a thread during computations, so that arrivals are timed."""
        self._thinking.set()
        self._listener = threading.Thread(target=self._take_in, name='listener', daemon=True)
        self._listener.start()

    def _take_in(self) -> None:
        while self._thinking.is_set():
            self._client.spin(0.05)

    def _attend(self) -> None:
        """Serve the graph in this thread again."""
        self._thinking.clear()
        if self._listener is not None:
            self._listener.join()
            self._listener = None

    def _trouble(self) -> str:
        """Return why an experiment must stop; '' if it need not."""
        name, now = self._said.get('controller', CONTROLLER), time.monotonic()
        if name != CONTROLLER:
            return f'an operator let {name} drive'
        if not self._armed:
            return f'the gate is disarmed ({self._complaint or "no reason was given"})'
        if self._ending:
            return 'a stop was requested'
        if self._said.get('result') == 'fault':
            return 'the controller has a fault'
        if math.isfinite(self._seen) and now - self._seen > PATIENCE.unseen_s:
            return f'no particle has been seen for {PATIENCE.unseen_s:g} s'
        if math.isfinite(self._heard) and now - self._heard > PATIENCE.unseen_s:
            return f'the controller published nothing for {PATIENCE.unseen_s:g} s'
        unheard_s = 2 * PATIENCE.unseen_s  # it reports once a second only
        if math.isfinite(self._told) and now - self._told > unheard_s:
            return f'the coil driver published nothing for {unheard_s:g} s'
        return ''

    def _recorded(self) -> Session:
        """Return the recording, with times from the beginning of the first experiment."""
        session = self._recent.session()
        if not len(session.tracks.t):
            return session
        if not math.isfinite(self._origin):
            self._origin = self._recent.begin
        late = self._recent.begin - self._origin
        tracks = replace(session.tracks, t=session.tracks.t + late)
        commands = replace(session.commands, t=session.commands.t + late)
        return Session(tracks, commands, self._conditions, 'experiment')

    def _on_particles(self, message: PointCloud2) -> None:
        if message.width:
            self._seen = time.monotonic()

    def _on_progress(self, _: bytes, __: str, values: dict[str, str]) -> None:
        self._heard, self._said = time.monotonic(), values

    def _on_health(self, node: str, level: bytes, sentence: str, values: dict[str, str]) -> None:
        if node == 'coil_driver' and 'armed' in values:
            self._armed, self._told = values['armed'] == 'True', time.monotonic()
            self._complaint = '' if level == b'\0' else sentence


def _ended(plan: Plan) -> Commands:
    """Return the fields of a plan, and no field at its end."""
    commands = plan.commands()
    return Commands(
        np.append(commands.t, plan.duration), np.vstack([commands.field, np.zeros(2)]),
        None if commands.frequency is None else np.append(commands.frequency, 0.0))
