"""A browser, and the cockpit's page in it: before a stand-in, or before the virtual rig."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from microbot_ros.cockpit.discovery import Discovery
from microbot_ros.cockpit.recordings import Recordings

sys.path.insert(0, str(Path(__file__).parent))
from hands import sizes

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')
FLAGS = ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
         '--disable-background-networking', '--disable-component-update', '--disable-sync']


class Browser:
    """Chromium; one that has crashed is started again for the next test."""

    def __init__(self, chromium: Any) -> None:
        self._chromium = chromium
        self._started = self._start()

    def _start(self) -> Any:
        return self._chromium.launch(executable_path=CHROMIUM, args=FLAGS)

    def new_context(self, **kind: Any) -> Any:
        """A window with storage of its own; keywords are Playwright's."""
        if not self.is_connected():
            self._started = self._start()
        return self._started.new_context(**kind)

    def is_connected(self) -> bool:
        """Whether it runs."""
        return bool(self._started.is_connected())

    def close(self) -> None:
        """End it."""
        self._started.close()


@pytest.fixture(scope='session')
def browser() -> Iterator[Any]:
    """Debian's Chromium without a screen, driven by Playwright."""
    playwright = pytest.importorskip('playwright.sync_api', reason='Playwright is not here')
    if CHROMIUM is None:
        pytest.skip('there is no chromium here')
    with playwright.sync_playwright() as driver:
        started = Browser(driver.chromium)
        yield started
        started.close()


@pytest.fixture
def rig() -> Any:
    """What stands in for a rig."""
    from stand_in import StandIn
    return StandIn()


@pytest.fixture
def server(rig: Any, tmp_path: Path) -> Iterator[Any]:
    """The cockpit's server before the stand-in."""
    from microbot_ros.cockpit.server import Server
    server = Server(rig, Discovery('', tmp_path), Recordings(tmp_path), '127.0.0.1', 0,
                    open_to_all=True)
    server.start()
    yield server
    rig.close()
    server.stop()


@pytest.fixture(params=sizes())
def size(request: pytest.FixtureRequest) -> Any:
    """Width and height of the window."""
    return request.param


@pytest.fixture
def open_page(browser: Any, server: Any, size: tuple[int, int]) -> Iterator[Any]:
    """Opens a page of the cockpit in a window of its own; keywords are those of a browser's
    context. A page that complains on its console fails the test."""
    width, height = size
    contexts, complaints = [], []

    def open_one(**kind: Any) -> Any:
        context = browser.new_context(**{'viewport': {'width': width, 'height': height}, **kind})
        contexts.append(context)
        page = context.new_page()
        page.on('pageerror', lambda error: complaints.append(str(error)))
        page.on('console', lambda said: complaints.append(said.text)
                if said.type == 'error' and 'WebSocket' not in said.text else None)
        page.goto(server.address)
        page.wait_for_selector('body:not(.lost)')
        page.wait_for_selector('#overlay .rings g', state='attached')
        return page

    yield open_one
    for context in contexts:
        context.close()
    assert not complaints


@pytest.fixture
def page(open_page: Any) -> Any:
    """The page, in control."""
    page = open_page()
    page.wait_for_selector('#arm:enabled')
    return page


