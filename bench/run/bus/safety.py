"""Bring instruments to their safe state, whatever happened before, and say of each what is confirmed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Literal, Protocol

from bench.model.clock import Clock, to_ns
from bench.model.errors import BenchError, RunError
from bench.model.installed import unforeseen
from bench.model.ports import Instrument

ATTEMPTS = 3
PAUSE_S, PAUSES = 2.0, 4
QUICK_S = 0.45  # longest wait for an instrument in the first attempt: the ones after it must not wait for a mute one
# A command that a network or an instrument kept takes effect by then: who was away is confirmed once more behind it.
LATE_S = 3.0
NOBODY = ("B-INST-003", "B-RUN-002")  # the bus fails, the address does not open

SafeState = Literal["confirmed off", "commanded", "unreachable"]


class Safeable(Protocol):
    """As much of an instrument as has to be made safe."""

    def make_safe(self) -> None:
        """Set the declared safe state. Raises: whatever keeps it from being confirmed."""


@dataclass
class _Part:
    """An instrument on its way: its last error, and from when on an answer is final (None: at once)."""

    error: Exception | None = None
    sure_ns: int | None = None


class WayToSafe:
    """Instruments that are made safe in a stated order, in as many attempts as it takes.

    What is left may be asked for from another thread. One that failed once is confirmed by a second answer, ``LATE_S``
    after the first: something that it was told before it was away may still take effect. ``use`` is entered while one
    of them is talked to.
    """

    def __init__(
        self,
        instruments: Mapping[str, Safeable],
        order: Sequence[str],
        clock: Clock,
        use: Callable[[str], AbstractContextManager[object]] = lambda role: nullcontext(),
    ) -> None:
        self._instruments, self._clock, self._use = instruments, clock, use
        first = [role for role in order if role in instruments]
        self._parts = {role: _Part() for role in (*first, *(role for role in instruments if role not in first))}

    @property
    def left(self) -> dict[str, SafeState]:
        """What is not confirmed safe, by role: told to be, or nobody there."""
        return {role: _state_after(part.error) for role, part in list(self._parts.items())}

    @property
    def failures(self) -> dict[str, Exception]:
        """The last error of each that is not confirmed; those that only wait for their second answer have none."""
        return {role: part.error for role, part in list(self._parts.items()) if part.error is not None}

    def attempt(self, quick: Collection[str] = ()) -> None:
        """Make everything safe that is left, one after the other; ``quick``: roles that are not waited for."""
        for role, part in list(self._parts.items()):
            now_ns = self._clock.now_ns()
            if part.error is None and part.sure_ns is not None and now_ns < part.sure_ns:
                continue
            try:
                with self._use(role), hurried(self._instruments[role], QUICK_S if role in quick else None):
                    self._instruments[role].make_safe()
            except Exception as error:  # whatever it is, the instruments after this one must still be made safe
                part.error, part.sure_ns = error, None
                continue
            if part.error is None:
                del self._parts[role]
            else:
                part.error, part.sure_ns = None, self._clock.now_ns() + to_ns(LATE_S)


def _state_after(error: BaseException | None) -> SafeState:
    told = error is None or (isinstance(error, BenchError) and error.code not in NOBODY)
    return "commanded" if told else "unreachable"


def make_safe(
    instruments: Mapping[str, Instrument],
    order: Sequence[str],
    clock: Clock,
    mute: Collection[str] = (),
    live: Callable[[str], None] = lambda at: None,
) -> list[RunError]:
    """Make every instrument safe, the ones named in ``order`` first; never stops at a failure.

    An instrument that fails is tried again after all others are safe: it may only have been silent for a while. One
    that has just been ``mute`` to everything is not waited for as long as the others. ``live`` is told each half second
    of a pause.

    Returns:
        One B-RUN-060 per instrument that could not be confirmed safe; empty when the whole bench is safe.
    """
    way, tried = WayToSafe(instruments, order, clock), 1
    way.attempt(quick=instruments)
    while way.left and (tried < ATTEMPTS or not way.failures):
        for _ in range(PAUSES):
            clock.sleep(PAUSE_S / PAUSES)
            live("a pause before the next attempt to make the bench safe")
        tried += 1 if way.failures else 0
        way.attempt(quick=mute)
    return [_not_safe(role, state, way.failures.get(role)) for role, state in way.left.items()]


def heat_off(chamber: Instrument | None) -> list[RunError]:
    """Stop a chamber that does not do what it is told: on hold it would go on heating. One B-RUN-060 if it does not."""
    stop = getattr(chamber, "stop", None)
    if chamber is None or stop is None:
        return []
    try:
        stop()
    except Exception as error:  # whatever it is, the end of the run goes on
        return [_not_safe(chamber.role, _state_after(error), error)]
    return []


def hurried(instrument: Safeable, limit_s: float | None) -> AbstractContextManager[object]:
    """Keep calls from waiting longer than ``limit_s`` and from being repeated, where the driver can; None: no limit."""
    quick = getattr(instrument, "quick", None)
    return nullcontext() if quick is None or limit_s is None else quick(limit_s)


def states_of(failures: Iterable[RunError]) -> dict[str, SafeState]:
    """Return what is known of the instruments that could not be confirmed safe, by role."""
    return {failure.where: _state_after(failure.__cause__) for failure in failures}


def _not_safe(role: str, state: SafeState, error: Exception | None) -> RunError:
    why = "it answered once, and might still do what came before" if error is None else str(unforeseen(error))
    failure = RunError(
        "B-RUN-060",
        f"not confirmed safe, {state} ({why})",
        where=role,
        next_step="switch it off at its front panel before anybody touches the bench",
    )
    failure.__cause__ = error
    return failure
