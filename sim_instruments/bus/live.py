"""Base of all live simulated instruments: messages in, replies out, at the time of the world's clock.

A live device is a pyvisa-sim ``Device``, so pyvisa-sim's library and sessions know it; but it takes whole messages
(END on GPIB), keeps replies with the time they are ready, and answers serial poll and device clear.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pyvisa_sim.devices import Device

from bench.model.clock import NS, to_ns
from bench.model.drivers import manual_of
from sim_instruments.faults.fault import NamedFaults
from sim_instruments.worlds.common.world import World

MESSAGE_AVAILABLE = 16
LEFT_IN = 4  # one of so many users leaves a setting
MOST_ERRORS = 22  # more than the queues of all models but one hold
_NONSENSE = "NONSENSE"
_EOM_CLASSES = ("GPIB INSTR", "ASRL INSTR", "TCPIP INSTR", "TCPIP SOCKET", "USB INSTR")


@dataclass(eq=False)
class Reply:
    """One reply waiting in the instrument's output: bytes, when they are there, and whether END closes them.

    A server notes the number of the message that asked, when the reply is due at its client, and whether it was sent.
    """

    payload: bytes
    ready_ns: int
    end: bool = True
    late: bool = False  # held back by a fault: survives the next command, as a stale reply
    message_id: int = 0
    due_ns: int = 0
    sent: bool = False


class LiveDevice(Device):
    """One simulated instrument.

    Subclasses implement ``execute`` (one whole message, terminator removed) and call ``reply``; they may override
    ``on_clear``, ``on_interrupted``, ``on_starved``, ``status_byte`` and ``trigger``. All of it runs under the lock of
    the world.

    Args:
        world: the world that holds clock, wiring and faults.
        role: role of the instrument in the station; names its faults and its random draws.
        options: the station's options of this instrument.
    """

    named_faults: ClassVar[NamedFaults] = {}  # what can go wrong with this model only
    identity = ""
    latency_s = 0.002  # one bus operation: addressing, handshake, parsing
    not_a_number = "+9.91000000E+37"  # SCPI-99 vol. 1, 7.2.1.5
    overload = "+9.90000000E+37"

    def __init__(self, world: World, role: str, options: Mapping[str, Any]) -> None:
        super().__init__(role, b"")
        for type_class in _EOM_CLASSES:
            self.add_eom(type_class, "\n", "\n")
        self.world = world
        self.role = role
        self.options = dict(options)
        self.faults = world.faults.instrument(role)
        self.latency_ns = to_ns(self.latency_s)
        self._partial = bytearray()
        self._replies: deque[Reply] = deque()
        self.power_up()

    def power_up(self) -> None:
        """Begin with what is held from now on; called once, when world, role and options are known."""

    @property
    def held_until_ns(self) -> int:
        """Bench time until which the instrument holds the bus: a command is not taken before the one before is done."""
        return 0

    def execute(self, message: str) -> None:
        """Carry out one message; called with the world's lock held."""
        raise NotImplementedError

    def left_by_another(self, draw: np.random.Generator, *, by_hand: bool = True) -> list[str]:
        """Leave the instrument as its last user may have: rows of its state table, errors queued, half a command.

        Args:    by_hand: rows that only a person puts right are among them.
        Returns: the names of those rows.
        """
        manual = manual_of(type(self).__module__.rpartition(".")[2])
        states = manual.states if manual else {}
        open_to = {
            name: row
            for name, row in states.items()
            if row.left and (by_hand or not row.person) and row.of.items() <= self.options.items()
        }
        left = [name for name in open_to if draw.integers(LEFT_IN) == 0]
        for name in left:
            self.leave(str(draw.choice(states[name].left)))
        for _ in range(int(draw.integers(MOST_ERRORS))):
            self.execute(_NONSENSE)
        self._partial += b"VO"[: int(draw.integers(3))]
        self._replies.clear()
        return left

    def leave(self, setting: str) -> None:
        """Leave one setting as a row of the state table says: by a command, or by a key of the front panel."""
        key, _, pressed = setting.partition("key ")
        if pressed and not key:
            self.press(pressed)
        else:
            self.execute(setting)

    def press(self, keys: str) -> None:
        """Press a key of the front panel, with what is entered behind it."""
        raise NotImplementedError

    def on_clear(self) -> None:
        """Device clear (SDC): forget a half-made command; replies are dropped already."""

    def on_interrupted(self) -> None:
        """A command came while a reply was still unread: that reply is gone."""

    def on_starved(self) -> None:
        """A read came and there is nothing to say."""

    def status_byte(self) -> int:
        """Serial poll: IEEE-488.2 meaning of bit 4 (message available); models add their own bits."""
        return MESSAGE_AVAILABLE if self.reply_ready else 0

    def trigger(self) -> None:
        """Group execute trigger."""

    def outputs(self) -> dict[str, Any]:
        """Return what the instrument puts out or switches at this moment; empty for one that only measures."""
        return {}

    # --- used by subclasses ------------------------------------------------------------------------------------

    def rng(self, purpose: str, *indexes: int) -> np.random.Generator:
        """Return generator of one purpose; a second instrument of the same model draws for itself."""
        return self.world.rng(purpose if self.is_first else f"{purpose} of {self.role}", *indexes)

    @property
    def is_first(self) -> bool:
        """Whether this is the first instrument of its model on the bench; only that one is wired to the unit."""
        return self.world.instrument(type(self)) in (None, self)

    def partner(self, kind: type) -> Any:
        """Return the instrument of another model wired to this one: the first to the first, the second to the second.

        None if there is no such instrument; if there are fewer, the last of them.
        """
        own, others = (self.world.instruments_of(model) for model in (type(self), kind))
        return others[min(own.index(self), len(others) - 1)] if others else None

    def reading(self, text: str) -> str:
        """Return a reading as it is told: the text, or what the instrument says instead while a fault is on."""
        return self.faults.take_reading(text, self.not_a_number, self.overload)

    def read_out(self, register: str) -> str:
        """Return a register as it is told, and clear it."""
        value = getattr(self, register)
        setattr(self, register, 0)
        return str(value)

    @property
    def told_identity(self) -> str:
        """What it says it is, by a fault another."""
        return self.faults.identity or self.identity

    @property
    def now_ns(self) -> int:
        """Bench time, nanoseconds."""
        return self.world.clock.now_ns()

    def reply(self, text: str, *, after_s: float = 0.0, end: bool = True) -> None:
        """Put one reply into the output, there after ``after_s``."""
        if self.faults.mute or self.faults.hang:
            return
        payload = self.faults.garble(text.encode("latin-1")) + self._response_eom
        delay_s = self.faults.take_delay_s()
        ready_ns = self.now_ns + to_ns(after_s + delay_s)
        self._replies.append(Reply(payload, ready_ns, end, late=delay_s > 0))

    @property
    def reply_ready(self) -> bool:
        """Whether a reply can be read now."""
        return bool(self._replies) and self._replies[0].ready_ns <= self.now_ns

    # --- used by the VISA library ------------------------------------------------------------------------------

    def receive(self, chunk: bytes, end: bool) -> None:
        """Take bytes from the bus; ``end`` is the END message (or a terminator character stands at the end)."""
        if self.faults.hang:
            return
        self._partial += chunk
        if not end and not self._partial.endswith(b"\n"):
            return
        message = bytes(self._partial).rstrip(b"\r\n").decode("latin-1")
        self._partial.clear()
        if self._replies:
            self._drop_unread()
        self.execute(message)

    def clear(self) -> None:
        """Device clear: input and output are emptied; one that hangs does not notice."""
        if self.faults.hang:
            return
        self._partial.clear()
        self._replies.clear()
        self.on_clear()

    def next_reply(self) -> Reply | None:
        """Return the oldest reply, ready or not; it stays in the output. One that hangs gives none."""
        return self._replies[0] if self._replies and not self.faults.hang else None

    def take(self, reply: Reply, count: int) -> bytes:
        """Remove up to ``count`` bytes of the oldest reply."""
        chunk, reply.payload = reply.payload[:count], reply.payload[count:]
        if not reply.payload and self._replies and self._replies[0] is reply:
            self._replies.popleft()
        return chunk

    def _drop_unread(self) -> None:
        stale = [reply for reply in self._replies if reply.late and reply.ready_ns > self.now_ns]
        if len(stale) < len(self._replies):
            self.on_interrupted()
        self._replies = deque(stale)


