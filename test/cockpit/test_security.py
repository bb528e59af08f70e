"""Who gets in: this origin alone, and only with the token."""

from __future__ import annotations

import http.client
import socket
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

import pytest
from cockpit.conftest import get
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from microbot_ros.cockpit.connections import MOST, BriefConnection
from microbot_ros.cockpit.security import Gatekeeper, is_loopback
from microbot_ros.cockpit.server import Server
from microbot_ros.common.errors import InputError


def upgrade(port: int, host: str, origins: list[str], cookie: str = '') -> int:
    """The status that a socket is answered with."""
    connection = http.client.HTTPConnection('127.0.0.1', port, timeout=10)
    connection.putrequest('GET', '/socket', skip_host=True)
    for name, value in (
            ('Host', host), ('Upgrade', 'websocket'), ('Connection', 'Upgrade'),
            ('Sec-WebSocket-Key', 'dGhlIHNhbXBsZSBub25jZQ=='), ('Sec-WebSocket-Version', '13'),
            *(('Origin', origin) for origin in origins), *[('Cookie', cookie)][:bool(cookie)]):
        connection.putheader(name, value)
    connection.endheaders()
    status = connection.getresponse().status
    connection.close()
    return status


@pytest.mark.parametrize('host', ['127.0.0.1', 'localhost', '[::1]', 'LOCALHOST'])
def test_own_names_get_in_by_any_port(served: Any, host: str) -> None:
    for port in (served.port, 9999):  # a tunnel ends at another
        name = f'{host}:{port}'
        assert get(served.port, Host=name).status == 200
        assert upgrade(served.port, name, [f'http://{name}']) == 101


@pytest.mark.parametrize('host', [
    'evil.example', 'localhost.evil.example', '127.0.0.1.evil.example', '192.168.1.7', '0.0.0.0',
    '', '127.0.0.1@evil.example', '[::2]', 'evil.example:127.0.0.1'])
def test_a_foreign_host_is_refused(served: Any, host: str) -> None:
    assert get(served.port, Host=host).status == 403
    assert get(served.port, '/page/index.html', Host=host).status == 403
    assert upgrade(served.port, host, [f'http://{host}']) == 403


def test_a_socket_needs_its_own_origin(served: Any) -> None:
    name = f'127.0.0.1:{served.port}'
    for origins in ([], ['null'], [''], ['http://evil.example'], [f'https://{name}'],
                    [f'http://localhost:{served.port}'], ['http://127.0.0.1'],
                    [f'http://{name}/']):
        assert upgrade(served.port, name, origins) == 403, origins
    assert upgrade(served.port, name, [f'http://{name}', 'http://evil.example']) == 400
    assert upgrade(served.port, name, [f'http://{name}']) == 101


def test_a_foreign_origin_gets_no_page_either(served: Any) -> None:
    assert get(served.port, Origin='http://evil.example').status == 403


def test_two_hosts_are_none(served: Any) -> None:
    connection = http.client.HTTPConnection('127.0.0.1', served.port, timeout=10)
    connection.putrequest('GET', '/')
    connection.putheader('Host', 'evil.example')
    connection.endheaders()
    assert connection.getresponse().status in (400, 403)
    connection.close()


def test_nothing_can_be_posted_and_nothing_but_the_page_is_served(served: Any) -> None:
    assert get(served.port, method='POST').status == 405
    for path in ('/page/../server.py', '/page/%2e%2e/server.py', '/page/..%2fserver.py',
                 '/server.py', '/docs', '/openapi.json', '//etc/passwd'):
        assert get(served.port, path).status == 404, path


def test_every_answer_keeps_the_page_to_its_origin(served: Any) -> None:
    for path in ('/', '/page/index.html', '/nothing'):
        policy = get(served.port, path).headers['Content-Security-Policy']
        assert "default-src 'self'" in policy
        assert "frame-ancestors 'none'" in policy
        assert 'unsafe' not in policy
        assert '*' not in policy


class TestToken:
    """A server as it is by default, on this machine and everywhere."""

    @pytest.fixture(params=['127.0.0.1', '0.0.0.0'])
    def wide(self, request: Any, serve: Callable[..., Any]) -> Any:
        return serve(host=request.param, open_to_all=False)

    def test_without_the_token_nothing_answers(self, wide: Any) -> None:
        name = f'127.0.0.1:{wide.port}'
        for path in ('/', '/page/index.html', '/?token=', '/?token=wrong', '/?token=%ff%fe',
                     f'/page/?token={self.token(wide)}'):
            assert get(wide.port, path).status == 403, path
        assert upgrade(wide.port, name, [f'http://{name}']) == 403
        for cookie in ('', 'x', f'microbot_cockpit_{wide.port}=', self.token(wide),
                       f'microbot_cockpit_{wide.port}={self.token(wide)}',
                       f'microbot_cockpit_{wide.port}=é', '=;;"'):
            assert get(wide.port, Cookie=cookie).status == 403, cookie
            assert upgrade(wide.port, name, [f'http://{name}'], cookie) == 403, cookie

    def test_the_token_becomes_a_cookie_that_no_script_and_no_other_site_has(
            self, wide: Any) -> None:
        answer = get(wide.port, f'/?token={self.token(wide)}')
        assert (answer.status, answer.headers['Location']) == (303, '/')
        cookie, *attributes = answer.headers['Set-Cookie'].split('; ')
        assert {'HttpOnly', 'SameSite=strict', 'Path=/'} <= set(attributes)
        assert self.token(wide) not in cookie
        assert get(wide.port, Cookie=cookie).status == 200
        name = f'127.0.0.1:{wide.port}'
        assert upgrade(wide.port, name, [f'http://{name}'], cookie) == 101
        assert upgrade(wide.port, name, ['http://evil.example'], cookie) == 403
        assert get(wide.port, Cookie=cookie, Host='evil.example').status == 403

    def test_an_address_is_ours_where_all_are(self, serve: Callable[..., Any]) -> None:
        """A foreign site can give its own name our address, but no address a page of its own."""
        wide = serve(host='0.0.0.0', open_to_all=False)
        cookie = get(wide.port, f'/?token={self.token(wide)}').headers['Set-Cookie'].split(';')[0]
        assert get(wide.port, Cookie=cookie, Host=f'192.168.1.7:{wide.port}').status == 200

    def test_tokens_are_new_each_time(self, serve: Callable[..., Any]) -> None:
        tokens = {self.token(serve(open_to_all=False)) for _ in range(3)}
        assert len(tokens) == 3
        assert min(map(len, tokens)) >= 32

    def test_no_token_is_for_this_machine_alone(self, serve: Callable[..., Any]) -> None:
        with pytest.raises(InputError, match='token'):
            serve(host='0.0.0.0', open_to_all=True)

    @staticmethod
    def token(wide: Any) -> str:
        return str(wide.server.address.partition('token=')[2])


