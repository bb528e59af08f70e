"""Access to the server: from its own origin, with the token of this server."""

from __future__ import annotations

import ipaddress
import secrets
import socket
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from microbot_ros.common.errors import InputError

_LOOPBACK = ('localhost', '127.0.0.1', '::1')

_POLICY = '; '.join((
    "default-src 'self'", "img-src 'self' blob: data:", "connect-src 'self'", "object-src 'none'",
    "base-uri 'none'", "form-action 'none'", "frame-ancestors 'none'"))
REPORT_POLICY = _POLICY.replace(
    "default-src 'self'", "default-src 'none'; style-src 'unsafe-inline'")
"""Policy of a report, which is self-contained: its styles are inside, its pictures are data, and
no script runs."""
_HEADERS = {
    'Content-Security-Policy': _POLICY, 'X-Content-Type-Options': 'nosniff',
    'X-Frame-Options': 'DENY', 'Referrer-Policy': 'no-referrer',
    'Cross-Origin-Opener-Policy': 'same-origin', 'Cross-Origin-Resource-Policy': 'same-origin',
    'Cache-Control': 'no-cache'}


def is_loopback(host: str) -> bool:
    """Return whether a server is out of reach of other machines.

    Parameters
    ----------
    host : str
        Name or address to listen at.

    Returns
    -------
    bool
        Whether it is.
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


class Gatekeeper:
    """Filter that passes requests to an application only if they come from its own pages.

    The name in `Host` must be one of the server's, lest a foreign site let its own name point
    here; a socket must also name an `Origin`, which must be the same. The token is required once,
    in the address; then a cookie stands for it, whose name contains the port. Any other request is
    answered with 403.

    Parameters
    ----------
    app : ASGIApp
        The application.
    host : str
        Name or address to listen at.
    port : int
        Port to listen at.
    open_to_all : bool
        Whether there is no token: for a machine with one user, on loopback alone.

    Raises
    ------
    InputError
        If `open_to_all` and the server is not on loopback.
    """

    def __init__(self, app: ASGIApp, host: str, port: int, open_to_all: bool = False) -> None:
        if open_to_all and not is_loopback(host):
            raise InputError('token', f'expected true: pages are served over a network ({host})')
        self._app = app
        self._names = set(_names(host))
        self._anywhere = not is_loopback(host) and _is_wildcard(host)
        self.token = '' if open_to_all else secrets.token_urlsafe(24)
        self._session = secrets.token_urlsafe(24)
        self._cookie = f'microbot_cockpit_{port}'

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on; the arguments are those of ASGI."""
        if scope['type'] == 'lifespan':
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        app: ASGIApp = self._app
        if not self._is_ours(headers, scope['type'] == 'websocket'):
            app = _FORBIDDEN
        elif self.token and not self._is_known(headers):
            app = self._welcome(scope)
        if scope['type'] == 'websocket' and app is not self._app:
            await send({'type': 'websocket.close'})  # before it is accepted: 403
            return
        await app(scope, receive, _with_headers(send))

    def _is_ours(self, headers: Headers, is_socket: bool) -> bool:
        if len(headers.getlist('host')) != 1 or not self._is_our_name(headers['host']):
            return False
        origins = headers.getlist('origin')
        return origins == [f'http://{headers["host"]}'] or not (origins or is_socket)

    def _is_our_name(self, host: str) -> bool:
        name = _without_port(host)
        return name in self._names or (self._anywhere and _is_address(name))

    def _is_known(self, headers: Headers) -> bool:
        try:
            found = SimpleCookie(headers.get('cookie', '')).get(self._cookie)
        except CookieError:
            return False
        return found is not None and _same(found.value, self._session)

    def _welcome(self, scope: Scope) -> ASGIApp:
        """Return the response that sets the cookie, for a request with the token."""
        given = parse_qs(scope['query_string'].decode('latin-1')).get('token', [''])[0]
        if scope['type'] != 'http' or scope['path'] != '/' or not _same(given, self.token):
            return _FORBIDDEN
        response: Response = RedirectResponse('/', 303)
        response.set_cookie(self._cookie, self._session, httponly=True, samesite='strict')
        return response


_FORBIDDEN = PlainTextResponse('403: not from here, or without the token\n', 403)
"""Answer to requests that are refused; its status is that of HTTP."""


def _names(host: str) -> Iterable[str]:
    if is_loopback(host) or _is_wildcard(host):
        yield from _LOOPBACK
    if not is_loopback(host):
        yield host.lower()
        own = socket.gethostname().lower()
        yield from (own, f'{own}.local')


def _is_wildcard(host: str) -> bool:
    return _is_address(host) and ipaddress.ip_address(host).is_unspecified


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _without_port(host: str) -> str:
    """Return the name in a Host header, with any port, since a tunnel may have another."""
    if host.startswith('['):
        return host[1:].partition(']')[0].lower()
    return host.partition(':')[0].lower()


def _same(given: str, secret: str) -> bool:
    return secrets.compare_digest(given.encode(), secret.encode())


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message['type'] == 'http.response.start':
            headers = MutableHeaders(scope=message)
            headers.update({name: value for name, value in _HEADERS.items()
                            if name not in headers})
        await send(message)
    return sending
