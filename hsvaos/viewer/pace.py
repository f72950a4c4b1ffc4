"""How coarse a picture must be to come in time: from the milliseconds that pictures took."""

from __future__ import annotations

from dataclasses import dataclass

MOVING_MS = 55.0
"""Time to integrate a picture while something is dragged; tone, encoding and transport come on top.

Below the 100 ms that feel immediate with room for a busy machine."""

_FIRST_NS = 10.0
"""Cost of a ray before any was measured [ns]."""

_MEMORY = 0.3
"""Share of a new measurement in the running mean."""

_SHARPEST = 1.0
_HALF = 0.5
_COARSEST = 0.2
_FEW_FRAMES = 12
"""Photos below which a picture is coarsened further rather than losing more of them: with few
photos single trees stand out as ghosts."""


@dataclass(frozen=True)
class Quality:
    """How much of a picture is computed.

    Args:
        scale: Factor on the sides of the picture.
        every: Only every so-manieth photo counts.
    """

    scale: float = 1.0
    every: int = 1

    @property
    def full(self) -> bool:
        """Whether nothing is left out."""
        return self.scale == 1.0 and self.every == 1


class Pace:
    """Chooses the quality of moving pictures; not thread-safe, one a worker.

    Args:
        budget_ms: Time that a moving picture may take.
    """

    def __init__(self, budget_ms: float = MOVING_MS) -> None:
        self.budget_ms = budget_ms
        self.ns_a_ray = _FIRST_NS

    def measured(self, rays: int, ms: float) -> None:
        """Take in what a picture cost.

        Args:
            rays: Pixels times photos.
            ms: Milliseconds.
        """
        if rays < 100_000:  # nothing but overhead
            return
        cost = min(1e6 * ms / rays, 4.0 * self.ns_a_ray)  # a picture that was held up by others
        self.ns_a_ray += _MEMORY * (cost - self.ns_a_ray)

    def expected_ms(self, rays: int) -> float:
        """Return the milliseconds that a picture of so many rays takes."""
        return 1e-6 * rays * self.ns_a_ray

    def quality(self, pixels: int, frames: int) -> Quality:
        """Return the best quality that keeps the time: fewer pixels first, then fewer photos.

        Args:
            pixels: Pixels of the whole picture.
            frames: Photos that count.
        """
        wanted = self.expected_ms(pixels * frames)
        if wanted <= self.budget_ms:
            return Quality()
        share = self.budget_ms / wanted
        scale = share**0.5
        if scale >= _HALF:
            return Quality(_stepped(scale), 1)
        every = max(1, min(round(_HALF**2 / share), frames // _FEW_FRAMES))
        scale = (share * every) ** 0.5
        return Quality(_stepped(min(_HALF, max(_COARSEST, scale))), every)


def _stepped(scale: float) -> float:
    """Round down to a twentieth, so that pictures do not flicker between sizes all the time."""
    return max(_COARSEST, min(_SHARPEST, int(scale * 20.0 + 1e-6) / 20.0))
