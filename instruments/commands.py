"""The verbs a driver writes its commands with: set, ask, confirm, check arguments, poll."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

from bench.model.clock import Clock, to_ns
from bench.model.errors import InstrumentError
from bench.model.ports import Action
from instruments.bus import BusSession
from instruments.values import check_argument, read_number

T = TypeVar("T")


class Commands:
    """Commands with their checks; ``timeout_s`` limits a plain command."""

    timeout_s: ClassVar[float] = 1.0
    bus: BusSession
    clock: Clock
    actions: Mapping[str, Action]

    def set(self, command: str) -> None:
        """Send one set command, once, and read the error queue empty. Raises: InstrumentError B-INST-005."""
        self._ready()
        self.bus.write(command, self.timeout_s)
        self.check_errors(command)

    def check_errors(self, command: str) -> None:
        """Raise InstrumentError B-INST-005 with every queued error."""
        if problems := self.drain_errors():
            raise self.error("B-INST-005", f"after {command!r} the instrument reports: {'; '.join(problems)}")

    def ask(self, query: str, parse: Callable[[str], T], timeout_s: float | None = None) -> T:
        """Ask a query that may be repeated and return what ``parse`` makes of the reply."""
        self._ready()
        return self.bus.query(query, parse, self.timeout_s if timeout_s is None else timeout_s)

    def confirm(self, query: str, wanted: float, tolerance: float, unit: str) -> None:
        """Raise InstrumentError B-INST-011 unless the setting read back is ``wanted`` within ``tolerance``."""
        self.agree(query, self.ask(query, read_number), wanted, tolerance, unit)

    def agree(self, query: str, found: float, wanted: float, tolerance: float, unit: str) -> None:
        """Raise InstrumentError B-INST-011 unless ``found`` is ``wanted`` within ``tolerance``."""
        if not abs(found - wanted) <= tolerance:
            message = f"{query!r} reads back {found!r} {unit}, but {wanted!r} {unit} was set"
            raise self.error("B-INST-011", message, "look for another controller or a front panel in use")

    def checked(self, action: str, **arguments: object) -> list[Any]:
        """The arguments of an action after its declared limits. Raises: InstrumentError B-INST-008."""
        accepted = []
        for parameter in self.actions[action].parameters:
            try:
                accepted.append(check_argument(parameter, arguments[parameter.name]))
            except ValueError as error:
                raise self.error("B-INST-008", f"{action}: {error}; nothing was sent", "correct the sequence") from None
        return accepted

    def poll(self, done: Callable[[], bool], limit_s: float, period_s: float) -> bool:
        """Call ``done`` each ``period_s`` on the bench clock until it is true (True) or ``limit_s`` is over (False)."""
        end_ns = self.clock.now_ns() + to_ns(limit_s)
        while not done():
            if self.clock.now_ns() >= end_ns:
                return False
            self.clock.sleep(period_s)
        return True

    def error(self, code: str, message: str, next_step: str = "") -> InstrumentError:
        """An error that names this role and resource."""
        return InstrumentError(code, message, where=self.bus.where, next_step=next_step)

    def drain_errors(self) -> list[str]:
        """Get all queued errors, oldest first."""
        raise NotImplementedError

    def _ready(self) -> None:
        raise NotImplementedError
