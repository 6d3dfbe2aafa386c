"""The bench around its instruments: the serial links, the guard process, and the drill that proved it."""

from __future__ import annotations

import re
import sys
from pathlib import PurePosixPath

from bench.model.posix import termios
from bench.plan import unwatched
from bench.run.bus.port import descriptor_of
from bench.run.guard.drill import drill_age, latest_drill
from bench.run.guard.drill_controller import has_source
from bench.run.preflight.context import Finding, PreflightContext, Status

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
