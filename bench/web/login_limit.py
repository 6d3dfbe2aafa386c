"""How often wrong tokens may be tried."""

from __future__ import annotations

from collections import deque

from bench.model.clock import NS, Clock

WINDOW_S = 60
MOST_OF_ADDRESS = 5
MOST_IN_ALL = 30


class LoginLimit:
    """Counts failures of the last minute, by address and in all; holds at most ``MOST_IN_ALL`` of them."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._failures: deque[tuple[int, str]] = deque(maxlen=MOST_IN_ALL)

    def wait_s(self, address: str) -> int:
        """Seconds until this address may try again, 0 for now."""
        now_ns = self._clock.now_ns()
        while self._failures and now_ns - self._failures[0][0] > WINDOW_S * NS:
            self._failures.popleft()
        own = [t_ns for t_ns, who in self._failures if who == address]
        times = [t_ns for t_ns, _ in self._failures]
        until = [found[-most] for found, most in ((own, MOST_OF_ADDRESS), (times, MOST_IN_ALL)) if len(found) >= most]
        return max((1 + int(WINDOW_S - (now_ns - t_ns) / NS) for t_ns in until), default=0)

    def failed(self, address: str) -> None:
        """A wrong token came from this address."""
        self._failures.append((self._clock.now_ns(), address))
