"""Memory of the device that launches share: there once, so that a frame allocates nothing."""

import threading
from typing import Any

import warp as wp

_here = threading.local()


def scratch(use: str, size: int, dtype: Any, device: Any) -> Any:
    """Return an array to be written and read by the launches that come next.

    Every thread has its own, and for each use one: what was in it is lost with the next call for
    that use. It never moves, so a captured CUDA graph may hold it; the least power of two that is
    large enough is kept for good, at most twice the largest that was asked for, all sizes together
    four times.

    Args:
        use: What for.
        size: Elements.
        dtype: Warp type.
        device: Warp device.
    """
    held = _here.__dict__.setdefault("held", {})
    room = 1 << max(size - 1, 0).bit_length()
    key = (use, room, dtype, device.alias)
    if key not in held:
        held[key] = wp.empty(room, dtype=dtype, device=device)
    return held[key][:size]
