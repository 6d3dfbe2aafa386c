"""The verbs a driver writes its commands with: set, ask, confirm, check arguments, poll.

A command that sets something is sent once. If it is in doubt whether it arrived, its effect is read back: as wanted,
the driver goes on; as before, the command is sent once more and read back again; anything else is an error.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial, wraps
from typing import Any, ClassVar, NamedTuple, TypeVar

from bench.model.clock import Clock, to_ns
from bench.model.drivers import Condition
from bench.model.errors import InstrumentError
from bench.model.ports import Action, StateRow, actions_of
from instruments.bus import DOUBTFUL, BusSession
from instruments.values import check_argument, exponent_form, read_integer, read_number, read_text

T = TypeVar("T")


@dataclass(frozen=True)
class ReadBack:
    """A readback that tells whether a command that may not have arrived took effect.

    ``see`` asks for the state; ``done`` and ``untouched`` judge it: as the command wants it, as it was before.

    What is neither is an error. ``untouched`` allows the command to be sent a second time.
    """

    see: Callable[[], Any]
    done: Callable[[Any], bool]
    untouched: Callable[[Any], bool]


def either(see: Callable[[], Any], wanted: object) -> ReadBack:
    """Return the read-back of a state that is as wanted or as before, there is no third: an output on or off."""
    return ReadBack(see, lambda value: value == wanted, lambda value: value != wanted)


class Setting(NamedTuple):
    """A number that was set: its question, its value, within what it must read back, in which unit.

    ``turn``: what may lie between two numbers that are the same place, such as 360 deg.
    """

    query: str
    wanted: float
    tolerance: float
    unit: str
    turn: float = math.inf


class Commands:
    """Commands with their checks; ``timeout_s`` limits a plain command, 1.5 s is the most.

    ``seen`` holds the last setting read back, by question: what it was before a command that is in doubt. ``kept`` is
    what this run has set, has read back and relies on. ``states``: the state table of the model (its YAML file).
    """

    timeout_s: ClassVar[float] = 1.0
    bus: BusSession
    clock: Clock
    actions: Mapping[str, Action]
    options: Mapping[str, Any]
    seen: dict[str, object]
    kept: tuple[Setting, ...]
    states: Mapping[str, Condition] = {}

    def __init_subclass__(cls, **named: Any) -> None:
        """Let each action of a driver refuse what its declaration does not allow, before anything is sent."""
        super().__init_subclass__(**named)
        for name, declared in actions_of(cls).items():
            if declared.parameters and name in vars(cls):
                setattr(cls, name, _within_limits(vars(cls)[name]))

    @property
    def station_words(self) -> Mapping[str, str]:
        """What stands for the words in braces of the state table; "" for what the station has not."""
        return {}

    def set(self, command: str, read_back: ReadBack | None = None) -> None:
        """Send one set command and read the error queue empty; see the module about what is in doubt.

        Raises: InstrumentError B-INST-005 (refused), B-INST-011 (in doubt, and neither done nor untouched), B-INST-001,
                B-INST-003, B-INST-004 (in doubt, and there is no read-back or it fails too).
        """
        self._ready()
        self.settle(command, read_back, self._send)

    def settle(self, command: str, read_back: ReadBack | None, send: Callable[[str], None]) -> None:
        """Send a command by ``send``, at most twice, and know afterwards that it took effect."""
        try:
            send(command)
        except InstrumentError as doubt:
            if read_back is None or doubt.code not in DOUBTFUL or self.bus.hurried:
                raise
            if self._took_effect(command, read_back, doubt):
                return
        else:
            return
        self.bus.note("tx", f"<{command} is sent again: it had no effect>")
        try:
            send(command)
        except InstrumentError as doubt:
            if doubt.code not in DOUBTFUL:
                raise
        value = read_back.see()
        if not read_back.done(value):
            raise self._differs(command, value)
        self.bus.note("rx", f"<{command} took effect: {value!r} reads back>")

    def check_errors(self, command: str) -> None:
        """Raise InstrumentError B-INST-005 with every queued error."""
        if problems := self.drain_errors():
            raise self.error("B-INST-005", f"after {command!r} the instrument reports: {'; '.join(problems)}")

    def ask(self, query: str, parse: Callable[[str], T], patience_s: float = 0.0) -> T:
        """Ask a query that may be repeated and return what ``parse`` makes of the reply.

        A reply that may take longer than ``timeout_s`` needs ``patience_s``, second; it is polled for.
        """
        self._ready()
        return self.bus.query(query, parse, self.timeout_s, patience_s=patience_s)

    def number(self, query: str, wanted: float, tolerance: float, turn: float = math.inf) -> ReadBack:
        """Return the read-back of a number, whole turns aside."""
        before = self.seen.get(query)
        return ReadBack(
            lambda: self.ask(query, read_number),
            lambda value: _are_alike(value, wanted, tolerance, turn),
            lambda value: isinstance(before, float) and _are_alike(value, before, tolerance, turn),
        )

    def put(self, setting: Setting, form: Callable[[float], str] = exponent_form) -> Setting:
        """Set a number by the command of its question, and return it. Raises: InstrumentError as ``set``."""
        read_back = self.number(setting.query, setting.wanted, setting.tolerance, setting.turn)
        self.set(f"{setting.query.removesuffix('?')} {form(setting.wanted)}", read_back)
        return setting

    def word(self, query: str, wanted: str) -> ReadBack:
        """Return the read-back of a word, of which there may be many."""
        before = self.seen.get(query)
        return ReadBack(lambda: self.ask(query, read_text).upper(), wanted.__eq__, lambda value: value == before)

    def bring(self, when: str) -> None:
        """Bring each setting of the state table that is due then to what the driver relies on.

        One question that shows several of them is asked once, until something is set.

        Raises: InstrumentError B-INST-019 (as it must not be, and no command mends it), B-INST-011, as ``set``.
        """
        replies: dict[str, str] = {}
        for name, condition, command, query in self._due():
            if when in condition.when:
                self._bring(name, condition, command, query, replies)

    def state_rows(self) -> Iterator[StateRow]:
        """Ask what the last user left, row by row of the state table; nothing is set."""
        replies: dict[str, str] = {}
        for name, condition, command, query in self._due():
            if reply := self._asked(query, condition, replies):
                advice = f"{condition.why}; {condition.person}"
                sets_it = command or ", ".join(condition.by)
                yield StateRow(name, sets_it, reply.strip(), condition.is_right(reply), advice)
            elif command:
                yield StateRow(name, command, "", None, "")

    def _due(self) -> Iterator[tuple[str, Condition, str, str]]:
        """Yield the rows of the state table that speak of what the station has, each with its command and question."""
        for name, condition in self.states.items():
            of_station = condition.of.items() <= self.options.items()
            if of_station and all(self.station_words[word] for word in condition.words):
                yield name, condition, *(text.format_map(self.station_words) for text in (condition.set, condition.ask))

    def judge(self, query: str, reply: str) -> None:
        """Raise InstrumentError B-INST-019 with every row of the state table that a reply shows as it must not be."""
        rows = {name: row for name, row in self.states.items() if row.ask == query and not row.is_right(reply)}
        if rows:
            reasons = "; ".join(dict.fromkeys(row.why for row in rows.values()))
            steps = "; ".join(dict.fromkeys(row.person for row in rows.values()))
            raise self.error("B-INST-019", f"{', '.join(rows)}: {query} tells {reply.strip()}: {reasons}", steps)

    def _asked(self, query: str, condition: Condition, replies: dict[str, str]) -> str:
        """Return the reply to a question, asked once for all rows that it shows; "" without one."""
        if query and query not in replies:
            replies[query] = self.ask(query, condition.read)
        return replies.get(query, "")

    def _bring(self, name: str, condition: Condition, command: str, query: str, replies: dict[str, str]) -> None:
        before = self._asked(query, condition, replies)
        if condition.is_right(before) if query else not command:
            return
        if not command:
            self.judge(condition.ask, before)
        replies.clear()
        if not query:
            self.set(command)
            return
        again = partial(self.ask, query, condition.read)
        self.set(command, ReadBack(again, condition.is_right, before.__eq__))
        if not condition.is_right(reply := again()) and reply != before:
            reply = again()  # neither the one nor the other: it may be garbled
        if not condition.is_right(reply):
            raise self.error("B-INST-011", f"{query!r} reads back {reply!r} after {command!r}: {name} is not right")

    def switch(self, query: str, wanted: int) -> ReadBack:
        """Return the read-back of something that is on (1) or off (0)."""
        return either(lambda: self.ask(query, read_integer), wanted)

    def confirm(self, query: str, wanted: float, tolerance: float, unit: str, turn: float = math.inf) -> None:
        """Raise InstrumentError B-INST-011 unless the setting read back is ``wanted`` within ``tolerance``."""
        self.agree(query, self.ask(query, read_number), wanted, tolerance, unit, turn)

    def keep(self, *settings: Setting) -> None:
        """Confirm each of these settings, then rely on them. Raises: InstrumentError B-INST-011."""
        self.kept = ()
        for setting in settings:
            self.confirm(*setting)
        self.kept = settings

    def confirm_kept(self) -> None:
        """Raise InstrumentError B-INST-011 unless everything this run relies on is as it was set."""
        for setting in self.kept:
            self.confirm(*setting)

    def require_kept(self, action: str, missing: str, next_step: str) -> None:
        """Raise InstrumentError B-INST-010 unless this run has set what an action needs."""
        if not self.kept:
            raise self.error("B-INST-010", f"{action} refused: no {missing} set by this run", next_step)

    def agree(
        self, query: str, value: float, wanted: float, tolerance: float, unit: str, turn: float = math.inf
    ) -> None:
        """Raise InstrumentError B-INST-011 unless ``value`` is ``wanted`` within ``tolerance``, whole turns aside."""
        self.seen[query] = value
        if not _are_alike(value, wanted, tolerance, turn):
            message = f"{query!r} reads back {value!r} {unit}, but {wanted!r} {unit} was set"
            raise self.error("B-INST-011", message, "look for another controller or a front panel in use")

    def refusal(self, message: str, undone: str = "nothing was sent") -> InstrumentError:
        """Return the error of an action that asks for what cannot be."""
        return self.error("B-INST-008", f"{message}; {undone}", "correct the sequence")

    def poll(self, done: Callable[[], bool], limit_s: float, period_s: float) -> bool:
        """Call ``done`` each ``period_s`` on the bench clock until it is true (True) or ``limit_s`` is over (False)."""
        end_ns = self.clock.now_ns() + to_ns(limit_s)
        while not done():
            if self.clock.now_ns() >= end_ns:
                return False
            self.clock.sleep(period_s)
        return True

    def switch_off(self, command: str, is_off: Callable[[], bool]) -> bool:
        """Send a command towards the safe state, whatever the error queue holds; True if it reads back.

        The one kind of command that is sent again when in doubt, whatever reads back: it can only make safer.
        """
        try:
            self._send_safe(command)
        except InstrumentError as doubt:
            if doubt.code not in DOUBTFUL or self.bus.hurried:
                raise
        else:
            return is_off()
        if not is_off():
            self._send_safe(command)
        return is_off()

    def error(self, code: str, message: str, next_step: str = "") -> InstrumentError:
        """Return an error that names this role and resource."""
        return InstrumentError(code, message, where=self.bus.where, next_step=next_step)

    def drain_errors(self) -> list[str]:
        """Get all queued errors, oldest first."""
        raise NotImplementedError

    def _send(self, command: str) -> None:
        self.bus.write(command, self.timeout_s)
        self.check_errors(command)

    def _send_safe(self, command: str) -> None:
        self.bus.write(command, self.timeout_s)
        self.drain_errors()

    def _took_effect(self, command: str, read_back: ReadBack, doubt: InstrumentError) -> bool:
        try:
            value = read_back.see()
        except InstrumentError as failure:
            if failure.code in DOUBTFUL:
                raise doubt from failure
            raise
        if read_back.done(value):
            self.bus.note("rx", f"<{command} took effect: {value!r} reads back>")
            return True
        if not read_back.untouched(value):
            raise self._differs(command, value) from doubt
        return False

    def _differs(self, command: str, value: object) -> InstrumentError:
        message = f"{command!r} was in doubt, and {value!r} reads back: not what was set, nor surely what was before"
        return self.error("B-INST-011", message, "look for another controller or a front panel in use")

    def _ready(self) -> None:
        raise NotImplementedError


def _are_alike(one: float, other: float, tolerance: float, turn: float) -> bool:
    return abs(math.remainder(one - other, turn)) <= tolerance


def _within_limits(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return an action that is begun only with arguments within its declared limits; what is left out is not judged."""
    signature = inspect.signature(method)

    @wraps(method)
    def limited(self: Commands, *arguments: Any, **named: Any) -> Any:
        given = signature.bind(self, *arguments, **named).arguments
        for parameter in self.actions[method.__name__].parameters:
            if parameter.name in given:
                try:
                    given[parameter.name] = check_argument(parameter, given[parameter.name])
                except ValueError as error:
                    raise self.refusal(f"{method.__name__}: {error}") from None
        return method(**given)

    return limited
