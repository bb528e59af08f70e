"""A server of the page with a rig that only remembers what it was asked."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip('uvicorn', reason='the extra `cockpit` is not installed')

import asyncio

from websockets.sync.client import ClientConnection, connect

from microbot_ros.cockpit.discovery import Discovery
from microbot_ros.cockpit.recordings import Recordings
from microbot_ros.cockpit.rig import RefusedError
from microbot_ros.cockpit.server import Server


class RememberingRig:
    """Does nothing, and remembers `calls`: (moment [s], name, arguments). `refusals` says why not,
    by the name of a verb; `slow_s` how long each takes."""

    def __init__(self) -> None:
        self.kinds: list[str] = []
        self.calls: list[tuple[float, str, tuple[Any, ...]]] = []
        self.refusals: dict[str, str] = {}
        self.slow_s: dict[str, float] = {}
        self.looking = False
        self.parts: dict[str, Any] = {'rig': 'disarmed', 'sentence': 'disarmed'}
        self.says = {'stop': 'zero, confirmed by a reading'}
        self.watched = threading.Event()

    def watch(self, picture: Callable[[int, bytes], None],
              particles: Callable[[dict[str, Any]], None]) -> None:
        self.picture, self.particles = picture, particles
        self.watched.set()

    def look(self, wanted: bool) -> None:
        self.looking = wanted

    def camera(self) -> dict[str, Any]:
        return {'width_px': 640, 'height_px': 480, 'pixel_size_um': 0.45}

    def state(self) -> dict[str, Any]:
        return dict(self.parts)

    async def keep_up(self) -> None:
        await asyncio.Event().wait()

    def attend(self) -> None:
        self.calls.append((time.monotonic(), 'attend', ()))

    def stick(self, x: float, y: float) -> None:
        self.calls.append((time.monotonic(), 'stick', (x, y)))

    def __getattr__(self, name: str) -> Any:
        async def done(*arguments: Any) -> str:
            self.calls.append((time.monotonic(), name, arguments))
            await asyncio.sleep(self.slow_s.get(name, 0.0))
            if name in self.refusals:
                raise RefusedError(self.refusals[name])
            return self.says.get(name, f'{name} done')
        return done

    def asked(self, name: str) -> list[tuple[Any, ...]]:
        """The arguments of every call of that name."""
        return [arguments for _, called, arguments in self.calls if called == name]


class Page:
    """What a page does, by a socket."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.pictures: list[int] = []
        self.told: list[dict[str, Any]] = []
        self.known: dict[str, Any] = {}
        self._count = 0

    def say(self, verb: str, **what: Any) -> None:
        """Send a verb that has no answer."""
        self.socket.send(json.dumps({'verb': verb, **what}))

    def ask(self, verb: str, **what: Any) -> dict[str, Any]:
        """Send a verb; its answer."""
        self._count += 1
        self.say(verb, id=self._count, **what)
        return self.answer(self._count)

    def answer(self, to: int | None) -> dict[str, Any]:
        """The answer to the verb with that id."""
        return self.until(lambda message: message.get('kind') == 'answer' and message['to'] == to)

    def until(self, true: Callable[[dict[str, Any]], Any], seconds: float = 30.0,
              ) -> dict[str, Any]:
        """Read until a message is as wanted; pictures are left unseen."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            message = self.read(left)
            if message and true(message):
                return message
        raise TimeoutError(f'much was told, and not that, in {seconds:g} s')

    def read(self, seconds: float) -> dict[str, Any] | None:
        """One message, None for a picture. TimeoutError where none comes."""
        data = self.socket.recv(timeout=max(seconds, 0.0))
        if isinstance(data, bytes):
            self.pictures.append(int.from_bytes(data[:8], 'big'))
            return None
        message: dict[str, Any] = json.loads(data)
        self.told.append(message)
        if message['kind'] == 'state':
            self.known.update(message)
        return message

    def drain(self, seconds: float) -> None:
        """Read for so long."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            try:
                self.read(left)
            except TimeoutError:
                return

    def becomes(self, part: str, value: Any) -> None:
        """Read until a part of the state has that value."""
        if self.known.get(part) != value:
            self.until(lambda message: message.get(part) == value)


def get(port: int, path: str = '/', method: str = 'GET', **headers: str) -> Any:
    """The answer to a request, its content read."""
    connection = http.client.HTTPConnection('127.0.0.1', port, timeout=60)
    own = {name.replace('_', '-'): value for name, value in headers.items()}
    connection.putrequest(method, path, skip_host='Host' in own)
    for name, value in own.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    answer.content = answer.read()  # type: ignore[attr-defined]
    connection.close()
    return answer


@contextmanager
def page_at(address: str) -> Iterator[Page]:
    """A page that has come to a cockpit: `host:port`, or what a browser opens."""
    place = address.removeprefix('http://').rstrip('/')
    with connect(f'ws://{place}/socket', origin=f'http://{place}', compression=None,
                 close_timeout=0.2) as socket:  # type: ignore[arg-type]
        yield Page(socket)


@contextmanager
def page_in_control(address: str) -> Iterator[Page]:
    """A page that has control, and says `seen` to all pictures."""
    with page_at(address) as page:
        read = page.read

        def seeing(seconds: float) -> dict[str, Any] | None:
            message = read(seconds)
            if message is None:
                page.say('seen', stamp=str(page.pictures[-1]))
            return message
        page.read = seeing  # type: ignore[method-assign]
        page.ask('take_control')
        yield page


class Served:
    """A server of a `RememberingRig`, `host` and its free port; `open_to_all`, without a token.

    By its clock no time passes but `now_s` [s], unless another `clock` is given: what a busy
    machine holds up for long is not asked too late.
    """

    def __init__(self, folder: Path, host: str = '127.0.0.1', open_to_all: bool = True,
                 clock: Callable[[], float] | None = None) -> None:
        self.now_s = 0.0
        self.rig = RememberingRig()
        self.server = Server(
            self.rig, Discovery('/', folder), Recordings(folder), host, 0, open_to_all=open_to_all,
            clock=clock or (lambda: self.now_s))
        self.server.start()
        assert self.rig.watched.wait(10.0)

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self.server.address.partition('://')[2].partition('/')[0].rpartition(':')[2])

    @contextmanager
    def page(self) -> Iterator[Page]:
        """A page that has come and been greeted."""
        with page_at(f'127.0.0.1:{self.port}') as page:
            assert page.read(10.0)['kind'] == 'hello'  # type: ignore[index]
            yield page


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """Makes servers that end with the test."""
    made: list[Served] = []

    def start(**options: Any) -> Served:
        made.append(Served(tmp_path, **options))
        return made[-1]

    yield start
    for one in made:
        one.server.stop()


@pytest.fixture
def served(serve: Callable[..., Served]) -> Served:
    """A server on this machine, without a token."""
    return serve()
