"""Server of the page: a Starlette application, and the thread in which it runs."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import socket
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from importlib import resources
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from microbot_ros import __version__
from microbot_ros.cockpit import verbs
from microbot_ros.cockpit.clients import Page
from microbot_ros.cockpit.connections import BriefConnection
from microbot_ros.cockpit.control import Control
from microbot_ros.cockpit.discovery import Discovery
from microbot_ros.cockpit.events import Events, explained
from microbot_ros.cockpit.recordings import Recordings
from microbot_ros.cockpit.rig import Answer, RefusedError, Rig, zero_in
from microbot_ros.cockpit.security import REPORT_POLICY, Gatekeeper
from microbot_ros.cockpit.stopping import Stopping
from microbot_ros.common.errors import InputError

_STATE_S = 0.1
"""Interval of the state [s]. Choice: ten a second follow the eye; half doubles the load of slow
links."""
_LAST_STOP_S = 0.5
"""Time [s] for the last stop at the end of the server. Choice: sending takes milliseconds, and the
driver disarms by itself without heartbeats."""
_STOOD_STILL_S, _DEAF_S = 0.7, 0.5
"""Times [s] of a server that stood still. A page that hears nothing for the first time takes the
link for lost, and its requests for not done. A server that stood still makes that true: for the
second time it then does nothing but stop and disarm."""
_MOST_PAGES = 16
"""Largest number of pages. Choice: more than a laboratory opens; each costs a picture 30 times a
second."""
_SILENT_S = 10.0
"""Silence [s] after which a page makes room if there are `_MOST_PAGES`. Choice: ten reports, as a
visible page reports its presence every second."""
_MOST_IN_WORK = 8
"""Largest number of verbs of one page in work. Choice: a person has one or two."""
_MOST_STOPS = 8
"""Largest number of STOPs of one page whose answers it waits for; more are sent too, and answered
at once. Choice: more than a person presses in a second."""
_LONGEST_MESSAGE = 128 * 1024
"""Longest message of a page [bytes]. Choice: a path of 2000 points takes less."""
_BUFFER = 256 * 1024
"""Bytes that may wait in the system for a page that does not read. Choice: some pictures, as a
frozen page must not be shown the past when it wakes."""
_CURVE, _CURVE_S = 240, 0.25
"""Number of points of a curve and their interval [s]. Choice: one minute at four a second."""
_DRAWN = ('v_um_s', 'v_std_um_s', 'phi_deg', 'phi_std_deg')
_FOREIGN = 'another page has control'
_LATE = 'the cockpit was blocked and sends nothing late: ask again'

_log = logging.getLogger(__name__)


class Server:
    """Server of the page of a rig.

    All but `start` and `stop` runs in its own thread.

    Parameters
    ----------
    rig : Rig
        The rig.
    discovery : Discovery
        Discovery that the page starts.
    recordings : Recordings
        Recordings that the page lists.
    host : str
        Name or address to listen at.
    port : int
        Port to listen at; 0 for any that is free.
    open_to_all : bool
        Whether there is no token, see `Gatekeeper`.
    clock : callable, optional
        Time [s] by which it notices that it stood still, or that a stick was silent.

    Raises
    ------
    InputError
        If it cannot listen there.
    """

    def __init__(self, rig: Rig, discovery: Discovery, recordings: Recordings, host: str,
                 port: int, *, open_to_all: bool = False,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._rig, self._discovery, self._recordings = rig, discovery, recordings
        self._socket = _listen(host, port)
        self._host, self._port = host, int(self._socket.getsockname()[1])
        self._control = Control()
        self._stopping = Stopping(rig)
        self._events = Events()
        self._curves: dict[int, deque[list[Any]]] = {}
        """Time [s, monotonic], v, its σ, φ and its σ of each particle over the last minute."""
        self._pages: dict[int, Page] = {}
        self._count = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._ticked_s = self._deaf_until_s = -math.inf
        self._greeting: dict[str, Any] = self._known()
        try:
            self._gate = Gatekeeper(self._application(), host, self._port, open_to_all)
        except InputError:
            self._socket.close()
            raise
        self._uvicorn = uvicorn.Server(uvicorn.Config(
            self._gate, log_level='warning', access_log=False, http=BriefConnection,
            ws='websockets-sansio',
            ws_max_size=_LONGEST_MESSAGE, ws_per_message_deflate=False, ws_ping_interval=5.0,
            ws_ping_timeout=5.0, server_header=False, timeout_graceful_shutdown=2))
        self._thread = threading.Thread(target=self._run, name='cockpit', daemon=True)

    @property
    def address(self) -> str:
        """Address to open in a browser, its token included."""
        host = f'[{self._host}]' if ':' in self._host else self._host
        key = f'?token={self._gate.token}' if self._gate.token else ''
        return f'http://{host}:{self._port}/{key}'

    @property
    def port(self) -> int:
        """Port at which it listens."""
        return self._port

    @property
    def pages(self) -> int:
        """Number of pages."""
        return self._control.pages

    @property
    def serving(self) -> bool:
        """Whether its thread runs."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Start to serve."""
        self._thread.start()

    def stop(self) -> None:
        """Close every socket, end the discovery and the thread."""
        self._uvicorn.should_exit = True
        if self._thread.ident is not None:
            self._thread.join()
        self._socket.close()

    # In the server's thread -----------------------------------------------------------------

    def _run(self) -> None:
        self._uvicorn.run(sockets=[self._socket])

    def _application(self) -> Starlette:
        page = resources.files('microbot_ros.cockpit') / 'page'
        index = str(page / 'index.html')

        async def home(_: Request) -> Response:
            return FileResponse(index)
        return Starlette(lifespan=self._lifespan, routes=[
            Route('/', home), Route('/discoveries/{name}/report.html', self._report),
            Route('/recordings', self._list_recordings),
            Route('/recordings/{name}/film.mp4', self._film),
            Route('/recordings/{name}/{file}', self._file),
            Mount('/page', StaticFiles(directory=str(page))),
            WebSocketRoute('/socket', self._serve)])

    async def _report(self, request: Request) -> Response:
        path = self._discovery.report(request.path_params['name'])
        return Response(status_code=404) if path is None else FileResponse(
            path, headers={'Content-Security-Policy': REPORT_POLICY})

    async def _list_recordings(self, _: Request) -> Response:
        return JSONResponse(await asyncio.to_thread(self._recordings.listed))

    async def _film(self, request: Request) -> Response:
        film = await self._recordings.film(request.path_params['name'])
        return Response(status_code=404) if film is None else StreamingResponse(
            film, media_type='video/mp4')

    async def _file(self, request: Request) -> Response:
        path = self._recordings.file(**request.path_params)
        return Response(status_code=404) if path is None else FileResponse(
            path, filename=path.name)

    @asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        self._loop = asyncio.get_running_loop()
        self._ticked_s = self._clock()
        self._rig.watch(self._on_picture, self._on_particles)
        background = [asyncio.create_task(_for_ever(work)) for work in (
            self._tell_state, self._rig.keep_up)]
        yield
        for task in background:
            task.cancel()
        await asyncio.gather(*background, return_exceptions=True)
        if self._control.attended:  # faster than by the missing heartbeats
            with suppress(RefusedError, TimeoutError):
                await asyncio.wait_for(self._rig.stop(), _LAST_STOP_S)
        self._recordings.end()
        await self._discovery.end()

    def _on_picture(self, stamp: int, jpeg: bytes) -> None:
        """Show a picture on every page; callable from any thread."""
        self._loop.call_soon_threadsafe(self._show, stamp, jpeg)

    def _on_particles(self, message: dict[str, Any]) -> None:
        """Show the particles of a picture on every page; callable from any thread."""
        text = json.dumps(message, ensure_ascii=False, allow_nan=False)
        self._loop.call_soon_threadsafe(self._mark, text)

    def _show(self, stamp: int, jpeg: bytes) -> None:
        for page in self._pages.values():
            page.picture(stamp, jpeg)

    def _mark(self, text: str) -> None:
        for page in self._pages.values():
            page.particles(text)

    async def _tell_state(self) -> None:
        """Send the state to every page, each part serialised once for all."""
        while True:
            await asyncio.sleep(_STATE_S)
            self._tick(self._clock())
            state = self._rig.state()
            state |= {'attended': self._control.attended,
                      'discovery': self._discovery.state(state.pop('verdict', {}))}
            self._control.see(state.get('rig') == 'armed')
            self._events.see(state)
            self._keep_curves(state.get('estimates') or [], time.monotonic())
            if not self._pages:
                continue
            _explain(state)
            if (known := self._known()) != self._greeting:
                self._greeting = known
                for page in self._pages.values():
                    page.tell(self._hello(page))
            parts = {name: _json(part) for name, part in state.items()}
            for page in self._pages.values():
                if new := self._events.since(page.events):
                    page.events = new[-1]['number']
                    page.tell({'kind': 'events', 'events': new})
                page.state({**parts, 'control': json.dumps(self._control_of(page))},
                           time.monotonic())

    def _keep_curves(self, estimates: list[dict[str, Any]], now_s: float) -> None:
        """Keep estimates four times a second, for pages that come later."""
        for one in estimates:
            kept = self._curves.setdefault(one['id'], deque(maxlen=_CURVE))
            if not kept or now_s - kept[-1][0] >= _CURVE_S:
                kept.append([now_s, *(one[name] for name in _DRAWN)])
        self._curves = {name: kept for name, kept in self._curves.items()
                        if now_s - kept[-1][0] <= _CURVE * _CURVE_S}

    def _history(self) -> dict[str, Any]:
        now_s = time.monotonic()
        return {'kind': 'history', 'curves': {
            name: [[round(t_s - now_s, 2), *rest] for t_s, *rest in kept]
            for name, kept in self._curves.items()}}

    def _tick(self, now_s: float) -> None:
        """Determine at `now_s` [s] for how long the server stood still."""
        if now_s - self._ticked_s > _STOOD_STILL_S:
            self._deaf_until_s = now_s + _DEAF_S
        self._ticked_s = now_s

    def _stood_still(self, now_s: float) -> bool:
        """Return whether a message read at `now_s` [s] may have waited too long to be obeyed."""
        return now_s - self._ticked_s > _STOOD_STILL_S or now_s < self._deaf_until_s

    def _control_of(self, page: Page) -> dict[str, Any]:
        return {'mine': self._control.holder == page.number, 'holder': self._control.holder,
                'pages': self._control.pages}

    def _hello(self, page: Page) -> dict[str, Any]:
        return {'kind': 'hello', 'you': page.number, 'version': __version__,
                'verbs': list(verbs.NAMES), **self._known()}

    def _known(self) -> dict[str, Any]:
        """Return the properties of the rig that rarely change."""
        return {'camera': self._rig.camera(), 'kinds': self._rig.kinds}

    async def _serve(self, web_socket: WebSocket) -> None:
        """Serve one page until it is gone."""
        if len(self._pages) >= _MOST_PAGES and not self._make_room(time.monotonic()):
            await web_socket.close()
            return
        await web_socket.accept()
        self._count += 1
        page = Page(web_socket, self._count)
        self._control.join(page.number)
        self._pages[page.number] = page
        self._rig.look(True)
        page.tell(self._hello(page))
        page.tell(self._history())
        sending = asyncio.create_task(page.send())
        receiving = asyncio.create_task(self._receive(web_socket, page))
        try:
            await asyncio.wait([sending, receiving], return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._pages.pop(page.number, None)
            if self._control.holder == page.number:
                self._events.add(_named(page), 'note', 'The page in control has gone')
            self._control.leave(page.number)
            self._rig.look(bool(self._pages))
            for task in (sending, receiving):
                task.cancel()
            await asyncio.gather(sending, receiving, return_exceptions=True)

    def _make_room(self, now_s: float) -> bool:
        """End the page that has been silent for the longest, if it is silent for long enough."""
        page = min(self._pages.values(), key=lambda one: one.heard_s)
        if now_s - page.heard_s <= _SILENT_S:
            return False
        page.end()
        del self._pages[page.number]
        self._control.leave(page.number)
        return True

    async def _receive(self, web_socket: WebSocket, page: Page) -> None:
        try:
            while True:
                text = await web_socket.receive_text()
                page.heard_s = time.monotonic()
                try:
                    self._obey(page, verbs.read_verb(text))
                except verbs.VerbError as error:
                    page.tell(_answer(error.id, False, str(error)))
        except (WebSocketDisconnect, KeyError):
            pass  # gone, or it sent bytes

    def _obey(self, page: Page, verb: verbs.AnyVerb) -> None:
        """Perform a verb, in a task if it takes time, so that no STOP waits behind it."""
        now_s, controls = self._clock(), self._control.holder == page.number
        match verb:
            case verbs.Seen():
                page.seen(int(verb.stamp))
            case verbs.Heartbeat():
                if self._control.attends(page.number) and not self._stood_still(now_s):
                    self._rig.attend()
            case verbs.Stick():
                allowed = controls and not self._stood_still(now_s)
                if page.steering.counts(verb.x, verb.y, now_s, allowed):
                    self._rig.stick(verb.x, verb.y)
            case verbs.Order() if not isinstance(
                    verb, verbs.Stop | verbs.Disarm) and self._stood_still(now_s):
                page.tell(_answer(verb.id, False, _LATE))
            case verbs.TakeControl():
                self._control.take(page.number)
                self._events.add(_named(page), 'note', 'Took control')
                page.tell(_answer(verb.id, True))
            case _ if verb.needs_control and not controls:
                page.tell(_answer(verb.id, False, _FOREIGN))
            case verbs.Stop() | verbs.Disarm():
                self._stop(page, verb)
            case verbs.Order() if page.in_work < _MOST_IN_WORK:
                page.in_work += 1
                self._begin(self._perform(page, verb))
            case _:
                page.tell(_answer(verb.id, False, f'{_MOST_IN_WORK} requests are still in '
                                                  'progress'))

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _stop(self, page: Page, verb: verbs.Order) -> None:
        """Send zero, whatever else is in work; heartbeats end with it."""
        self._control.attended = False
        sent = self._stopping.want()
        if page.stops >= _MOST_STOPS:
            page.tell(_answer(verb.id, False, f'sent; {_MOST_STOPS} others wait for an answer'))
            return
        page.stops += 1
        self._begin(self._follow_stop(page, verb, sent))

    async def _follow_stop(self, page: Page, verb: verbs.Order, sent: asyncio.Task[Answer],
                           ) -> None:
        try:
            ok, said = True, await asyncio.shield(sent)
        except RefusedError as refusal:
            ok, said = False, str(refusal)
        except Exception as error:
            page.tell(_answer(verb.id, False, f'the cockpit failed: {error}'))
            raise
        finally:
            page.stops -= 1
        page.tell({**self._answer_to(page, verb, ok, said), 'zero': zero_in(said)})

    async def _perform(self, page: Page, verb: verbs.Order) -> None:
        if isinstance(verb, verbs.Arm):
            self._control.arm(verb.attended)
            if verb.attended:
                self._rig.attend()
        try:
            said = await verbs.perform(verb, self._rig, self._discovery)
        except RefusedError as refusal:
            if isinstance(verb, verbs.Arm):
                self._control.attended = False
            page.tell(self._answer_to(page, verb, False, str(refusal)))
        except Exception as error:
            page.tell(_answer(verb.id, False, f'the cockpit failed: {error}'))
            raise
        else:
            page.tell(self._answer_to(page, verb, True, said))
        finally:
            page.in_work -= 1


    def _answer_to(self, page: Page, verb: verbs.Order, ok: bool, said: str) -> dict[str, Any]:
        """Return the answer to a verb of a page, which is an event too."""
        text = verbs.told(verb) + (f': {said}' if said else '')
        self._events.add(_named(page), 'ok' if ok else 'refused', text)
        return {**_answer(verb.id, ok, said), **({} if ok else explained(said))}


def _named(page: Page) -> str:
    return f'page {page.number}'


def _explain(state: dict[str, Any]) -> None:
    """Add cause and cure of each problem in the state, as far as they are known."""
    state['why'] = explained(state['sentence']) if state.get('rig') == 'fault' else None
    state['health'] = [one if one['level'] == 'ok' else one | explained(one['sentence'])
                       for one in state.get('health') or []]


def _json(part: Any) -> str:
    """Return a part of the state as JSON; null if a node reported a number that is not finite."""
    try:
        return json.dumps(part, ensure_ascii=False, allow_nan=False)
    except ValueError:
        return 'null'


async def _for_ever(work: Callable[[], Awaitable[None]]) -> None:
    """Perform work in an endless loop, also after a failure."""
    while True:
        try:
            await work()
        except Exception:
            _log.exception('in the cockpit')
            await asyncio.sleep(1.0)


def _answer(to: int | None, ok: bool, reason: str = '') -> dict[str, Any]:
    return {'kind': 'answer', 'to': to, 'ok': ok, 'reason': reason}


def _listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens at an address; InputError if that is impossible."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        made = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise InputError('host', f'expected a host name or address of this machine: {error}'
                         ) from None
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        made.bind(address)
        made.listen(64)
    except OSError as error:
        made.close()
        raise InputError('cockpit', f'cannot listen on {host}, port {port}: {error.strerror}'
                         ) from None
    return made
