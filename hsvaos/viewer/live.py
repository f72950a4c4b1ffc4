"""Work in the background, newest first: what nobody waits for any more is dropped."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from time import monotonic

from hsvaos.viewer.pace import Pace, Quality
from hsvaos.viewer.render import PREVIEW_FRAMES, Picture
from hsvaos.viewer.request import Request
from hsvaos.viewer.session import Session
from hsvaos.viewer.weights import Abandoned, Wanted

STILL_S = 0.2
"""Time without a new request after which a picture is drawn in full."""

_PREVIEW_SCALE = 0.75


class Ticket:
    """What a job is told of its fate: call it to learn whether it is still wanted."""

    def __init__(self) -> None:
        self.replaced = False
        self.left = False

    def __call__(self) -> bool:
        """Whether no newer job has come and the owner is still there."""
        return not (self.replaced or self.left)

    def owned(self) -> bool:
        """Whether the owner is still there, although a newer job may have come."""
        return not self.left


Job = Callable[[Ticket], None]
OnError = Callable[[Exception], None]


class _Slot:
    """The newest job of one owner and kind."""

    def __init__(
        self, job: Job, on_error: OnError, ready: float, on_drop: Callable[[], None] | None
    ) -> None:
        self.job, self.on_error, self.ready, self.on_drop = job, on_error, ready, on_drop
        self.ticket = Ticket()

    def drop(self, left: bool) -> None:
        self.ticket.replaced = True
        self.ticket.left = self.ticket.left or left
        if self.on_drop is not None:
            self.on_drop()


class Worker:
    """One thread that does the newest job of every owner, in turn.

    A job is a function that may ask whether it is still wanted. Handing in a job of the same owner
    and kind drops the one before it, also while it runs. What a job raises goes to its `on_error`;
    the thread goes on.

    Args:
        name: Of the thread.
    """

    def __init__(self, name: str) -> None:
        self._waiting: OrderedDict[tuple[Hashable, str], _Slot] = OrderedDict()
        self._running: tuple[tuple[Hashable, str], _Slot] | None = None
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(
        self,
        owner: Hashable,
        kind: str,
        job: Job,
        on_error: OnError,
        delay_s: float = 0.0,
        only_if: Wanted | None = None,
        on_drop: Callable[[], None] | None = None,
    ) -> None:
        """Hand in a job; the one of that owner and kind before it is dropped.

        Args:
            owner: Whose job it is: see `forget`.
            kind: Jobs of different kinds do not drop each other.
            job: What to do.
            on_error: Told of what it raises.
            delay_s: Start it only after this time [s].
            only_if: Asked at the very moment: a follow-up must not drop a newer job.
            on_drop: Told if the job is dropped; must return at once.
        """
        with self._changed:
            if self._closed or (only_if is not None and not only_if()):
                return
            self._drop(owner, kind, left=False)
            self._waiting[owner, kind] = _Slot(job, on_error, monotonic() + delay_s, on_drop)
            self._changed.notify_all()

    def forget(self, owner: Hashable, kind: str | None = None) -> None:
        """Drop an owner's jobs, also the one that is running.

        Args:
            owner: Whose jobs.
            kind: Only those of this kind; None for all.
        """
        with self._changed:
            keys = list(self._waiting)
            if self._running is not None:
                keys.append(self._running[0])
            for key in keys:
                if key[0] == owner and kind in (None, key[1]):
                    self._drop(*key, left=True)

    def has(self, owner: Hashable, kind: str) -> bool:
        """Whether a job of that owner and kind waits or runs."""
        with self._changed:
            running = self._running
            busy = running is not None and running[0] == (owner, kind) and running[1].ticket()
            return busy or (owner, kind) in self._waiting

    def close(self) -> None:
        """Drop everything and end the thread."""
        with self._changed:
            self._closed = True
            for key in [*self._waiting, *([self._running[0]] if self._running else [])]:
                self._drop(*key, left=True)
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _drop(self, owner: Hashable, kind: str, left: bool) -> None:
        waiting = self._waiting.pop((owner, kind), None)
        if waiting is not None:
            waiting.drop(left)
        if self._running is not None and self._running[0] == (owner, kind):
            self._running[1].drop(left)

    def _next(self) -> _Slot | None:
        """Wait for a job that is due; None at the end."""
        with self._changed:
            self._running = None
            while not self._closed:
                now = monotonic()
                for key, slot in self._waiting.items():
                    if slot.ready <= now:
                        del self._waiting[key]
                        self._running = (key, slot)
                        return slot
                first = min((slot.ready for slot in self._waiting.values()), default=None)
                self._changed.wait(None if first is None else first - now)
            return None

    def _run(self) -> None:
        while (slot := self._next()) is not None:
            try:
                slot.job(slot.ticket)
            except Abandoned:
                pass
            except Exception as error:
                if slot.ticket():
                    _tell(slot.on_error, error)


def _tell(on_error: OnError, error: Exception) -> None:
    """Report a failure; a report that fails itself, as to a tab just closed, ends here."""
    try:
        on_error(error)
    except Exception as second:
        error.add_note(f"and it could not be reported: {second}")


class Live:
    """Pictures for several people at once: coarse while something moves, in full when it is still.

    Two threads: one draws pictures, one does what takes longer (finds, focus curves, films), so
    that a slider moves on meanwhile.

    Args:
        session: What is looked at.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.pace = Pace()
        self._pictures = Worker("hsvaos-pictures")
        self._slow = Worker("hsvaos-slow")

    def show(
        self,
        owner: Hashable,
        request: Request,
        deliver: Callable[[Picture], None],
        on_error: OnError,
    ) -> None:
        """Draw a picture, and if it is a coarse one draw it again in full soon after.

        A newer request of the same owner replaces it at any time.

        Args:
            owner: Who wants to see it.
            request: What to show.
            deliver: Gets every picture, in the drawing thread.
            on_error: Told of what goes wrong.
        """

        def draw(ticket: Ticket) -> None:
            if not request.moving:
                sharpen(ticket)
                return
            quality = self._quality(request)
            # it is quick, and shown although a newer one waits: else nothing would be seen at all
            # while events come faster than pictures
            picture = self.session.render(request, quality, ticket.owned)
            self.pace.measured(picture.rays, picture.integrate_ms)
            if not ticket.owned():
                raise Abandoned
            deliver(picture)
            if not quality.full:
                self._pictures.submit(owner, "picture", sharpen, on_error, STILL_S, ticket)

        def sharpen(ticket: Ticket) -> None:
            picture = self.session.render(request, Quality(), ticket)
            if not ticket():
                raise Abandoned
            deliver(picture)

        self._pictures.submit(owner, "picture", draw, on_error)

    def once(
        self,
        owner: Hashable,
        request: Request,
        deliver: Callable[[Picture], None],
        on_error: OnError,
        on_drop: Callable[[], None],
    ) -> None:
        """Draw one picture and no finer one after it: for pages that ask again themselves.

        Args:
            owner: Who wants to see it.
            request: What to show.
            deliver: Gets the picture, in the drawing thread.
            on_error: Told of what goes wrong.
            on_drop: Told where a newer request came first.
        """

        def draw(ticket: Ticket) -> None:
            picture = self.session.render(request, self._quality(request), ticket)
            if request.moving:
                self.pace.measured(picture.rays, picture.integrate_ms)
            deliver(picture)

        self._pictures.submit(owner, "picture", draw, on_error, on_drop=on_drop)

    def background(
        self, owner: Hashable, kind: str, job: Job, on_error: OnError, delay_s: float = 0.0
    ) -> None:
        """Do what takes longer; see `Worker.submit`."""
        self._slow.submit(owner, kind, job, on_error, delay_s)

    def busy(self, owner: Hashable) -> bool:
        """Whether a picture of that owner is still to come."""
        return self._pictures.has(owner, "picture")

    def forget(self, owner: Hashable, kind: str | None = None) -> None:
        """Drop the work of an owner who has gone, or the one kind of it that is not wanted."""
        self._pictures.forget(owner, kind)
        self._slow.forget(owner, kind)

    def close(self) -> None:
        """Drop all work and end the threads."""
        self._pictures.close()
        self._slow.close()

    def _quality(self, request: Request) -> Quality:
        if not request.moving:
            return Quality()
        mask, weights = request.mask, self.session.weights
        kind = {"rarity": "rarity_map", "ground": "plain"}.get(request.layer)
        kind = kind or weights.kind_of(mask.method)
        pixels, frames = request.view.width * request.view.height, self.session.frames(request)
        if weights.has(kind, mask):
            return self.pace.quality(pixels, len(frames))
        # masks of a few shrunk photos: no use in drawing them sharper
        quality = self.pace.quality(pixels, min(len(frames), PREVIEW_FRAMES))
        return Quality(min(quality.scale, _PREVIEW_SCALE))
