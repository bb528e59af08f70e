"""What an operator's hands do on the page before the virtual rig."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

PIXEL_UM, WIDTH = 0.45, 640
"""Of the virtual microscope."""
SIZES = [(1440, 900), (360, 640), (844, 390), (390, 844), (768, 1024), (1024, 768), (2560, 1440)]
"""Windows in which the stories are played: the first two, side by side and upright, always; the
others in `make soak`."""
ALWAYS = 2


def sizes(always: int = ALWAYS) -> list[Any]:
    """All sizes as parameters; those after the first `always` only in `make soak`."""
    return [pytest.param(one, id=f'{one[0]}x{one[1]}',
                         marks=[pytest.mark.soak] if number >= always else [])
            for number, one in enumerate(SIZES)]


@contextmanager
def opened(browser: Any, address: str, size: tuple[int, int] = SIZES[0]) -> Iterator[Any]:
    """A page before the virtual rig at an `address`, in a window of its own."""
    with browser.new_context(viewport={'width': size[0], 'height': size[1]}) as context:
        page = context.new_page()
        page.goto(address)
        page.wait_for_selector('#overlay .rings g', state='attached', timeout=60_000)
        yield page


def take_control(page: Any) -> Any:
    """The `page`, once it has control."""
    page.wait_for_selector('#fact-control:not(:text-is("–"))')
    if page.is_visible('#take-control'):
        page.click('#take-control')
    page.wait_for_selector('#arm:enabled')
    return page


def arm(page: Any) -> None:
    """By holding the button; a busy machine may need a second try."""
    for _ in range(3):
        page.hover('#arm')
        page.mouse.down()
        page.wait_for_selector('#messages li:first-child:has-text("Arm:")', timeout=20_000)
        page.mouse.up()
        try:
            page.wait_for_selector('#rig-chip[data-state=armed]', timeout=2000)
        except Exception:
            continue
        return
    raise AssertionError(page.inner_text('#messages'))


def switch(page: Any, name: str) -> None:
    """Let the controller of that `name` drive."""
    page.select_option('#controller', name)
    page.click('#controller-form button')
    page.wait_for_selector(f'#controller-now:has-text("At work: {name.replace("_", " ")}.")')


def mode(page: Any, name: str) -> None:
    """What a click on the picture does from now on."""
    page.click(f'#modes label:has(input[value={name}])')


def on_page(page: Any, x_px: float, y_px: float, width_px: int = WIDTH) -> tuple[float, float]:
    """The point of the page over a pixel of the camera, whose pictures are `width_px` wide."""
    box = page.locator('#frame').bounding_box()
    scale = box['width'] / width_px
    return box['x'] + (x_px + 0.5) * scale, box['y'] + (y_px + 0.5) * scale


def draw(page: Any, places: Sequence[tuple[float, float]]) -> None:
    """Drag over `places` of the page, from the first to the last."""
    page.mouse.move(*places[0])
    page.mouse.down()
    for place in places[1:]:
        page.mouse.move(*place)
    page.mouse.up()


def part(page: Any, name: str) -> None:
    """Bring the part of the page with that id into view."""
    page.click(f'#tab-{name}')
