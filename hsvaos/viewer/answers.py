"""Answers to browsers, for the small servers of this package."""

from __future__ import annotations

import sys
import threading
from abc import ABC, abstractmethod
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from hsvaos.viewer.ports import free_port

_SAFE = {"X-Content-Type-Options": "nosniff", "Cache-Control": "no-store"}


class QuietServer(ThreadingHTTPServer):
    """A server with a thread a browser, which says nothing of those that leave early."""

    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of browsers that leave in the middle of an answer."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)


class Answers(BaseHTTPRequestHandler, ABC):
    """One request of a browser."""

    protocol_version = "HTTP/1.1"
    timeout = 120

    def do_GET(self) -> None:
        """Answer a browser."""
        self.answer()

    @abstractmethod
    def answer(self) -> None:
        """Answer the request in `path`."""

    def send(
        self,
        content: bytes,
        kind: str,
        status: HTTPStatus = HTTPStatus.OK,
        save: str | None = None,
        extra: dict[str, str] | None = None,
    ) -> None:
        """Send an answer.

        Args:
            content: What.
            kind: Its media type.
            status: HTTP status.
            save: File name under which the browser shall save it.
            extra: More headers.
        """
        self.send_response(status)
        headers = {**_SAFE, **(extra or {}), "Content-Type": kind}
        if save is not None:
            headers["Content-Disposition"] = f'attachment; filename="{save}"'
        if status is not HTTPStatus.NO_CONTENT:
            headers["Content-Length"] = str(len(content))
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the terminal belongs to the user."""


class PageServer:
    """A server that listens in a thread of its own.

    Args:
        handler: Answers requests.
        host: Address to listen at.
        port: Port to listen at; the next free one if it is taken.

    Raises:
        OSError: If the address or all ports from there cannot be used.
    """

    def __init__(self, handler: type[Answers], host: str, port: int) -> None:
        self._server = QuietServer((host, free_port(host, port)), handler)
        self.host, self.port = host, int(self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where to point a browser."""
        host = "localhost" if self.host in ("0.0.0.0", "::", "") else self.host
        return f"http://{host}:{self.port}"

    def close(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
