"""One run as it is shown, and everybody who looks at it: the same state, points and heartbeat for all of them.

What waits to be sent to one browser is bounded, so that a browser that does not read costs nothing.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from bench.web.points import LastPoints, Points

LONGEST_QUEUE = 50

Outgoing = str | bytes


class Viewer:
    """The queue of one open page. Whoever reads too slowly loses what waits and gets a new snapshot instead."""

    def __init__(self, role: str) -> None:
        self.role = role  # viewer, operator or bench
        self.stale = True  # needs a snapshot before anything else makes sense
        self.dropped = 0  # times the queue overflowed
        self._queue: deque[Outgoing] = deque()
        self._filled = asyncio.Event()

    def put(self, message: Outgoing) -> None:
        """Hand over a message; never waits."""
        if self.stale:
            return  # the snapshot that comes will hold it
        if len(self._queue) >= LONGEST_QUEUE:
            self.dropped += 1
            self.ask_snapshot()
            return
        self._queue.append(message)
        self._filled.set()

    def ask_snapshot(self) -> None:
        """Throw away what waits; the next thing sent is a snapshot."""
        self._queue.clear()
        self.stale = True
        self._filled.set()

    def start(self, messages: Sequence[Outgoing]) -> None:
        """Begin again with the messages of a snapshot."""
        self._queue.clear()
        self._queue.extend(messages)
        self.stale = False
        self._filled.set()

    async def wait(self) -> None:
        """Return when there is something to send, or a snapshot to be made."""
        await self._filled.wait()

    def take(self) -> Outgoing | None:
        """Return the next message, None if there is none."""
        if self._queue:
            return self._queue.popleft()
        if not self.stale:
            self._filled.clear()
        return None


class Room:
    """A run as its viewers see it. ``state``: the state document of docs/live-protocol.md without a viewer's role."""

    def __init__(self, state: Mapping[str, Any]) -> None:
        self.viewers: set[Viewer] = set()
        self.state: dict[str, Any] = dict(state)
        self.points = LastPoints(0)
        self._changes = 0

    def enter(self, viewer: Viewer) -> None:
        """One more looks; the first thing sent is a snapshot, as soon as there is a state."""
        self.viewers.add(viewer)
        if self.state:
            viewer.ask_snapshot()

    def snapshot(self, viewer: Viewer) -> list[Outgoing]:
        """Return what a page needs to begin: the whole state, and the newest points as one batch."""
        points = self.points.all()
        document = {
            "type": "snapshot",
            "seq": self._changes,
            "state": {**self.state, "role": viewer.role},
            "points": {"first": points.first, "n": len(points)},
        }
        return [_text(document), points.batch()]

    def begin(self, state: Mapping[str, Any], points: Points | None = None) -> None:
        """Another process answers, or another place of a recording: everybody gets a snapshot of it."""
        self.state = dict(state)
        self.points = LastPoints(len(state.get("signals") or ()))
        if points is not None and len(points):
            self.points.add(points)
        for viewer in self.viewers:
            viewer.ask_snapshot()

    def change(self, **values: Any) -> None:
        """Put values into the state, and tell everybody."""
        self.become({**self.state, **values})

    def become(self, state: Mapping[str, Any]) -> None:
        """Another state; everybody is told what is different, nobody anything if nothing is."""
        patch = merge_patch(self.state, state)
        self.state = dict(state)
        if patch:
            self._changes += 1
            self._tell(_text({"type": "delta", "seq": self._changes, "patch": patch}))

    def show(self, points: Points, flags: int = 0) -> None:
        """Hand out newer points; not more often than ten times a second."""
        if len(points):
            self.points.add(points)
            self._tell(points.batch(flags))

    def beat(self, t_utc_s: float, age_s: float | None) -> None:
        """The sign of life. ``age_s``: since the run answered last, s; None if it never has."""
        self._tell(_text({"type": "heartbeat", "t_utc_s": t_utc_s, "age_s": age_s}))

    def _tell(self, message: Outgoing) -> None:
        for viewer in self.viewers:
            viewer.put(message)


def _text(document: Mapping[str, Any]) -> str:
    return json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def merge_patch(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Return the merge patch that turns ``old`` into ``new``; empty if nothing has changed.

    A null in a patch takes a key away, so null and absent count as the same; lists are sent whole.
    Source: RFC 7386 (JSON Merge Patch).
    """
    patch: dict[str, Any] = {key: None for key, value in old.items() if value is not None and new.get(key) is None}
    for key, value in new.items():
        before = old.get(key)
        if value is None or value == before:
            continue
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            if inner := merge_patch(before, value):
                patch[key] = inner
        else:
            patch[key] = value
    return patch
