"""Looks at everything, one check after the other; none of them can raise or hang the run.

The bench is opened already (``conduct(preflight=...)``), or what of it can be opened is, looked at and left as it is
(``bench check --live``).
"""

from __future__ import annotations

import re
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from bench.model import events
from bench.model.clock import Clock
from bench.model.errors import BenchError, InstrumentError
from bench.model.installed import unforeseen
from bench.model.ports import ByteLink, Instrument
from bench.model.posix import termios
from bench.plan import Plan, Station, unwatched
from bench.run.bus.opener import OpenBench, missing_buses, open_bench, open_instrument, open_port, open_visa, unheard
from bench.run.bus.port import descriptor_of
from bench.run.bus.side_by_side import asked
from bench.run.guard.drill import drill_age, latest_drill
from bench.run.guard.drill_controller import has_source
from bench.run.guard.lock import BenchLock, bus_keys
from bench.run.preflight import of_instruments, of_machine
from bench.run.preflight.context import Finding, Host, PreflightContext, Report, Status, Surroundings, told
from bench.run.preflight.of_machine import write_speed

GUARD_LIMIT_S = 15.0
DRILL_DAYS = 30
_START = (
    "import sys; import bench.run.guard.process; from bench.run.bus.opener import open_visa; "
    "open_visa(sys.argv[1]); print('ready')"
)
LATENCY_MS = 2  # a USB adapter collects bytes so long before it sends them; 16 is what many start with
_BAUD = 5  # index of the output speed in what tcgetattr returns


def guard(context: PreflightContext) -> Finding:
    """A process of its own can load what the guard needs: its program and the station's VISA library."""
    if context.in_process:
        return Finding("guard", Status.SKIPPED, "", "", "a bench inside this process ends with it")
    words = (sys.executable, "-P", "-c", _START, context.station.file.visa)
    if context.host.output(words, GUARD_LIMIT_S) != "ready":
        text = "a new process cannot load the guard or the VISA library; reinstall the software"
        return Finding("guard", Status.FAIL, "does not start", f"in {GUARD_LIMIT_S:g} s", text)
    return Finding("guard", Status.OK, "starts", f"in {GUARD_LIMIT_S:g} s")


def drill(context: PreflightContext) -> Finding:
    """A kill drill has shown, not long ago, that the guard brings this bench to its safe state."""
    name, limit, again = "kill drill", f"passed in the last {DRILL_DAYS} days", "run 'bench drill' on this station"
    if context.in_process:
        return Finding(name, Status.SKIPPED, "", limit, "a bench inside this process ends with it")
    latest = latest_drill(context.out, context.station)
    if latest is None and not has_source(context.station):
        return Finding(name, Status.SKIPPED, "", limit, "the station has no instrument a drill could switch on")
    if latest is None:
        unproved = "" if context.station.simulated else "nothing proves that this bench becomes safe by itself; "
        return Finding(name, Status.WARN, "none", limit, f"{unproved}{again}")
    days = drill_age(latest, context.clock).total_seconds() / 86_400
    value = f"{days:.1f} days ago"
    if not latest["passed"]:
        text = "the last drill failed: the guard does not make this bench safe in time"
        return Finding(name, Status.FAIL, value, limit, text, of_bench=True)
    return Finding(
        name, Status.OK if days <= DRILL_DAYS else Status.WARN, value, limit, "" if days <= DRILL_DAYS else again
    )


def interlocks(context: PreflightContext) -> Finding:
    """Interlocks watch the run, and its temperatures where the plan heats: nobody acts on a warning at night."""
    count, said = len(context.plan.interlocks), unwatched(context.plan)
    status = Status.WARN if said else Status.OK
    return Finding("interlocks", status, str(count), "at least 1", "; ".join(said))


def line_settings(context: PreflightContext) -> list[Finding]:
    """Every port of the station opens and has the declared speed, 8 bits, no parity, no flow control of any kind."""
    return [_line(context, name) for name, link in context.station.links.items() if link.instrument is None]


def _line(context: PreflightContext, link: str) -> Finding:
    name, limit = f"line of {link}", f"{context.station.links[link].baud} baud, 8N1, no flow control"
    if link in context.absent:
        error = context.absent[link]
        return Finding(name, Status.FAIL, error.code, limit, error.message, of_bench=True)
    port = context.links[link]
    descriptor = descriptor_of(port)
    if descriptor is None or termios is None:
        return Finding(name, Status.SKIPPED, "", limit, "not a port of this machine")
    try:
        modes = termios.tcgetattr(descriptor)
    except termios.error as error:
        return Finding(name, Status.WARN, "unknown", limit, f"its settings cannot be read: {error}")
    wrong = _wrong_modes(modes, context.station.links[link].baud or 0)
    if wrong:
        return Finding(name, Status.FAIL, ", ".join(wrong), limit, "another program has changed it", of_bench=True)
    return Finding(name, Status.OK, "as declared", limit)


