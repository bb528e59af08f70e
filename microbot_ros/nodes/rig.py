"""The nodes of the loop in one process: what one says, the next takes in the same turn."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from rclpy.publisher import Publisher

_FRAMES = 'camera/image_raw'
_SAID_BY = {
    _FRAMES: 'camera', 'particles': 'tracker', 'model/state': 'model',
    'field/command': 'controller', 'field/rotation': 'controller', 'field/applied': 'coil_driver'}
"""What the stages of the loop tell each other, and which of them does."""
_PATIENCE_S = 1.0
"""How long anybody waits for a turn before it is said that the loop hangs: to learn what particles
look like takes it some tenths."""
_OVERTAKEN = 50
"""So many frames that came too fast to be worked on are kept, to be published all the same."""
_LETTERS = 1000
"""So much is kept for a thread that hangs."""

_log = logging.getLogger(__name__)


class HangingError(Exception):
    """The loop does not end its turn."""


class Rig:
    """Joins the nodes of these `names`, which share a process.

    What one publishes for another of them goes there as it is, without the middleware, and
    currents are in the driver's mailbox before anything of their frame is published, which
    happens only where somebody listens. A camera leaves its newest frame for the loop's thread,
    the driver's thread what it read back. All work on what the nodes share is done in turns, by
    the loop's thread or by the executor's, so that a node sees no difference to a process of its
    own. The dead-man is not in here: it is the driver's own thread, and beyond this process the
    device's watchdog, or the process that stands in for it.
    """

    def __init__(self, names: Collection[str]) -> None:
        self._listeners: dict[str, list[Callable[[Any], None]]] = {
            topic: [] for topic, name in _SAID_BY.items() if name in names}
        self._free = threading.Lock()
        self._worker: int | None = None
        """The thread whose turn it is."""
        self._deliveries: deque[tuple[Callable[[Any], None], Any]] = deque()
        self._afterwards: deque[Callable[[], None]] = deque()
        self._news = threading.Condition()
        self._letters: deque[tuple[str, Any]] = deque(maxlen=_LETTERS)
        self._frame: tuple[Outlet, Any] | None = None
        self._overtaken: deque[tuple[Outlet, Any]] = deque(maxlen=_OVERTAKEN)
        self._ending = False
        self._thread = threading.Thread(target=self._run, name='loop', daemon=True)

    def start(self) -> None:
        """Let the loop's thread take what waits for it."""
        self._thread.start()

    def stop(self) -> None:
        """End the loop's thread, unless it hangs."""
        with self._news:
            self._ending = True
            self._news.notify()
        if self._thread.ident is not None:
            self._thread.join(_PATIENCE_S)

    def joins(self, topic: str) -> bool:
        """Whether what is to be heard on this `topic` is said by one of the nodes."""
        return topic in self._listeners

    def listen(self, topic: str, deliver: Callable[[Any], None]) -> Callable[[], None]:
        """`deliver` all that is said on a joined `topic`, until what is returned is called."""
        self._listeners[topic].append(deliver)
        return lambda: self._listeners[topic].remove(deliver)

    @contextmanager
    def turn(self, patience_s: float = _PATIENCE_S) -> Iterator[None]:
        """Work on what the nodes share: what is said meanwhile is delivered, and then published.

        Raises HangingError where another's turn does not end within `patience_s` (-1: for ever).
        """
        if self._worker == threading.get_ident():
            yield
            return
        if not self._free.acquire(timeout=patience_s):
            raise HangingError(f'the loop has been at one thing for more than {patience_s:g} s')
        self._worker = threading.get_ident()
        try:
            yield
            while self._deliveries:
                deliver, message = self._deliveries.popleft()
                deliver(message)
            while self._afterwards:
                self._afterwards.popleft()()
        finally:
            self._deliveries.clear()
            self._afterwards.clear()
            self._worker = None
            self._free.release()

    def afterwards(self, work: Callable[[], None]) -> None:
        """Do some `work` once the currents of this turn are on their way."""
        if self._worker == threading.get_ident():
            self._afterwards.append(work)
        else:
            work()

    def say(self, outlet: Outlet, message: Any) -> None:
        """Bring a `message` to the nodes that are joined, and by its `outlet` to all others."""
        if self._worker == threading.get_ident():
            self._deliver(outlet.topic, message)
            self._afterwards.append(partial(outlet.broadcast, message))
        elif outlet.topic == _FRAMES:
            self._leave_frame(outlet, message)
        else:
            if self._listeners.get(outlet.topic):
                with self._news:
                    self._letters.append((outlet.topic, message))
                    self._news.notify()
            outlet.broadcast(message)

    def _leave_frame(self, outlet: Outlet, message: Any) -> None:
        with self._news:
            if self._frame is not None:
                self._overtaken.append(self._frame)
            self._frame = outlet, message
            self._news.notify()

    def _deliver(self, topic: str, message: Any) -> None:
        self._deliveries.extend((deliver, message) for deliver in self._listeners.get(topic, ()))

    def _run(self) -> None:
        while not self._ending:
            with self._news:
                self._news.wait_for(lambda: self._letters or self._frame or self._ending)
                letters, frame = list(self._letters), self._frame
                overtaken = list(self._overtaken)
                self._letters.clear()
                self._overtaken.clear()
                self._frame = None
            try:
                with self.turn(-1):
                    self._take(letters, frame, overtaken)
            except Exception:  # in publishing: whatever is delivered guards itself
                _log.exception('in the loop')

    def _take(self, letters: Iterable[tuple[str, Any]], frame: tuple[Outlet, Any] | None,
              overtaken: Iterable[tuple[Outlet, Any]]) -> None:
        for topic, message in letters:
            self._deliver(topic, message)
        self._afterwards.extend(partial(outlet.broadcast, image) for outlet, image in overtaken)
        if frame is not None:
            self.say(*frame)


class Outlet:
    """What a node of a `rig` publishes on a `topic`, by `publisher` where somebody listens."""

    def __init__(self, rig: Rig, topic: str, publisher: Publisher) -> None:
        self.topic = topic
        self.get_subscription_count = publisher.get_subscription_count
        self._rig, self._publisher = rig, publisher

    def publish(self, message: Any) -> None:
        """Publish a `message` as a publisher of rclpy does, to the joined nodes first."""
        self._rig.say(self, message)

    def broadcast(self, message: Any) -> None:
        """Publish a `message` to those beyond this process."""
        if self.get_subscription_count():
            self._publisher.publish(message)
