"""What one client says to one instrument and what it gets back: input, output and status, apart from other clients'.

Several clients reach one simulated instrument at once (a controller and its guard). Its settings, errors and outputs
are common; unread replies are not: each client's wait here, are put into the instrument for the time of each of its
operations, and are told apart by the number of the message that asked for them.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from sim_instruments.bus.live import LiveDevice, Reply
from sim_instruments.served.hislip_locks import HislipLocks
from sim_instruments.worlds.common.world import World


class ServedInstrument:
    """One instrument of a world, with the locks its clients take."""

    def __init__(self, world: World, device: LiveDevice) -> None:
        self.world = world
        self.device = device
        self.locks = HislipLocks()

    @property
    def hung(self) -> bool:
        """Fault: connections open and stay open; what is sent is taken and forgotten, nothing is answered."""
        return self.device.faults.hang


@dataclass
class _Outgoing:
    reply: Reply
    message_id: int
    due_ns: int
    sent: bool = False


class Exchange:
    """One client's dialogue with an instrument; used by the thread of that client only."""

    def __init__(self, instrument: ServedInstrument) -> None:
        self._world, self._device = instrument.world, instrument.device
        self._output: deque[Reply] = deque()
        self._outgoing: list[_Outgoing] = []

    def command(self, message: bytes, message_id: int) -> bool:
        """Carry out one whole message; whether it came before the reply to the one before could be sent."""
        return self._act(lambda: self._device.receive(message, end=True), message_id)

    def trigger(self, message_id: int) -> bool:
        """Return group execute trigger; returns the same."""
        return self._act(self._device.trigger, message_id)

    def status_byte(self) -> int:
        """Serial poll; a reply that was sent but not read yet counts as available."""
        with self._plugged_in():
            return self._device.status_byte()

    def clear(self) -> None:
        """Device clear: unread replies of this client are dropped, sent or not."""
        with self._plugged_in():
            self._device.clear()
        self._outgoing.clear()

    def confirm(self) -> None:
        """The client has read everything that was sent."""
        read = [outgoing.reply for outgoing in self._outgoing if outgoing.sent]
        self._drop(lambda reply: any(reply is one for one in read))

    def due_ns(self) -> int | None:
        """Bench time at which the next reply is to be sent, None without one."""
        return next((outgoing.due_ns for outgoing in self._outgoing if not outgoing.sent), None)

    def take_due(self) -> tuple[Reply, int] | None:
        """The next reply that is due, with the number of the message that asked; None if none is."""
        for outgoing in self._outgoing:
            if not outgoing.sent:
                if outgoing.due_ns > self._world.clock.now_ns():
                    return None
                outgoing.sent = True
                return outgoing.reply, outgoing.message_id
        return None

    def _act(self, operation: Callable[[], None], message_id: int) -> bool:
        overtaken = any(not outgoing.sent for outgoing in self._outgoing)
        with self._plugged_in():
            asked_before = list(self._output)
            operation()
        # a late reply would stay in the instrument as a stale one; here its message is known, so it goes
        self._drop(lambda reply: any(reply is one for one in asked_before))
        now_ns = self._world.clock.now_ns()
        for reply in self._output:
            due_ns = max(reply.ready_ns, now_ns + self._device.latency_ns)
            self._outgoing.append(_Outgoing(reply, message_id, due_ns))
        return overtaken

    def _drop(self, unwanted: Callable[[Reply], bool]) -> None:
        self._output = deque(reply for reply in self._output if not unwanted(reply))
        kept = list(self._output)
        self._outgoing = [out for out in self._outgoing if any(out.reply is reply for reply in kept)]

    @contextlib.contextmanager
    def _plugged_in(self) -> Iterator[None]:
        """This client's unread replies are the instrument's for one bus operation."""
        device = self._device
        with self._world.bus_operation(device.latency_ns):
            others = device._replies
            device._replies = self._output
            try:
                yield
            finally:
                self._output, device._replies = device._replies, others
