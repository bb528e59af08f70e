"""The operator reads where the particle goes, why a number is missing, and what happened."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest
from hands import arm, mode, on_page, part
from stand_in import WIDTH

pytestmark = pytest.mark.rig


def test_frame_rate_and_exposure_stand_beside_the_scale(page, rig) -> None:
    rig.told['frames'] = {'rate_hz': 59.7, 'exposure_ms': 2.5}
    page.wait_for_selector('#scale-words:has-text("µm · 60 frames/s · exposed 2.5 ms")')


def test_where_it_goes_how_far_and_that_it_arrived_is_told(page, rig) -> None:
    def report(**more: Any) -> None:
        rig.told['controller'] = {**rig.told['controller'], 'driven': [2], 'goal': 1, **more}

    report(distance_um=43.74, done=False, sentence='waypoint: not armed: starts when armed')
    page.wait_for_selector('#going:text-is("Drives particle 2. '
                           'Status: waypoint: not armed: starts when armed.")')
    arm(page)
    page.wait_for_selector('#going:text-is("Drives particle 2. 43.7 µm to goal 2.")')
    report(distance_um=0.8, done=True)
    page.wait_for_selector('#going:text-is("Drives particle 2. Arrived.")')


def test_a_speed_that_is_withheld_has_its_reason(page, rig) -> None:
    held = {**rig.told['estimates'][0], 'v_um_s': None, 'v_std_um_s': None, 'phi_deg': None,
            'phi_std_deg': None, 'reason': 'held by a wall'}
    rig.told['estimates'] = [held, *rig.told['estimates'][1:]]
    part(page, 'estimates')
    page.wait_for_selector('#unknown-why:has-text("Speed and offset are not known: held by")')
    assert page.locator('#readings dd').all_inner_texts()[:2] == ['–', '–']
    page.select_option('#particle', '1')
    page.wait_for_selector('#unknown-why', state='hidden')


def test_the_event_log_is_filtered_and_downloaded(page, rig) -> None:
    rig.refusals['goal'] = 'the goal is outside the workspace'
    mode(page, 'goal')
    page.mouse.click(*on_page(page, 300, 200, WIDTH))
    part(page, 'events')
    refused = '#event-list li.refused:has-text("outside the workspace")'
    page.wait_for_selector(f'{refused}:has-text("page 1")')
    page.fill('#event-filter', 'two particles')  # of the tracker
    page.wait_for_selector('#event-list li:only-child:has-text("Two particles crossed.")')
    page.fill('#event-filter', '')
    page.check('#event-wrong')
    page.wait_for_selector('#event-list:not(:has(li.note, li.ok))')
    assert page.locator(refused).count() == 1
    with page.expect_download() as downloaded:
        page.click('#event-download')
    with Path(downloaded.value.path()).open(encoding='utf-8', newline='') as file:
        rows = list(csv.DictReader(file))
    assert [row['origin'] for row in rows if row['level'] == 'refused'] == ['page 1']
    assert {row['level'] for row in rows} <= {'refused', 'warning', 'error'}
    assert all(row['time'].endswith('Z') for row in rows)