class CommandError(Exception):
    """A command that is refused; ``args`` are those of ``CommandDevice.error``."""


class CommandDevice(LiveDevice):
    """An instrument whose messages are commands, separated by semicolons; the replies to one message go out as one."""

    _reply_after_s = 0.0

    def carry_out(self, command: str) -> str | None:
        """Carry out one command, which may be empty; returns its reply, if it has one. Raises: CommandError."""
        raise NotImplementedError

    def error(self, *args: Any, **kwargs: Any) -> None:
        """Note what was wrong with a command."""
        raise NotImplementedError

    def reply_after(self, seconds: float) -> None:
        """Make the reply of the command being carried out ready that much later (gate time, measurement)."""
        self._reply_after_s = max(self._reply_after_s, seconds)

    def reply_at(self, t_ns: int) -> None:
        """Make that reply ready at a bench time, or at once behind it."""
        self.reply_after((t_ns - self.now_ns) / NS)

    def execute(self, message: str) -> None:
        self._reply_after_s = 0.0
        replies = []
        for command in message.split(";"):
            try:
                replies.append(self.carry_out(command.strip()))
            except CommandError as problem:
                self.error(*problem.args)
        if told := [reply for reply in replies if reply is not None]:
            self.reply(";".join(told), after_s=self._reply_after_s)
