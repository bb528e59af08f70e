"""What the cockpit's server needs of a rig."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from microbot_ros.drive.amplifier import Zero

Answer = str
"""What a node said of something that it did; '' where it said nothing."""

PictureListener = Callable[[int, bytes], None]
ParticleListener = Callable[[dict[str, Any]], None]


class RefusedError(Exception):
    """Something was not done; the message is the node's own reason, in one sentence."""


def zero_in(answer: Answer) -> str | None:
    """Return 'confirmed', 'sent' or 'unreachable' by the phrase of `Zero` with which an answer of
    the driver begins; None for another answer."""
    return next((zero.name.lower() for zero in Zero if answer.startswith(zero)), None)


class Rig(Protocol):
    """A rig as the server sees it: `state` and verbs, each in the server's thread.

    What takes time is a coroutine; all but `stick` end with what the node said, or raise
    RefusedError with its reason.
    """

    kinds: list[str]
    """The names of the kinds of particles that the tracker was taught."""

    def watch(self, picture: PictureListener, particles: ParticleListener) -> None:
        """From now on tell, from whatever thread: `picture(stamp_ns, jpeg)` for each picture, and
        `particles(message)` for what is seen in one, as the page is to have it."""

    def look(self, wanted: bool) -> None:
        """Whether anybody looks: listen to what is heard often, if it is `wanted`."""

    def camera(self) -> dict[str, Any] | None:
        """Width, height and pixel size of the full picture, and how it lies, once they are known:
        `width_px`, `height_px`, `pixel_size_um`, and rows `to_um` from pixels to µm.
        """

    def state(self) -> dict[str, Any]:
        """The parts of the page's state that the rig knows; finite numbers, None for unknown. And
        as `verdict`, where there is one, what a discovery of somebody else's found last."""

    async def keep_up(self) -> None:
        """Ask the rig for what it does not tell by itself, for as long as the server runs."""

    async def stop(self) -> Answer:
        """Zero the coils and disarm, by the driver itself.

        The answer, and the message of RefusedError where the zero is not confirmed although it
        could be, begin with one of the phrases of `Zero`.
        """

    async def arm(self) -> Answer:
        """Let currents flow; the request is sent once."""

    def attend(self) -> None:
        """Tell the driver that an operator is there."""

    def stick(self, x: float, y: float) -> None:
        """Say once where the stick is: `x` and `y` of −1 to 1, along the axes of the workspace."""

    async def goal(self, x_um: float, y_um: float, particle: int | None) -> Answer:
        """Send whatever is steered, or one `particle`, to a place, `x_um` and `y_um`."""

    async def clear_goals(self) -> Answer:
        """No goal and no path any more."""

    async def path(self, points_um: list[tuple[float, float]]) -> Answer:
        """Give a path to follow through `points_um`."""

    async def switch_controller(self, name: str) -> Answer:
        """Let the controller of that `name` drive."""

    async def set(self, name: str, value: Any) -> Answer:
        """Change the parameter of that `name` of the controllers to a `value`."""

    async def teach(self, like: bool, x: float, y: float, kind: str | None, stamp: int) -> Answer:
        """Show the tracker an example at (x, y) [px] of the frame with a `stamp` [ns]: one `like`
        a `kind` to follow, or unlike it.
        """

    async def record(self, on: bool, title: str) -> Answer:
        """Begin a recording under a `title` if it is to be `on`, or end it."""

    async def note(self, text: str) -> Answer:
        """Add a line of `text` to the notes of the recording that runs."""
