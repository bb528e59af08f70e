"""A browser before the cockpit: which pictures it showed when, and how old they were then."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

_FLAGS = ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
          '--disable-background-networking', '--disable-component-update', '--disable-sync']
_WATCH = """
window.shown = [];
addEventListener('DOMContentLoaded', () => {
  const picture = document.querySelector('#picture');
  new MutationObserver(() => window.shown.push(
    [picture.dataset.stamp, performance.timeOrigin + performance.now()])
  ).observe(picture, { attributes: true, attributeFilter: ['data-stamp'] });
});
"""
"""The page says in `data-stamp` what its picture shows."""


@contextmanager
def browser() -> Iterator[Any]:
    """Debian's Chromium, without a screen."""
    with sync_playwright() as driver:
        made = driver.chromium.launch(executable_path=shutil.which('chromium'), args=_FLAGS)
        yield made
        made.close()


@contextmanager
def page(browser: Any, address: str) -> Iterator[Any]:
    """The cockpit's page at an `address`, with a picture."""
    made = browser.new_page()
    made.add_init_script(_WATCH)
    made.goto(address)
    made.wait_for_selector('#picture[data-stamp]')
    yield made
    made.close()


def slow_down(page: Any, times: float) -> None:
    """Give the page's processor so many `times` as much to do."""
    page.context.new_cdp_session(page).send('Emulation.setCPUThrottlingRate', {'rate': times})


def forget(page: Any) -> None:
    """Begin anew with what was shown."""
    page.evaluate('window.shown.length = 0')


def shown(page: Any) -> tuple[np.ndarray, np.ndarray]:
    """The stamps (N,) [ns] of the pictures shown, and how old they were then (N,) [s]."""
    found = page.evaluate('window.shown')
    stamps = np.array([int(stamp) for stamp, _ in found])
    return stamps, 1e-3 * np.array([now for _, now in found]) - 1e-9 * stamps