def _wrong_modes(modes: list[int], baud: int) -> list[str]:
    """Return what is not as it should be, by termios(3)."""
    input_modes, _, control_modes, _ = modes[:4]
    speeds = {getattr(termios, name): int(name[1:]) for name in dir(termios) if re.fullmatch(r"B\d+", name)}
    speed = speeds.get(modes[_BAUD])  # a speed without a name of its own is not in the list: nothing to compare
    wrong = [
        (bool(input_modes & (termios.IXON | termios.IXOFF)), "XON/XOFF on"),
        (bool(control_modes & termios.CRTSCTS), "RTS/CTS on"),
        (control_modes & termios.CSIZE != termios.CS8, "not 8 bits"),
        (bool(control_modes & termios.PARENB), "parity on"),
        (bool(control_modes & termios.CSTOPB), "2 stop bits"),
        (speed is not None and speed != baud, f"{speed} baud"),
    ]
    return [text for is_wrong, text in wrong if is_wrong]


def latency_timers(context: PreflightContext) -> list[Finding]:
    """USB adapters that collect bytes before they send them do so for 2 ms at most."""
    findings = []
    for link, port in context.links.items():
        device = PurePosixPath(context.host.terminal(descriptor_of(port))).name
        text = context.host.text(f"/sys/bus/usb-serial/devices/{device}/latency_timer")
        if text is None or not text.isdecimal():
            continue
        name, limit = f"latency of {link}", f"at most {LATENCY_MS} ms"
        late = int(text) > LATENCY_MS
        remark = f"write 1 into /sys/bus/usb-serial/devices/{device}/latency_timer" if late else ""
        findings.append(Finding(name, Status.WARN if late else Status.OK, f"{text} ms", limit, remark))
    return findings


def quiet(context: PreflightContext) -> list[Finding]:
    """Return what the links deliver before the unit is powered: nothing, or garbage, both are fine; it is said."""
    findings = []
    for link, port in context.links.items():
        name = f"silence of {link}"
        try:
            waiting = port.in_waiting
        except OSError as error:
            findings.append(Finding(name, Status.FAIL, "lost", "", f"the port fails: {error}", of_bench=True))
            continue
        text = "the unit is on, or the line is open" if waiting else "nothing comes"
        findings.append(Finding(name, Status.OK, f"{waiting} bytes", "", text))
    return findings


BUS_LIMIT_S = 60.0
LIMIT_S = 20.0

Looked = Finding | Sequence[Finding]
T = TypeVar("T")
OPEN_LIMIT_S = 5.0  # for each instrument and port
SEED = 1  # of a bench that is simulated in this process


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
    Check("settings", of_instruments.settings, on_bus=True),
    Check("first contact", of_instruments.first_contacts),
    Check("calibration dates", of_instruments.standards),
    Check("wiring check", of_instruments.wiring),
    Check("interlocks", interlocks),
    Check("room on the disk", of_machine.space),
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
    Check("line settings", line_settings),
    Check("latency timers", latency_timers),
    Check("silence", quiet),
    Check("write speed", of_machine.write_speed),
    *(Check(name, look) for name, look in MACHINE),
    Check("guard", guard),
    Check("kill drill", drill),
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
        findings += [_too_slow(check)] if looked is None else looked
    return Report(tuple(findings))


def _too_slow(check: Check) -> Finding:
    status = Status.FAIL if check.on_bus else Status.WARN
    text = "the check does not come to an end"
    return Finding(check.name, status, f"over {check.limit_s:g} s", "", text, of_bench=check.on_bus)


def _guarded(check: Check, context: PreflightContext) -> Sequence[Finding]:
    """Return what the check found; whatever it raises is a finding, too."""
    try:
        looked = check.look(context)
    except BenchError as error:
        looked = Finding(check.name, Status.FAIL, error.code, "", error.message, of_bench=check.on_bus)
    except Exception as error:  # a check must never be the reason why a bench stands still
        looked = Finding(check.name, Status.WARN, "unknown", "", unforeseen(error).message)
    return [looked] if isinstance(looked, Finding) else looked


