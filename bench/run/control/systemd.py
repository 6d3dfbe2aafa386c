"""Tells the service manager that the run lives, while it does.

Source: sd_notify(3), sd_watchdog_enabled(3): datagrams "READY=1", "WATCHDOG=1" at half of WATCHDOG_USEC, "STATUS=...",
"STOPPING=1" to the Unix socket named in NOTIFY_SOCKET ("@" in front: abstract name).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

from bench.model.posix import unix_socket
from bench.run.context import RunContext
from bench.run.stop import repeated

SILENCE_S = 5.0  # a part that was silent for longer is not well
_USEC = 1e-6


class ServiceNotice:
    """Sends to the socket in ``environment``; without one nothing is sent."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self.there = bool(address)  # somebody wants to know
        meant = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        limit = environment.get("WATCHDOG_USEC", "")
        self.watchdog_s = int(limit) * _USEC / 2.0 if meant and limit.isdecimal() and int(limit) else None

    def tell(self, *lines: str) -> None:
        """Send assignments; a manager that does not listen is no reason to stop."""
        if self._address:
            with suppress(OSError), unix_socket(socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)
                sender.sendto("\n".join(lines).encode(), self._address)


@contextmanager
def service_notice(context: RunContext, environment: Mapping[str, str]) -> Iterator[ServiceNotice]:
    """Feed the watchdog only while every part of the run is well."""
    notice = ServiceNotice(environment)

    def feed() -> None:
        silence_s = context.health.silence_s()
        silent = [part for part, seconds in silence_s.items() if seconds > SILENCE_S]
        step = context.step
        holding = "; ".join(context.stop.holds.reasons.values())
        where = "" if step is None else f"step {step.number} of {len(context.plan.steps)}"
        status = f"STATUS=holding at {where}: {holding}" if holding else f"STATUS={where}"
        notice.tell(status, *([] if silent else ["WATCHDOG=1"]))

    duties = [(notice.watchdog_s or 10.0, feed)] if notice.there else []
    with repeated(context.clock, context.stop, *duties):
        notice.tell("READY=1")
        try:
            yield notice
        finally:
            notice.tell("STOPPING=1")
