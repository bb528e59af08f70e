"""Who has control, and whether somebody is there."""

from __future__ import annotations

UNATTENDED_S = 3.0
"""So long after the last heartbeat an attended rig is disarmed [s]."""


class Control:
    """One page of those that are there has control; a page is a number.

    `attended`: the rig was armed on condition that the page in control is there.
    """

    def __init__(self) -> None:
        self.holder: int | None = None
        self.attended = False
        self._pages: set[int] = set()
        self._heard_s = 0.0

    @property
    def pages(self) -> int:
        """How many there are."""
        return len(self._pages)

    def join(self, page: int) -> None:
        """A `page` has come: it has control if no other has."""
        self._pages.add(page)
        if self.holder is None:
            self.holder = page

    def leave(self, page: int) -> None:
        """A `page` has gone. Its control goes to nobody: who wants it takes it."""
        self._pages.discard(page)
        if self.holder == page:
            self.holder = None

    def take(self, page: int) -> None:
        """From now on this `page` has control."""
        self.holder = page

    def heard(self, page: int, now_s: float) -> None:
        """Somebody is there at `now_s` [s], in front of a `page`."""
        if page == self.holder:
            self._heard_s = now_s

    def armed(self, attended: bool, now_s: float) -> None:
        """The rig was armed at `now_s` [s], `attended` or not."""
        self.attended, self._heard_s = attended, now_s

    def deserted(self, now_s: float) -> bool:
        """Whether the rig is to be disarmed at `now_s` [s] because nobody is there."""
        return self.attended and not now_s - self._heard_s <= UNATTENDED_S
