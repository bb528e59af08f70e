"""Somebody who never saw the page does the eight things that are done most, on the virtual rig.

Each press of the pointer counts, from where the task before ended; three are allowed for each.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from cockpit.virtual import VirtualRig
from hands import arm, draw, mode, on_page, opened, part, take_control

pytestmark = [pytest.mark.rig, pytest.mark.timeout(300)]
MOST = 3

_COUNT = """() => {
  window.presses = 0;
  addEventListener('pointerdown', ({ isTrusted }) => { window.presses += isTrusted; }, true);
}"""


def test_eight_tasks_take_three_clicks_each(browser: Any, tmp_path: Path) -> None:
    with VirtualRig(tmp_path, coil_driver={
            'command_timeout_ms': 500.0, 'max_command_age_ms': 500.0},
            controller={'controller': 'hold', 'deadline_ms': 100.0}) as rig, opened(
            browser, rig.address) as page:
        take_control(page)
        page.evaluate(_COUNT)
        presses: dict[str, int] = {}

        @contextmanager
        def task(name: str) -> Iterator[None]:
            before = page.evaluate('window.presses')
            yield
            presses[name] = page.evaluate('window.presses') - before

        with task('arm'):
            arm(page)
        with task('go'):
            mode(page, 'goal')
            page.click('#let-drive')
            page.wait_for_selector('#controller-now:has-text("At work: waypoint.")')
            page.mouse.click(*on_page(page, 420, 160))
            page.wait_for_selector('#overlay .way path', state='attached')
        with task('path'):
            mode(page, 'path')
            page.click('#let-drive')
            page.wait_for_selector('#controller-now:has-text("At work: path following.")')
            draw(page, [on_page(page, 200 + 20 * k, 240) for k in range(10)])
            page.wait_for_selector('#overlay .path polyline[points*=" "]', state='attached')
        with task('record with a note'):
            part(page, 'recording')
            page.click('#record')
            page.wait_for_selector('#recording-now:has-text("● Recording")')
            page.click('#note')
            page.keyboard.type('a bubble')
            page.keyboard.press('Enter')
            page.wait_for_selector('#messages li.ok:has-text("Note")')
        with task('stop'):
            page.click('#stop')
            page.wait_for_selector('#rig-chip[data-state=disarmed]')
        page.click('#record')
        page.wait_for_selector('#recording-now:has-text("Not recording")')
        with task('find the recording'):
            part(page, 'recording')
            page.wait_for_selector('#recordings li:has-text("a bubble") a:has-text("Replay")')
        part(page, 'drive')
        arm(page)
        with task('find the hidden effect'):
            part(page, 'discovery')
            page.click('#discover')
            page.wait_for_selector('#discover:has-text("Stop")')
            page.wait_for_selector('#discover-progress:visible')
        rig.signal('amplifier', signal.SIGSTOP)
        try:
            with task('find why it stopped'):
                page.wait_for_selector('#why:visible .cure', timeout=30_000)
        finally:
            rig.signal('amplifier', signal.SIGCONT)
        print(presses)
        assert len(presses) == 8
        assert max(presses.values()) <= MOST, presses
