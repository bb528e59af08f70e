"""A lag hidden in the virtual rig is found from the page, without a terminal.

Takes some six minutes: two cores are too few for the rig, the browser and the search.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from cockpit.virtual import VirtualRig
from hands import arm, opened, part, take_control

pytestmark = [pytest.mark.soak, pytest.mark.timeout(900)]


def test_a_hidden_lag_is_found(browser: Any, tmp_path: Path) -> None:
    with VirtualRig(
            tmp_path, controller={'deadline_ms': 100.0},
            coil_driver={'command_timeout_ms': 400.0, 'max_command_age_ms': 400.0},
            # Slow enough that the search has processors left: the lag is of many frames even so.
            virtual_rig={'effect': 'alignment_lag', 'effect_parameters': ['tau_s=0.4'],
                         'frame_rate_hz': 10.0},
    ) as rig, opened(browser, rig.address) as page:
        arm(take_control(page))
        part(page, 'discovery')
        page.fill('#minutes', '2')
        page.click('#discover')
        page.wait_for_selector('#discover:has-text("Stop")')
        page.wait_for_selector('#discover:has-text("Start")', timeout=720_000)
        found, = (json.loads(file.read_text())
                  for file in (tmp_path / 'discoveries').glob('*/result.json'))
        assert found['verdict'] == 'named'
        assert found['effects'][0]['id'] == 'alignment_lag'
        assert page.get_attribute('#verdict', 'data-verdict') == found['verdict']
        told = dict(zip(page.locator('#findings dt').all_inner_texts(),
                        page.locator('#findings dd').all_inner_texts(), strict=True))
        assert told['effect'] == 'alignment lag'
        assert told['decided'] == found['decided'].replace('_', ' ')
        assert float(told['gap'].split()[0].replace('\u2212', '-')) == pytest.approx(
            found['gap']['after_um'], abs=1e-3)
        likeliest = max(found['experiments'][-1]['odds'].items(), key=lambda one: one[1])[0]
        assert page.inner_text('#odds .odds span').strip() == likeliest.replace('_', ' ')
        _read_the_report(page)


def _read_the_report(page: Any) -> None:
    """By the page's link: its words are there, styled, and every picture."""
    complaints: list[str] = []
    page.context.on('console', lambda said: complaints.append(f'{said.text} {said.location}')
                    if said.type == 'error' else None)
    with page.expect_popup() as opened:
        page.click('#discover-where a')
    report = opened.value
    report.wait_for_load_state()
    assert 'alignment lag' in report.inner_text('body')
    assert report.locator('img').count() > 0
    assert report.evaluate('[...document.images].every((one) => one.naturalWidth > 0)')
    assert complaints == []
