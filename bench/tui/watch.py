"""A run that is watched, as far as it is known: its last word, how old that is, its temperatures of the last hour.

A session for which nobody answers any more says from its folder how it ended, and what its guard did.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS, Clock
from bench.model.errors import BenchError
from bench.record import OPEN_MARKER, TrendReader
from bench.session.recorded_state import read_recording, scenery_of, state_at_the_end, unheard

AIR, UNIT = "bench.air", "bench.unit"
OLD_S = 3.0  # a run that has said nothing for so long is called lost
HOUR_S = 3600.0
BUCKET_S = 30.0
POINTS = 400  # of the last hour, from the trend beside the session

Range = tuple[float, float]
"""Least and greatest value."""


class Points(Protocol):
    """Answer of a feed (bench.run.control.client): its header, and the points in columns."""

    @property
    def header(self) -> Mapping[str, Any]: ...

    @property
    def t_utc_s(self) -> NDArray[np.float64]: ...

    @property
    def low(self) -> NDArray[np.float32]: ...

    @property
    def high(self) -> NDArray[np.float32]: ...


class Feed(Protocol):
    """A source that answers for a run."""

    def poll(self, since: int, state: bool = True) -> Points:
        """Return state and points from number ``since`` on. Raises: BenchError if nobody answers."""


@dataclass
class Trend:
    """Least and greatest temperature in each half minute of the last hour, by number of the half minute."""

    buckets: dict[int, Range] = field(default_factory=dict)
    newest: int = 0

    def add(self, t_utc_s: float, low: float, high: float) -> None:
        """Take a reading; one of long ago is forgotten at once."""
        number = int(t_utc_s // BUCKET_S)
        self.newest = max(self.newest, number)
        known = self.buckets.get(number, (low, high))
        self.buckets[number] = (min(known[0], low), max(known[1], high))
        oldest = self.newest - int(HOUR_S / BUCKET_S)
        if min(self.buckets) <= oldest:
            self.buckets = {at: bucket for at, bucket in self.buckets.items() if at > oldest}

    @property
    def span_s(self) -> float:
        """Time from the oldest to the newest reading, second."""
        return (self.newest + 1 - min(self.buckets, default=self.newest)) * BUCKET_S

    def ranges(self, count: int) -> list[Range | None]:
        """Return the known span in ``count`` parts of equal length, None for a part without a reading."""
        first = min(self.buckets, default=0)
        size = self.newest + 1 - first
        spans: list[Range | None] = [None] * count
        for number, (low, high) in self.buckets.items():
            begin = (number - first) * count // size
            for at in range(begin, max(begin + 1, (number + 1 - first) * count // size)):
                known = spans[at]
                spans[at] = (low, high) if known is None else (min(known[0], low), max(known[1], high))
        return spans


@dataclass
class Seen:
    """The contents of a page. ``age_s``: since the run answered last. ``last``: newest value of a signal.

    ``estimates``: those of the records so far, as in the
    state document of the page server; None while nobody has fitted them.
    """

    document: Mapping[str, Any]
    folder: str
    age_s: float = 0.0
    lost: bool = False
    last: dict[str, float] = field(default_factory=dict)
    trend: Trend = field(default_factory=Trend)
    estimates: Mapping[str, Any] | None = None

    def keep_trend(self, t_utc_s: NDArray[np.float64], low: NDArray[np.float32], high: NDArray[np.float32]) -> None:
        """Add readings of the unit, degC; a NaN is no reading."""
        for row in np.flatnonzero(np.isfinite(low) & np.isfinite(high)):
            self.trend.add(float(t_utc_s[row]), float(low[row]), float(high[row]))


class Watch:
    """Asks a feed again and again and remembers.

    Args:   folder: of the session. feed: who is asked. clock: real time.
            ended: how a session that nobody answers for ended; None while it has not.
    Raises: BenchError if the run does not answer the very first time.
    """

    def __init__(
        self,
        folder: Path,
        feed: Feed,
        clock: Clock,
        ended: Callable[[], Mapping[str, Any] | None],
        gone: type[Exception],
    ) -> None:
        self._feed, self._clock, self._ended, self._gone = feed, clock, ended, gone
        self._folder = folder
        self._since = 0
        self._boot = ""
        self._heard_ns = clock.now_ns()
        self.seen = Seen({}, str(folder))
        self._take(feed.poll(0))

    def look(self) -> Seen:
        """Ask once more; blocks as long as the feed does. Never raises because of a run that is gone."""
        if self.seen.document["state"] == "ended":
            return self.seen
        try:
            self._take(self._feed.poll(self._since))
        except self._gone:
            self._missed()
        return self._copy()

    def _copy(self) -> Seen:
        """Return a copy, so that what is drawn does not change meanwhile on another thread."""
        trend = Trend(dict(self.seen.trend.buckets), self.seen.trend.newest)
        return replace(self.seen, last=dict(self.seen.last), trend=trend)

    def _missed(self) -> None:
        seen = self.seen
        seen.age_s = (self._clock.now_ns() - self._heard_ns) / NS
        end = self._ended()
        if end is not None:
            seen.document = {**seen.document, "wait": None, "holds": {}, **end, "state": "ended"}
            seen.lost = False
        elif seen.age_s > OLD_S:
            seen.document = {**seen.document, **unheard(self._folder)}
            seen.lost = True

    def _take(self, reply: Points) -> None:
        header, seen = reply.header, self.seen
        self._heard_ns = self._clock.now_ns()
        seen.age_s, seen.lost = 0.0, False
        if header["boot_id"] != self._boot:
            self._boot, self._since = header["boot_id"], 0
        if header.get("state"):
            seen.document = header["state"]
        names = [str(signal["name"]) for signal in seen.document.get("signals") or ()]
        for name in (AIR, UNIT):
            if name in names:
                self._keep(name, reply, names.index(name))
        self._since = int(header["seq"])

    def _keep(self, name: str, reply: Points, column: int) -> None:
        low, high = reply.low[:, column], reply.high[:, column]
        known = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
        if len(known):
            newest = known[-1]
            self.seen.last[name] = (float(low[newest]) + float(high[newest])) / 2
        if name == UNIT:
            self.seen.keep_trend(reply.t_utc_s, low, high)


def remember_earlier(seen: Seen, folder: Path) -> None:
    """Fill the last hour of the trend; a session without one, or one that cannot be read, begins now."""
    now = seen.document.get("t_utc_s")
    if now is None:
        return
    try:
        trend = TrendReader(folder).window([UNIT], now - HOUR_S, now, POINTS)
    except (BenchError, OSError, ValueError):
        return
    seen.keep_trend(trend.t_utc_s, trend.low[:, 0], trend.high[:, 0])


def ending(folder: Path) -> Mapping[str, Any] | None:
    """Return what of the state document the end of a session says; None while it is open, or its recorder died with it.

    The outcome is null if the session does not say how it ended; of one that cannot be read only the guard is heard.
    """
    if (folder / OPEN_MARKER).exists() or not folder.is_dir():
        return None
    try:
        recording = read_recording(folder)
        return state_at_the_end(recording, scenery_of(recording))
    except (BenchError, OSError):
        return {"outcome": None, **unheard(folder)}