@given(st.text(max_size=60))
def test_no_name_but_ours_passes(name: str) -> None:
    gate = Gatekeeper(lambda *_: None, '127.0.0.1', 80)  # type: ignore[arg-type]
    ours = {'localhost', '127.0.0.1', '::1'}
    if gate._is_our_name(name):
        assert name.lower().partition(':')[0] in ours or name.lower().startswith('[::1]')


def test_loopback_is_told_from_the_rest() -> None:
    assert all(map(is_loopback, ('127.0.0.1', '127.9.9.9', '::1', 'localhost')))
    assert not any(map(is_loopback, ('0.0.0.0', '::', '192.168.1.7', 'rig.example', '')))


def test_a_port_that_is_taken_is_an_input_error(served: Any) -> None:
    with pytest.raises(InputError, match=f'port {served.port}'):
        Server(served.rig, None, None, '127.0.0.1', served.port)  # type: ignore[arg-type]


@pytest.mark.parametrize('host', ['no.such.host.invalid', '203.0.113.7', 'a b', '\x00', 'é' * 70])
def test_a_place_that_is_not_ours_is_an_input_error(host: str) -> None:
    with pytest.raises(InputError):
        Server(None, None, None, host, 0)  # type: ignore[arg-type]


def test_idle_connections_do_not_keep_a_page_out(served: Any) -> None:
    """Many that ask for nothing, or for half of something: the oldest make room."""
    held = [socket.create_connection(('127.0.0.1', served.port)) for _ in range(3 * MOST)]
    try:
        for one in held[::2]:
            with suppress(OSError):  # it had to make room
                one.sendall(b'GET / HTTP/1.1\r\nHost: 127')
        assert get(served.port).status == 200
        with served.page() as page:
            assert page.ask('stop')['ok']
            for _ in range(3 * MOST):
                held.append(socket.create_connection(('127.0.0.1', served.port)))
            assert page.ask('stop')['ok'], 'a page is none of those that make room'
        open_now = {one for one in served.server._uvicorn.server_state.connections
                    if isinstance(one, BriefConnection) and not one.transport.is_closing()}
        assert len(open_now) <= MOST
    finally:
        for one in held:
            one.close()


def test_a_request_that_never_ends_is_cut(
        serve: Callable[..., Any], monkeypatch: pytest.MonkeyPatch,
        patience: Callable[..., None]) -> None:
    patience(connection_s=0.2)
    served = serve()
    with socket.create_connection(('127.0.0.1', served.port), timeout=10) as one:
        one.sendall(b'GET / HTTP/1.1\r\nHost: 127')
        with suppress(ConnectionResetError):
            assert one.recv(100) == b''
    monkeypatch.undo()
    begin, begun = BriefConnection.connection_made, []
    monkeypatch.setattr(BriefConnection, 'connection_made', lambda connection, transport: (
        begin(connection, transport), begun.append(connection)))
    with served.page() as page:
        assert page.ask('stop')['ok']
        assert begun[-1]._end.cancelled(), 'a page outlives that'


def test_a_silent_page_makes_room_for_a_new_one(served: Any) -> None:
    with ExitStack() as stack:
        pages = [stack.enter_context(served.page()) for _ in range(16)]
        served.server._pages[4].heard_s -= 60.0
        served.server._pages[7].heard_s -= 30.0
        new = stack.enter_context(served.page())
        assert new.ask('stop')['ok']
        with pytest.raises(ConnectionClosed):
            pages[3].until(lambda _: False)
        assert pages[6].ask('stop')['ok'], 'it has spoken again'
        assert len(served.server._pages) == 16


def test_more_pages_than_can_be_are_refused(served: Any) -> None:
    with ExitStack() as stack:
        for _ in range(16):
            stack.enter_context(served.page())
        with pytest.raises(InvalidStatus), connect(
                f'ws://127.0.0.1:{served.port}/socket',
                origin=f'http://127.0.0.1:{served.port}'):  # type: ignore[arg-type]
            pass
