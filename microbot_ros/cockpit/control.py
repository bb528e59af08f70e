"""Which page has control, and whether the rig was armed on condition of an operator."""

from __future__ import annotations


class Control:
    """Control by one of the connected pages; a page is a number.

    `attended` means that the rig was armed on condition that the page in control is present. The
    coil driver checks that by heartbeats, which are passed on meanwhile.
    """

    def __init__(self) -> None:
        self.holder: int | None = None
        self.attended = False
        self._pages: set[int] = set()
        self._seen_armed = False

    @property
    def pages(self) -> int:
        """Number of pages."""
        return len(self._pages)

    def join(self, page: int) -> None:
        """Register a page, which gets control if no other page has it.

        Parameters
        ----------
        page : int
            Number of the page.
        """
        self._pages.add(page)
        if self.holder is None:
            self.holder = page

    def leave(self, page: int) -> None:
        """Remove a page. No page gets its control until one takes it.

        Parameters
        ----------
        page : int
            Number of the page.
        """
        self._pages.discard(page)
        if self.holder == page:
            self.holder = None

    def take(self, page: int) -> None:
        """Give control to a page.

        Parameters
        ----------
        page : int
            Number of the page.
        """
        self.holder = page

    def attends(self, page: int) -> bool:
        """Return whether a heartbeat of a page is passed on to the driver.

        Parameters
        ----------
        page : int
            Number of the page.

        Returns
        -------
        bool
            Whether it is.
        """
        return self.attended and page == self.holder

    def arm(self, attended: bool) -> None:
        """Register that the rig is about to be armed.

        Parameters
        ----------
        attended : bool
            Whether on condition that the page in control is present.
        """
        self.attended, self._seen_armed = attended, False

    def see(self, armed: bool) -> None:
        """Register whether the rig is armed; a rig that was disarmed is not attended either.

        Parameters
        ----------
        armed : bool
            Whether it is.
        """
        if self._seen_armed and not armed:
            self.attended = False
        self._seen_armed = armed
