"""The exchange of one client with one instrument: input, output and status, apart from other clients'.

Several clients reach one simulated instrument at once (a controller and its guard). Its settings, errors and outputs
are common; unread replies are not: each client's wait here, are put into the instrument for the time of each of its
operations, and are told apart by the number of the message that asked for them. Locks say whose turn it is.

Source: IVI-6.1, 6.5 (lock transaction) and 2.6.1 (traffic of a client without the lock).
"""

from __future__ import annotations

import contextlib
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum

from sim_instruments.bus.live import LiveDevice, Reply
from sim_instruments.served.hislip_wire import is_ready
from sim_instruments.worlds.common.world import World

WAIT_MS = 5  # while a reply is not due yet, or a lock of another client is waited for
_NEAR_NS = 5_000_000  # a reply due sooner is slept for on the bench's clock


class LockAnswer(IntEnum):
    """Control code of an AsyncLockResponse."""

    FAILURE = 0
    EXCLUSIVE = 1
    SHARED = 2
    ERROR = 3


class HislipLocks:
    """Locks of one instrument: one client holds it, or several who share a key. Safe to use from all threads.

    Clients are named by any hashable object; their locks end with their session. The traffic of a client without the
    lock waits, it is not refused.
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._exclusive: object | None = None
        self._key = ""
        self._sharing: set[object] = set()

    def request(self, client: object, key: str) -> LockAnswer:
        """Ask for the exclusive lock (empty key) or a shared one; FAILURE while another client is in the way."""
        with self._guard:
            if client in (self._sharing if key else {self._exclusive}):
                return LockAnswer.ERROR
            others = self._sharing - {client}
            if self._exclusive not in (None, client) or (others and not self._fits(client, key)):
                return LockAnswer.FAILURE
            if not key:
                self._exclusive = client
                return LockAnswer.EXCLUSIVE
            self._key = key
            self._sharing.add(client)
            return LockAnswer.SHARED

    def _fits(self, client: object, key: str) -> bool:
        """Return whether it fits beside shared locks of others: the same key, or alone for one of those who share."""
        return key == self._key if key else client in self._sharing

    def release(self, client: object) -> LockAnswer:
        """Give one lock back, the exclusive one first; ERROR if the client holds none."""
        with self._guard:
            if self._exclusive is client:
                self._exclusive = None
                return LockAnswer.EXCLUSIVE
            if client in self._sharing:
                self._sharing.discard(client)
                return LockAnswer.SHARED
            return LockAnswer.ERROR

    def forget(self, client: object) -> None:
        """Give back everything a client held."""
        with self._guard:
            if self._exclusive is client:
                self._exclusive = None
            self._sharing.discard(client)

    def shut_out(self, client: object) -> bool:
        """Return whether a lock of others keeps this client's commands waiting."""
        with self._guard:
            if self._exclusive is not None:
                return self._exclusive is not client
            return bool(self._sharing) and client not in self._sharing

    def holders(self) -> tuple[bool, int]:
        """Return whether the exclusive lock is held, and by how many clients any lock is."""
        with self._guard:
            alone = {self._exclusive} - {None}
            return self._exclusive is not None, len(self._sharing | alone)


@dataclass
class ServedInstrument:
    """One instrument of a world, with the locks its clients take."""

    world: World
    device: LiveDevice
    locks: HislipLocks = field(default_factory=HislipLocks)

    @property
    def hung(self) -> bool:
        """Fault: connections open and stay open; what is sent is taken and forgotten, nothing is answered."""
        return self.device.faults.hang


class Exchange:
    """One client's dialogue with an instrument; used by the thread of that client only."""

    def __init__(self, instrument: ServedInstrument) -> None:
        self._instrument = instrument
        self._world, self._device = instrument.world, instrument.device
        self._output: deque[Reply] = deque()

    def command(self, message: bytes, message_id: int) -> bool:
        """Carry out one whole message; return whether it came before the reply to the one before could be sent."""
        return self._act(lambda: self._device.receive(message, end=True), message_id)

    def trigger(self, message_id: int) -> bool:
        """Trigger the instrument; return the same."""
        return self._act(self._device.trigger, message_id)

    def status_byte(self) -> int:
        """Return the status byte; a reply that was sent but not read yet counts as available."""
        with self._plugged_in():
            return self._device.status_byte()

    def clear(self) -> None:
        """Clear the device: unread replies of this client are dropped, sent or not."""
        with self._plugged_in():
            self._device.clear()
        self._output.clear()

    def confirm(self) -> None:
        """Take note that the client has read everything that was sent."""
        self._output = deque(reply for reply in self._output if not reply.sent)

    def due_ns(self) -> int | None:
        """Return the bench time at which the next reply is to be sent, None without one."""
        return next((reply.due_ns for reply in self._output if not reply.sent), None)

    def take_due(self) -> Reply | None:
        """Return the next reply that is due, None if none is."""
        reply = next((reply for reply in self._output if not reply.sent), None)
        if reply is None or reply.due_ns > self._world.clock.now_ns():
            return None
        reply.sent = True
        return reply

    def wait(self, *socks: socket.socket, idle: bool) -> None:
        """Wait for a message of the client, the next reply or, unless it is ``idle``, the next look at the locks."""
        due_ns, hung, clock = self.due_ns(), self._instrument.hung, self._world.clock
        if due_ns is not None and not hung and due_ns - clock.now_ns() <= _NEAR_NS:
            if not is_ready(*socks, limit_ms=0):
                clock.sleep_until_ns(due_ns)
        else:
            is_ready(*socks, limit_ms=None if idle and due_ns is None and not hung else WAIT_MS)

    def _act(self, operation: Callable[[], None], message_id: int) -> bool:
        overtaken = self.due_ns() is not None
        with self._plugged_in():
            before = list(self._output)
            operation()
        # a late reply would stay in the instrument as a stale one; here its message is known, so it goes
        self._output = deque(reply for reply in self._output if reply not in before)
        now_ns = self._world.clock.now_ns()
        for reply in self._output:
            reply.message_id, reply.due_ns = message_id, max(reply.ready_ns, now_ns + self._device.latency_ns)
        return overtaken

    @contextlib.contextmanager
    def _plugged_in(self) -> Iterator[None]:
        """Make this client's unread replies the instrument's for one bus operation."""
        device = self._device
        with self._world.bus_operation(device.latency_ns):
            others = device._replies
            device._replies = self._output
            try:
                yield
            finally:
                self._output, device._replies = device._replies, others
