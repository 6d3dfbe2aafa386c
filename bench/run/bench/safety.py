"""Bring the whole bench to its safe state, whatever happened before."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext

from bench.model.clock import Clock
from bench.model.errors import RunError
from bench.model.ports import Instrument

ATTEMPTS = 3
PAUSE_S = 2.0
QUICK_S = 0.45  # longest wait for an instrument in the first attempt: the ones after it must not wait for a mute one


def make_safe(
    instruments: Mapping[str, Instrument], order: Sequence[str], clock: Clock, mute: Collection[str] = ()
) -> list[RunError]:
    """Call ``make_safe`` of every instrument, the ones named in ``order`` first; never stops at a failure.

    An instrument that fails is tried again after all others are safe: it may only have been silent for a while. One
    that has just been ``mute`` to everything is not waited for as long as the others.

    Returns:
        One B-RUN-060 per instrument that could not be confirmed safe; empty when the whole bench is safe.
    """
    roles = [role for role in order if role in instruments]
    roles += [role for role in instruments if role not in roles]
    failures: dict[str, RunError] = {}
    for attempt in range(ATTEMPTS):
        if attempt:
            clock.sleep(PAUSE_S)
        quick = roles if attempt == 0 else mute
        tried = {role: _try(role, instruments[role], QUICK_S if role in quick else None) for role in roles}
        failures = {role: failure for role, failure in tried.items() if failure is not None}
        roles = list(failures)
        if not roles:
            break
    return list(failures.values())


def heat_off(chamber: Instrument | None) -> list[RunError]:
    """Stop a chamber that does not do what it is told: on hold it would go on heating. One B-RUN-060 if it does not."""
    stop = getattr(chamber, "stop", None)
    if chamber is None or stop is None:
        return []
    try:
        stop()
    except Exception as error:  # whatever it is, the end of the run goes on
        return [_not_safe(chamber.role, error)]
    return []


def hurried(instrument: Instrument, limit_s: float | None) -> AbstractContextManager[object]:
    """Keep calls from waiting longer than ``limit_s`` and from being repeated, where the driver can; None: no limit."""
    quick = getattr(instrument, "quick", None)
    return nullcontext() if quick is None or limit_s is None else quick(limit_s)


def _try(role: str, instrument: Instrument, limit_s: float | None) -> RunError | None:
    try:
        with hurried(instrument, limit_s):
            instrument.make_safe()
    except Exception as error:  # whatever it is, the instruments after this one must still be made safe
        return _not_safe(role, error)
    return None


def _not_safe(role: str, error: Exception) -> RunError:
    return RunError(
        "B-RUN-060",
        f"not confirmed safe ({' '.join(str(error).split())})",
        where=role,
        next_step="switch it off at its front panel before anybody touches the bench",
    )
