"""Node `cockpit`: the operator's page; ROS in this thread, the page's server in another."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from microbot_ros.cockpit import address
from microbot_ros.common.extras import require
from microbot_ros.common.settings import setting
from microbot_ros.nodes.base.lifecycle import ERROR, OK, RigNode

if TYPE_CHECKING:
    from microbot_ros.cockpit.server import Server

_ATTEND_SECONDS = 0.05
"""Interval [s] at which subscriptions are updated. Choice: a new page waits for its picture as
long."""


@dataclass(frozen=True)
class CockpitParameters:
    """Parameters of the node `cockpit`."""

    host: str = setting(
        '127.0.0.1', 'Host name or address of this machine to listen on.', read_only=True)
    port: int = setting(8642, 'Port to listen at; 0 takes any that is free.', lower=0,
                        upper=65535, read_only=True)
    token: bool = setting(
        True, 'Pages need the token in the address, new at each start; false lets every user of '
        'this machine drive the rig, and is refused away from 127.0.0.1.', read_only=True)
    discoveries: str = setting(
        '', 'Folder for what discovery finds when a page starts it, a folder each; empty is '
        '~/.local/share/microbot_ros/discoveries.', read_only=True)
    recordings: str = setting(
        'recordings', 'Folder whose recordings (one folder each) pages list, replay and '
                      'download.', read_only=True)


class CockpitNode(RigNode):
    """Node that shows the rig of its namespace on a page and executes the operator's requests.

    It drives nothing by itself, and no other node needs it: requests go to the nodes that execute
    them, and their answers go back to the page.
    """

    Parameters: ClassVar[type] = CockpitParameters

    def setup(self) -> None:
        self._server: Server | None = None
        self._address: Path | None = None
        require('cockpit')
        from microbot_ros.cockpit.discovery import Discovery, default_folder
        from microbot_ros.cockpit.recordings import Recordings
        from microbot_ros.cockpit.server import Server
        from microbot_ros.nodes.client.operated_rig import OperatedRig

        values: CockpitParameters = self.settings
        self._operated = OperatedRig(self)
        folder = Path(values.discoveries).resolve() if values.discoveries else default_folder()
        self._server = Server(
            self._operated, Discovery(self.get_namespace(), folder),
            Recordings(Path(values.recordings).resolve()), values.host, values.port,
            open_to_all=not values.token)
        self.every(_ATTEND_SECONDS, self._operated.update_subscriptions)

    def start(self) -> None:
        assert self._server is not None
        if self._server.serving:
            return  # the page is served until the cleanup
        self._server.start()
        self._address = address.write(self._server.address, self._server.port)
        line = f'cockpit: {address.WORDS}{self._address}'
        print(address.shown(line, sys.stdout), flush=True)

    def teardown(self) -> None:
        server, self._server = getattr(self, '_server', None), None
        if server is not None:
            if self._address is not None:
                self._address.unlink(missing_ok=True)
            server.stop()
            self._operated.close()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        assert self._server is not None
        if not self._server.serving:
            return ERROR, 'the server of the page has ended', {}
        return OK, f'{self._server.pages} pages', {'pages': self._server.pages}
