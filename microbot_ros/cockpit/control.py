"""Who has control, and whether the rig was armed on condition that somebody attends."""

from __future__ import annotations


class Control:
    """One page of those that are there has control; a page is a number.

    `attended`: the rig was armed on condition that the page in control is there. The coil driver
    judges that by heartbeats, which are passed on while it is so.
    """

    def __init__(self) -> None:
        self.holder: int | None = None
        self.attended = False
        self._pages: set[int] = set()
        self._seen_armed = False

    @property
    def pages(self) -> int:
        """How many there are."""
        return len(self._pages)

    def join(self, page: int) -> None:
        """Count a `page` that has come: it has control if no other has."""
        self._pages.add(page)
        if self.holder is None:
            self.holder = page

    def leave(self, page: int) -> None:
        """Forget a `page`. Its control goes to nobody: another takes it."""
        self._pages.discard(page)
        if self.holder == page:
            self.holder = None

    def take(self, page: int) -> None:
        """Give control to this `page`."""
        self.holder = page

    def attends(self, page: int) -> bool:
        """Whether a heartbeat of a `page` is one for the driver."""
        return self.attended and page == self.holder

    def arm(self, attended: bool) -> None:
        """Note that the rig is about to be armed, `attended` or not."""
        self.attended, self._seen_armed = attended, False

    def see(self, armed: bool) -> None:
        """Take in whether the rig is `armed`: one that is so no more is not attended either."""
        if self._seen_armed and not armed:
            self.attended = False
        self._seen_armed = armed
