"""The viewer in the browser, on viser: one tab's state each, one session for all."""

from __future__ import annotations

import io
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import TYPE_CHECKING

from hsvaos.flight import FlightError
from hsvaos.viewer.geometry import try_ground
from hsvaos.viewer.live import Live
from hsvaos.viewer.ports import free_port
from hsvaos.viewer.session import Session
from hsvaos.viewer.tab import Tab

if TYPE_CHECKING:
    import viser


class App:
    """The viewer's server.

    Args:
        session: The flight.
        host: Address to listen at.
        port: Port to listen at; the next free one if it is taken.

    Raises:
        FlightError: If viser is not installed.
        OSError: If the address or all ports from there cannot be used.
    """

    def __init__(self, session: Session, host: str = "127.0.0.1", port: int = 8080) -> None:
        try:
            import viser
        except ModuleNotFoundError:
            raise FlightError(
                "the viewer needs viser: pip install 'hsvaos[viewer]', or give --plain"
            ) from None
        # what is sent to a tab that closes at that very moment is lost, and that is all
        warnings.filterwarnings("ignore", r"Queued an? \w+ on a closed connection")
        self.session = session
        self.live = Live(session)
        self._ground = try_ground(session.flight, session.ground_m)
        self._tabs: dict[int, Tab] = {}
        self._lock = threading.Lock()
        free = free_port(host, port)
        with _quiet():
            self.server: viser.ViserServer = viser.ViserServer(host, free, verbose=False)
        self.host, self.port = host, self.server.get_port()
        self.server.scene.set_up_direction("-z")
        self.server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self.server.gui.set_panel_label(f"hsvaos: {session.flight.name}")
        self.server.initial_camera.far = 1e5
        self.server.on_client_connect(self._opened)
        self.server.on_client_disconnect(self._closed)

    @property
    def url(self) -> str:
        """Where to point a browser."""
        host = "localhost" if self.host in ("0.0.0.0", "::", "") else self.host
        return f"http://{host}:{self.port}"

    @property
    def tabs(self) -> tuple[Tab, ...]:
        """The tabs that are open."""
        with self._lock:
            return tuple(self._tabs.values())

    def _opened(self, client: viser.ClientHandle) -> None:
        tab = Tab(client, self.live, self._ground)
        with self._lock:
            self._tabs[client.client_id] = tab
        if client.client_id not in self.server.get_clients():  # closed while it was being built
            self._closed(client)

    def _closed(self, client: viser.ClientHandle) -> None:
        with self._lock:
            tab = self._tabs.pop(client.client_id, None)
        if tab is not None:
            tab.close()

    def close(self) -> None:
        """Drop all work and stop the server."""
        for tab in self.tabs:
            tab.close()
        self.live.close()
        with _quiet():
            self.server.stop()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep viser from printing a banner of its own."""
    with redirect_stdout(io.StringIO()):
        yield
