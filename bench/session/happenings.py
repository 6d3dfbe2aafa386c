"""What did not go to plan in a run, as lines of the terminal and as a table of the report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

from bench.model.clock import NS
from bench.model.units import hours

Fields = Mapping[str, Any]

KINDS = (
    "late", "slip", "overrun", "retake", "hold", "release", "skip", "control", "interlock", "alarm", "verdict", "link",
    "guard", "clock_step", "config", "error",
)  # fmt: skip
QUIET = {"link": ("open",), "guard": ("ready",)}  # states that are as they should be


class Events(Protocol):
    """A session, as far as its events are asked for."""

    def events_of(self, kind: str) -> list[tuple[int, Fields]]:
        """Times and fields of all events of one kind."""


def _verdict(fields: Fields) -> str:
    failed = [str(check["text"]) for check in fields.get("checks", ()) if check.get("ok") is False]
    if fields["ok"] is None:
        return f"none: {fields.get('error', 'too little is recorded yet')}"
    return "all well" if fields["ok"] else "; ".join(failed)


def _alarm(fields: Fields) -> str:
    if fields["what"] == "prompt":
        return f"waited for an answer: {fields['text']}"
    if fields["what"] == "stimulus":
        return f"{fields['role']} not confirmed safe at step {fields['step']}: {fields['code']}: {fields['text']}"
    return f"still holding at step {fields['step']} after {fields['seconds']:.0f} s: " + "; ".join(
        str(reason) for reason in fields["reasons"].values()
    )


def _link(fields: Fields) -> str:
    name, state = fields["link"], fields["state"]
    if state == "back":
        return f"{name} back after {fields['seconds']:.1f} s: {fields['how']}"
    return f"{name} {state}: {fields['reason']}"


def _guard(fields: Fields) -> str:
    if fields["state"] == "withheld":
        return f"a heartbeat was withheld: no sign of life of {', '.join(fields['parts'])}"
    return f"{fields['state']}: {fields['text']}"


_SENTENCES: Mapping[str, Callable[[Fields], str]] = {
    "late": lambda f: (
        f"step {f['step']}: not stable at the end of its slot, last {f['last_degC']:.2f} degC, "
        f"{f['slope_degC_min']:+.3f} degC/min: {f['policy']}"
    ),
    "slip": lambda f: f"step {f['step']}: {f['seconds']:.3g} s later than planned ({f['reason']})",
    "overrun": lambda f: f"step {f['step']}: began {f['seconds']:.2g} s late, what was before it took longer",
    "alarm": _alarm,
    "link": _link,
    "guard": _guard,
    "clock_step": lambda f: f"UTC jumped by {f['step_s']:+.3f} s; durations are not touched",
    "hold": lambda f: f"at step {f['step']}: {f['reason']} ({f['by']})",
    "release": lambda f: f"going on after {f['seconds']:.0f} s",
    "skip": lambda f: f"steps {f['first']} to {f['stop'] - 1} left out: {f['reason']} ({f['by']})",
    "control": lambda f: (
        f"{f['what']} by {f['by']}"
        + (f": {f['reason']}" if f["reason"] else "")
        + ("" if f.get("ok", True) else f" (refused: {f['text']})")
    ),
    "retake": lambda f: f"record {f['record']}: {f['reason']}",
    "error": lambda f: str(f.get("text", f.get("code", ""))),
    "interlock": lambda f: f"{f['name']} {f['state']}: {f['value']} {f['unit']}, limit {f['limit']}; {f['action']}",
    "verdict": _verdict,
    "config": lambda f: f"{f['file']} is {f['change']} on the disk; the run used its own copy",
}


def happenings(view: Events) -> list[str]:
    """One line for each thing that did not go to plan, by kind, and how punctual the run was."""
    start_ns = _start_ns(view)
    said = [f"{kind} at {_since(t_ns, start_ns)}: {text}" for kind in KINDS for t_ns, text in _of(view, kind)]
    return [*said, *punctuality(view)]


def happening_tables(view: Events) -> list[dict[str, Any]]:
    """The same as a table of the report, in order of time; none for a run to which nothing happened."""
    found = sorted((t_ns, kind, text) for kind in KINDS for t_ns, text in _of(view, kind))
    if not found:
        return []
    start_ns = _start_ns(view)
    return [
        {
            "title": "What happened during the run",
            "caption": "Everything that did not go to plan; time since the run began.",
            "headers": ["time", "what", "in words"],
            "prose": True,
            "rows": [[_since(t_ns, start_ns), kind, text] for t_ns, kind, text in found],
        }
    ]


def punctuality(view: Events) -> Iterator[str]:
    """How late the timed waits ended."""
    for _, fields in view.events_of("end"):
        median, p99, worst = fields["lateness_ms"]
        yield (
            f"Timer: {fields['steps']} steps; timed waits ended {median:.3g} ms late in the median, "
            f"{p99:.3g} ms at the 99th percentile, {worst:.3g} ms at worst; "
            f"slip {fields['slip_s']:.3g} s, {fields['overruns']} overruns."
        )


def _start_ns(view: Events) -> int:
    """When the run began, as the lines of its progress count; the bench clock itself may begin with the machine."""
    return min((t_ns for t_ns, _ in view.events_of("phase")), default=0)


def _since(t_ns: int, start_ns: int) -> str:
    return hours(max(0, t_ns - start_ns) / NS)


def _of(view: Events, kind: str) -> Iterator[tuple[int, str]]:
    for t_ns, fields in view.events_of(kind):
        if fields.get("state") not in QUIET.get(kind, ()):
            yield t_ns, _words(kind, fields)


def _words(kind: str, fields: Fields) -> str:
    sentence = _SENTENCES.get(kind)
    if sentence is not None:
        try:
            return sentence(fields)
        except (KeyError, TypeError, ValueError):
            pass  # a session of another version: the fields as they are
    return ", ".join(f"{name} {_short(value)}" for name, value in fields.items())


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
