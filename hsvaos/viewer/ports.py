"""Ports to listen at."""

from __future__ import annotations

import errno
import socket

_TRIES = 100


def free_port(host: str, port: int) -> int:
    """Return the port, or the next one that is free; port 0 stays 0, for any.

    Args:
        host: Address to listen at.
        port: The first port to try.

    Raises:
        OSError: If the address is not one of this machine's, or no port is free or allowed.
    """
    if port == 0:
        return 0
    kind = socket.AF_INET6 if ":" in host else socket.AF_INET
    last = min(port + _TRIES, 65536)
    for candidate in range(port, last):
        with socket.socket(kind, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, candidate))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    reason = error.strerror or str(error)
                    text = f"cannot listen at {host}:{candidate}: {reason}"
                    raise OSError(error.errno, text) from None
                continue
            return candidate
    raise OSError(errno.EADDRINUSE, f"no free port from {port} to {last - 1} at {host}")
