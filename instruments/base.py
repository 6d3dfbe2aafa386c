"""The base of all drivers: identity before anything else, errors drained after each set, limits that reject.

A driver adds its commands as small methods, declared with ``@action``; its limits are written once, in the declaration.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from typing import Any, ClassVar

from pyvisa.resources import MessageBasedResource

from bench.model.clock import NS, Clock
from bench.model.drivers import manual_of
from bench.model.errors import InputError, InstrumentError
from bench.model.ports import Identity, Parameter, Tells, Transcript, actions_of
from instruments.bus import BUS_FAILED, TIMED_OUT, BusSession
from instruments.commands import Commands
from instruments.ladder import Ladder
from instruments.transport import Need, lacking
from instruments.values import check_argument, read_text

WRONG_MODEL, EXCHANGED = "B-INST-002", "B-INST-016"
STRANGER = (WRONG_MODEL, EXCHANGED)


class BaseInstrument(Commands):
    """Base of all drivers.

    Class members: ``identity_pattern`` matches "manufacturer,model"; ``safe_state`` says in words what ``make_safe``
    leaves behind; ``default_options`` are the options a station may give, ``option_limits`` what each may be; a source
    of current names its ranges in ``ranges_A`` (ampere, lowest first), which the static check holds against the
    register of standards; ``spacing_s`` is the time between two commands, second (half of it in a hurry); ``reply_end``
    is the last character of a reply (what comes behind it is dropped, or stands before the next); ``tells`` says which
    replies show whether it is on, None for a model that holds no energy; ``needs`` is what its address must give
    besides messages; ``remote`` is what takes it out of local on a serial line, also behind a gateway, where no line of
    a bus does.

    Args: reopen: opens the same address again after a failure of the bus.   interface_clear: of the whole bus.
    """

    identity_pattern: ClassVar[str]
    identity_question: str = "*IDN?"
    safe_state: ClassVar[str]
    longest_error_queue: ClassVar[int] = 32
    default_options: ClassVar[Mapping[str, Any]] = {}
    option_limits: ClassVar[tuple[Parameter, ...]] = ()
    ranges_A: ClassVar[tuple[float, ...]] = ()
    spacing_s: ClassVar[float] = 0.0
    reply_end: ClassVar[str] = "\n"
    needs: ClassVar[tuple[Need, ...]] = ()
    remote: ClassVar[str] = ""
    tells: ClassVar[Tells | None] = None

    def __init__(
        self,
        resource: MessageBasedResource,
        *,
        role: str,
        clock: Clock,
        transcript: Transcript,
        options: Mapping[str, Any] | None = None,
        reopen: Callable[[], MessageBasedResource] | None = None,
        interface_clear: Callable[[], None] | None = None,
    ) -> None:
        self.role = role
        self.clock = clock
        self.actions = actions_of(type(self))
        self.options = {**self.default_options, **(options or {})}
        self.identity: Identity | None = None
        self.seen: dict[str, object] = {}
        self.kept = ()
        if manual := manual_of(type(self).__module__.rpartition(".")[2]):
            self.states = manual.states
        self._said = ""  # the last reply to the identity question
        self.bus = BusSession(resource, role, clock, transcript, self.spacing_s, self.reply_end)
        self.bus.climb = Ladder(self.bus, self._drain_known, self._readmit, reopen, interface_clear).climb
        if unknown := sorted(set(self.options) - set(self.default_options)):
            known = ", ".join(self.default_options) or "none"
            raise self.bad_option(f"unknown option {unknown[0]!r}; known: {known}")
        if wrong := self.wrong_option(self.options):
            raise self.bad_option(wrong[1])

    def identify(self) -> Identity:
        """Get who is there, refuse another model, then prepare the session. Raises: InstrumentError B-INST-002."""
        with self.bus.persistent():
            return self._identified()

    def _identified(self) -> Identity:
        identity = self._introduced()
        self.drain_errors()
        self.identity = identity
        try:
            self._prepare()
        except InstrumentError:
            self.identity = None
            raise
        return identity

    def introduce(self) -> Identity:
        """Get who is there and refuse another model; nothing is prepared: a first contact sends everything by hand.

        Raises: InstrumentError B-INST-002.
        """
        self.identity = self._introduced()
        return self.identity

    def _introduced(self) -> Identity:
        identity = self._ask_identity()
        if not self._is_right_model(identity):  # it may be the reply to a question of a controller that is gone
            self.bus.clear()
            identity = self._ask_identity()
        if not self._is_right_model(identity):
            message = f"{identity.manufacturer} {identity.model} answers where {self.identity_pattern!r} is due"
            raise self.error(WRONG_MODEL, message, "correct the address in the station file; nothing was switched")
        self.bus.echo = (self.identity_question, self._said)
        self._take_control()
        return identity

    def make_safe(self) -> None:
        """Set the declared safe state; idempotent. Raises: InstrumentError B-INST-009 if it cannot be confirmed.

        One that is not prepared yet is not prepared either: what is on is switched off before anything else is set.
        One that does not answer is sent the command all the same, unless another model answers.
        """
        unprepared = self.identity is None
        try:
            with self.bus.persistent():
                if unprepared:
                    self.introduce()
                self._go_safe_somehow()
        except InstrumentError as error:
            if error.code == TIMED_OUT or (self.identity is None and error.code not in STRANGER):
                with suppress(InstrumentError):
                    self._go_safe_unheard()
            raise
        finally:
            if unprepared:
                self.identity = None

    def look(self) -> None:
        """Get what tells whether it is on, and how far; the replies go to the transcript. Raises: InstrumentError."""
        if self.tells is not None and self.identity is not None:
            for question in dict.fromkeys((*self.tells.on, *self.tells.figures)):
                self.bus.query(question, read_text, self.timeout_s)

    def silence_s(self) -> float:
        """Return for how long no question has been answered, second; 0 if the last one was."""
        return self.bus.silence_s()

    def heard_s(self) -> float:
        """Return how long ago it answered last, second."""
        return (self.clock.now_ns() - self.bus.heard_ns) / NS

    def quick(self, limit_s: float) -> AbstractContextManager[None]:
        """For a first pass over the whole bench in an emergency: the first question without an answer ends a method.

        No call waits longer than ``limit_s`` (second), nothing is asked again, cleared or reopened; so an instrument
        that is mute costs ``make_safe`` that time once. Afterwards the session gets back into step by itself.
        """
        return self.bus.hurry(limit_s)

    def drain_errors(self) -> list[str]:
        """Get all queued errors, oldest first. Raises: InstrumentError B-INST-006 if the queue does not end."""
        problems: list[str] = []
        while len(problems) <= self.longest_error_queue:
            problem = self._next_error()
            if problem is None:
                return problems
            problems.append(problem)
        message = f"the error queue does not end; {len(problems)} read, last {problems[-1]!r}"
        raise self.error("B-INST-006", message, "switch the instrument off and on, then check its cable")

    def raw(self, command: str, *, answers: bool = False) -> str | None:
        """Control by hand: send a command as it is; a query (with "?"), or what ``answers``, returns its reply."""
        self._ready()
        if answers or "?" in command:
            return self.bus.query(command, str, self.timeout_s, repeatable=False)
        self.bus.write(command, self.timeout_s)
        return None

    def close(self) -> None:
        """Release the bus session."""
        self.bus.close()

    def bad_option(self, message: str) -> InputError:
        """Return the error of a wrong option in the station file."""
        return InputError("B-INST-020", message, where=self.bus.where, next_step="correct the station file")

    @classmethod
    def wrong_option(cls, options: Mapping[str, Any]) -> tuple[str, str] | None:
        """Return the name of an option whose value the driver cannot use, and why; None if there is none.

        Args: options: all of ``default_options``, with the values of the station.
        """
        for limits in cls.option_limits:
            try:
                check_argument(limits, options[limits.name])
            except ValueError as error:
                return limits.name, str(error)
        return None

    @classmethod
    def lacking(cls, library: str, address: str) -> list[Need]:
        """Return which of its ``needs`` an address does not give through a VISA library, such as "@py"."""
        return lacking(cls.needs, library, address)

    def _ready(self) -> None:
        if self.identity is None:
            self._identified()

    def _take_control(self) -> None:
        if self.remote and self.bus.stream:
            self.bus.write(self.remote, self.timeout_s)

    def _prepare(self) -> None:
        """Set what the driver relies on, without touching any output."""
        self.bring("prepare")

    def _recheck(self) -> None:
        """Raise InstrumentError B-INST-011 unless what this run has set, and relies on, is still set."""
        self.confirm_kept()

    def _forget(self) -> None:
        """Drop what this run has set: another instrument is at the address, and there it is not set."""
        self.kept = ()

    def _safe_command(self) -> str:
        """Return what leads to the safe state, a command a line; sent unconfirmed to an instrument that is mute."""
        return ""

    def _go_safe_unheard(self) -> None:
        """Send what leads to the safe state to one that does not answer."""
        for command in self._safe_command().splitlines():
            self.bus.write(command, self.timeout_s)

    def _go_safe_somehow(self) -> None:
        try:
            self._go_safe()
        except InstrumentError as error:
            if error.code != BUS_FAILED or self.bus.hurried:
                raise
            self.bus.query(self.identity_question, read_text, self.timeout_s)  # climbs, as no command does
            self._go_safe()

    def _readmit(self) -> None:
        """After a reopening: the same instrument as before, prepared again, its settings as they were."""
        known = self.identity
        if known is None:
            return
        identity = self._ask_identity()
        if (identity.manufacturer, identity.model, identity.serial) != (known.manufacturer, known.model, known.serial):
            self.identity = None
            self._forget()
            message = (
                f"{identity.model} {identity.serial!r} answers after reopening, it was {known.model} {known.serial!r}"
            )
            raise self.error(EXCHANGED, message, "find out what was exchanged, then start again")
        self.drain_errors()
        self._take_control()
        self._prepare()
        self._recheck()

    def _drain_known(self) -> list[str]:
        return [] if self.identity is None else self.drain_errors()  # a stranger is asked nothing but who it is

    def _is_right_model(self, identity: Identity) -> bool:
        return bool(re.fullmatch(self.identity_pattern, f"{identity.manufacturer},{identity.model}", re.IGNORECASE))

    def _ask_identity(self) -> Identity:
        self._said = self.bus.query(self.identity_question, read_text, self.timeout_s)
        return self._identity_of(self._said)

    def _identity_of(self, reply: str) -> Identity:
        fields = [field.strip() for field in reply.split(",")]
        manufacturer, model, serial, firmware = [*fields, "", "", ""][:4]
        return Identity(manufacturer, model.removeprefix("MODEL "), serial, firmware)

    def _next_error(self) -> str | None:
        raise NotImplementedError

    def _go_safe(self) -> None:
        raise NotImplementedError