def _limited(check: Check, context: PreflightContext) -> Sequence[Finding] | None:
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
    uncommissioned: str = ""
    left: tuple[Finding, ...] = ()

    def __call__(
        self, plan: Plan, bench: OpenBench, clock: Clock, out: Path, *, prepared: bool
    ) -> events.Preflight | None:
        """Judge an opened bench whose instruments were identified and made safe; tell before what the run will set.

        What no command mends is a warning then: the action refuses that relies on it, and not every run has that.
        """
        context = PreflightContext(
            plan=plan, clock=clock, out=out, instruments=bench.instruments, links=bench.links, host=self.host,
            uncommissioned=self.uncommissioned, asks_only=not prepared,
        )  # fmt: skip
        if not prepared:
            self.left = () if clock.virtual else tuple(of_instruments.settings(context, Status.WARN))
            for finding in self.left:
                if of_instruments.SETS in finding.value:
                    self.tell(f"pre-flight: {told(finding)}")
            return None
        report = Report((*self.left, *survey(context).findings))
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


def examine(plan: Plan, clock: Clock, out: Path, host: Host | None = None, *, uncommissioned: str = "") -> Report:
    """Return everything the pre-flight of a run would find now; instruments are only asked.

    Instruments and ports that another controller uses are not touched: nothing of the bench is opened then.
    """
    context = PreflightContext(
        plan=plan, clock=clock, out=out, instruments={}, links={}, host=Host() if host is None else host,
        uncommissioned=uncommissioned, asks_only=True,
    )  # fmt: skip
    if plan.station.in_process:
        bench = open_bench(plan.station, clock, unheard, seed=SEED)
        try:
            return survey(replace(context, instruments=bench.instruments, links=bench.links))
        finally:
            bench.close()
    lock = BenchLock(bus_keys(entry.resource for entry in plan.station.instruments.values()), "check", clock)
    try:
        lock.take()
    except BenchError as error:
        return _untouched(context, error)
    try:
        free = Finding("second controller", Status.OK, "none", "the bench is free")
        with _opened(plan.station, clock) as (instruments, links, absent):
            report = survey(replace(context, instruments=instruments, links=links, absent=absent))
        return Report((free, *report.findings))
    finally:
        lock.release()


def examine_machine(around: Surroundings) -> Report:
    """Return what can be said of a machine without a plan or a bench."""
    return Report(tuple(look(around) for _, look in MACHINE))


def _untouched(context: PreflightContext, error: BenchError) -> Report:
    """Return what can be said about a bench that somebody else is using; not even its disk is kept busy."""
    used = Finding("second controller", Status.FAIL, error.code, "the bench is free", error.message)
    skipped = Finding("instruments and links", Status.SKIPPED, text="not touched while the bench is in use")
    harmless = [check for check in (*ALWAYS, *ON_THE_MACHINE) if not check.on_bus and check.look not in _TOUCHING]
    return Report((used, skipped, *survey(context, harmless).findings))


_TOUCHING = (line_settings, quiet, write_speed)

Opened = tuple[dict[str, Instrument], dict[str, ByteLink], dict[str, BenchError]]


@contextmanager
def _opened(station: Station, clock: Clock) -> Iterator[Opened]:
    """Every instrument and port that opens, and the errors of those that do not."""
    instruments: dict[str, Instrument] = {}
    links: dict[str, ByteLink] = {}
    absent: dict[str, BenchError] = {}
    closers: list[Callable[[], Any]] = []
    try:
        for name, link in station.links.items():
            if link.baud is None:  # read from an instrument: it has no port
                continue
            open_link = partial(open_port, name, str(link.url), link.baud, exclusive=True)
            port = _tried(name, open_link)
            if isinstance(port, BenchError):
                absent[name] = port
            else:
                links[name] = port
                closers.append(port.close)
        absent.update(missing_buses(station))
        reached = {role: entry for role, entry in station.instruments.items() if role not in absent}
        if reached:
            visa = open_visa(station.file.visa, station.boards)
            closers.insert(0, visa.close)
            open_one = partial(open_instrument, visa, clock=clock, transcript=unheard, used=True)
            resources = {role: entry.resource for role, entry in reached.items()}
            tried = asked(resources, lambda role: _tried(role, partial(open_one, role, reached[role])), clock)
            for role, instrument in tried.items():
                if isinstance(instrument, BenchError):
                    absent[role] = instrument
                else:
                    instruments[role] = instrument
                    closers.append(instrument.close)
        yield instruments, links, absent
    finally:
        for close in reversed(closers):
            with suppress(Exception):  # one that is gone already, or hangs, keeps nothing else open
                within(OPEN_LIMIT_S, close)


def _tried(name: str, open_one: Callable[[], T]) -> T | BenchError:
    """Return what was opened, or why it was not within its time."""
    try:
        return within(OPEN_LIMIT_S, open_one)
    except BenchError as error:
        return error
    except OverdueError:
        text = f"it does not open within {OPEN_LIMIT_S:g} s"
        return InstrumentError("B-RUN-002", text, where=name, next_step="check its address and its power")
