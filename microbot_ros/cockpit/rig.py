"""Interface of a rig for the cockpit's server."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from microbot_ros.drive.amplifier import Zero

Answer = str
"""Answer of a node to a request; '' for none."""

PictureListener = Callable[[int, bytes], None]
ParticleListener = Callable[[dict[str, Any]], None]


class RefusedError(Exception):
    """Error of a refused request; the message is the node's own reason, in one sentence."""


def zero_in(answer: Answer) -> str | None:
    """Return the state of the zero by which an answer of the driver begins.

    Parameters
    ----------
    answer : Answer
        Answer of the driver.

    Returns
    -------
    str or None
        'confirmed', 'sent' or 'unreachable'; None for another answer.
    """
    return next((zero.name.lower() for zero in Zero if answer.startswith(zero)), None)


class Rig(Protocol):
    """A rig as the server uses it: state and verbs, each in the server's thread.

    Methods that take time are coroutines; all but `stick` return the node's answer, or raise
    RefusedError with its reason.
    """

    kinds: list[str]
    """Names of the kinds of particles that the tracker was taught."""

    def watch(self, picture: PictureListener, particles: ParticleListener) -> None:
        """Set the listeners of pictures and particles, which are called from any thread.

        Parameters
        ----------
        picture : PictureListener
            Function that is called with stamp [ns] and JPEG of each picture.
        particles : ParticleListener
            Function that is called with the particles in a picture, as the page receives them.
        """

    def look(self, wanted: bool) -> None:
        """Set whether a page is open, so that frequent topics are needed.

        Parameters
        ----------
        wanted : bool
            Whether one is.
        """

    def camera(self) -> dict[str, Any] | None:
        """Return the geometry of the picture.

        Returns
        -------
        dict of str to object or None
            `width_px`, `height_px`, `pixel_size_um`, and rows `to_um` from pixels to µm; None
            until they are known.
        """

    def state(self) -> dict[str, Any]:
        """Return the state of the rig.

        Returns
        -------
        dict of str to object
            Parts by name, with finite numbers and None for unknown ones; `verdict` is the last
            result of a discovery started elsewhere, if any.
        """

    async def keep_up(self) -> None:
        """Request data that the rig does not publish, as long as the server runs."""

    async def stop(self) -> Answer:
        """Zero the coils and disarm, by the driver itself.

        Returns
        -------
        Answer
            Answer of the driver. It, and the message of RefusedError if the zero is not confirmed
            although it could be, begin with one of the phrases of `Zero`.
        """

    async def arm(self) -> Answer:
        """Arm; the request is sent once.

        Returns
        -------
        Answer
            Answer of the driver.
        """

    def attend(self) -> None:
        """Report the presence of an operator to the driver."""

    def stick(self, x: float, y: float) -> None:
        """Publish the position of the joystick once, along the axes of the workspace.

        Parameters
        ----------
        x, y : float
            Position from −1 to 1.
        """

    async def goal(self, x_um: float, y_um: float, particle: int | None) -> Answer:
        """Send the steered particles, or one particle, to a place.

        Parameters
        ----------
        x_um, y_um : float
            Place [µm].
        particle : int or None
            Number of the particle; None for the steered ones.

        Returns
        -------
        Answer
            Answer of the controller.
        """

    async def clear_goals(self) -> Answer:
        """Cancel all goals and the path.

        Returns
        -------
        Answer
            Answer of the controller.
        """

    async def path(self, points_um: list[tuple[float, float]]) -> Answer:
        """Send a path.

        Parameters
        ----------
        points_um : list of tuple[float, float]
            Points of the path [µm].

        Returns
        -------
        Answer
            Answer of the controller.
        """

    async def switch_controller(self, name: str) -> Answer:
        """Switch to another controller.

        Parameters
        ----------
        name : str
            Name of the controller.

        Returns
        -------
        Answer
            Answer for the page.
        """

    async def set(self, name: str, value: Any) -> Answer:
        """Change a parameter of the controllers.

        Parameters
        ----------
        name : str
            Name of the parameter.
        value : object
            Its value.

        Returns
        -------
        Answer
            Answer for the page.
        """

    async def teach(self, like: bool, x: float, y: float, kind: str | None, stamp: int) -> Answer:
        """Show the tracker an example.

        Parameters
        ----------
        like : bool
            Whether it shows the kind to follow, or not.
        x, y : float
            Position [px].
        kind : str or None
            Name of the kind; None for the one that fits best.
        stamp : int
            Stamp of the frame [ns].

        Returns
        -------
        Answer
            Answer of the tracker.
        """

    async def record(self, on: bool, title: str) -> Answer:
        """Begin or end a recording.

        Parameters
        ----------
        on : bool
            Whether to begin.
        title : str
            Title of the recording.

        Returns
        -------
        Answer
            Answer of the recorder.
        """

    async def note(self, text: str) -> Answer:
        """Add a line to the notes of the present recording.

        Parameters
        ----------
        text : str
            The line.

        Returns
        -------
        Answer
            Answer for the page.
        """
