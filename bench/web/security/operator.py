"""One operator at a time: the lease that whoever commands a run must hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from bench.model.clock import NS, Clock
from bench.web.security.cookie import Login

AWAY_S = 60.0


@dataclass(frozen=True)
class Holder:
    """Who has the command, since when (UTC, seconds since 1970)."""

    login: Login
    since_utc_s: float


class Lease:
    """Belongs to one login; ends when the login has had no open socket for ``AWAY_S``. For one event loop."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._holder: Holder | None = None
        self._open: Counter[str] = Counter()
        self._last_seen_ns = 0

    @contextmanager
    def present(self, login: Login) -> Iterator[None]:
        """As long as this is entered, the login has an open socket."""
        self._open[login.id] += 1
        try:
            yield
        finally:
            self._open[login.id] -= 1
            if not self._open[login.id]:
                del self._open[login.id]
            if self._holder is not None and self._holder.login.id == login.id:
                self._last_seen_ns = self._clock.now_ns()

    def take(self, login: Login) -> Holder | None:
        """Give the command to ``login``; returns who had it before, if that was another login."""
        before = self.holder()
        if before is not None and before.login.id == login.id:
            return None
        self._holder = Holder(login, self._clock.utc_ns() / NS)
        self._last_seen_ns = self._clock.now_ns()
        return before

    def leave(self, login: Login) -> bool:
        """Give the command up; False if it was not this login's."""
        if not self.held_by(login):
            return False
        self._holder = None
        return True

    def held_by(self, login: Login) -> bool:
        """Return True if this login has the command."""
        holder = self.holder()
        return holder is not None and holder.login.id == login.id

    def holder(self) -> Holder | None:
        """Who has the command now."""
        if self._holder is not None and not self._open[self._holder.login.id]:
            away_ns = self._clock.now_ns() - self._last_seen_ns
            if away_ns > AWAY_S * NS:
                self._holder = None
        return self._holder

    def document(self) -> dict[str, object] | None:
        """Return the key ``operator`` of the state document (docs/live-protocol.md)."""
        holder = self.holder()
        return None if holder is None else {"name": holder.login.name, "since_utc_s": holder.since_utc_s}
