"""Looks at everything, one check after the other; none of them can raise or hang the run."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from bench.model import events
from bench.model.clock import Clock
from bench.model.errors import BenchError
from bench.plan import Plan
from bench.run.bench.opener import OpenBench
from bench.run.preflight import of_bench, of_disk, of_instruments, of_links, of_machine
from bench.run.preflight.context import PreflightContext
from bench.run.preflight.finding import Finding, Report, Status, told
from bench.run.preflight.host import Host

BUS_LIMIT_S = 60.0
LIMIT_S = 20.0

Looked = Finding | Sequence[Finding]
T = TypeVar("T")


@dataclass(frozen=True)
class Check:
    """One check. ``on_bus``: it talks to instruments; when it hangs no other one may talk."""

    name: str
    look: Callable[[PreflightContext], Looked]
    on_bus: bool = False

    @property
    def limit_s(self) -> float:
        """Time it may take, second."""
        return BUS_LIMIT_S if self.on_bus else LIMIT_S


ALWAYS = (
    Check("identities", of_instruments.identities, on_bus=True),
    Check("calibration dates", of_instruments.standards),
    Check("wiring check", of_instruments.wiring),
    Check("room on the disk", of_disk.space),
)
ON_THE_BUS = (
    Check("warm-up", of_instruments.warm_up, on_bus=True),
    Check("self-calibration", of_instruments.self_calibration, on_bus=True),
    Check("10 MHz", of_instruments.reference, on_bus=True),
    Check("generators", of_instruments.generators),
    Check("laboratory air", of_instruments.laboratory, on_bus=True),
)
MACHINE = (  # asks for no plan and no bench
    ("clock", of_machine.clock_state),
    ("suspend", of_machine.sleep),
    ("mains", of_machine.mains),
    ("memory, files", of_machine.room_to_run),
    ("versions", of_machine.software),
)
ON_THE_MACHINE = (
    Check("line settings", of_links.line_settings),
    Check("latency timers", of_links.latency_timers),
    Check("silence", of_links.quiet),
    Check("write speed", of_disk.write_speed),
    *(Check(name, look) for name, look in MACHINE),
    Check("guard", of_bench.guard),
    Check("kill drill", of_bench.drill),
)


def survey(context: PreflightContext, checks: Sequence[Check] | None = None) -> Report:
    """Do every check that makes sense on this bench and this clock.

    Under the virtual clock only what does not depend on the machine is looked at, in this thread.
    """
    if checks is None:
        checks = ALWAYS if context.clock.virtual else (*ALWAYS, *ON_THE_BUS, *ON_THE_MACHINE)
    findings: list[Finding] = []
    hung = False
    for check in checks:
        if check.on_bus and hung:
            findings.append(Finding(check.name, Status.SKIPPED, text="the bus does not answer"))
            continue
        looked = _guarded(check, context) if context.clock.virtual else _limited(check, context)
        hung = hung or (looked is None and check.on_bus)
        findings += _as_list(looked) if looked is not None else [_too_slow(check)]
    return Report(tuple(findings))


def _as_list(looked: Looked) -> list[Finding]:
    return [looked] if isinstance(looked, Finding) else list(looked)


def _too_slow(check: Check) -> Finding:
    status = Status.FAIL if check.on_bus else Status.WARN
    text = "the check does not come to an end"
    return Finding(check.name, status, f"over {check.limit_s:g} s", "", text, of_bench=check.on_bus)


def _guarded(check: Check, context: PreflightContext) -> Looked:
    """Return what the check found; whatever it raises is a finding, too."""
    try:
        return check.look(context)
    except BenchError as error:
        return Finding(check.name, Status.FAIL, error.code, "", error.message, of_bench=check.on_bus)
    except Exception as error:  # a check must never be the reason why a bench stands still
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return Finding(check.name, Status.WARN, "unknown", "", text)


def _limited(check: Check, context: PreflightContext) -> Looked | None:
    """The same where it may hang; None then."""
    try:
        return within(check.limit_s, lambda: _guarded(check, context))
    except OverdueError:
        return None


@dataclass
class Preflight:
    """The pre-flight of a run (``conduct(preflight=...)``): refuses to start, or tells and goes on.

    ``tell`` gets a line for each warning. Returns the event of the session; under the virtual clock nothing,
    so that a session's bytes depend on nothing of the machine. Raises: InputError B-RUN-080, InstrumentError B-RUN-081.
    """

    tell: Callable[[str], None] = lambda text: None
    host: Host = field(default_factory=Host)

    def __call__(self, plan: Plan, bench: OpenBench, clock: Clock, out: Path) -> events.Preflight | None:
        """Judge an opened bench whose instruments were identified and made safe."""
        context = PreflightContext(
            plan=plan, clock=clock, out=out, instruments=bench.instruments, links=bench.links, host=self.host
        )
        report = survey(context)
        for finding in report.of(Status.WARN):
            self.tell(f"pre-flight, warning: {told(finding)}")
        refusal = report.refusal()
        if refusal is not None:
            raise refusal
        return None if clock.virtual else report.event()


class OverdueError(Exception):
    """The call has not come to an end in its time; it may still."""


def within(limit_s: float, call: Callable[[], T]) -> T:
    """Return what the call returns or raises. Raises: OverdueError after ``limit_s`` (second)."""
    returned: list[T] = []
    raised: list[Exception] = []

    def work() -> None:
        try:
            returned.append(call())
        except Exception as error:
            raised.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(limit_s)
    if raised:
        raise raised[0]
    if not returned:
        raise OverdueError(f"over {limit_s:g} s")
    return returned[0]
