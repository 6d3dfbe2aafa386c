"""What did not go to plan in a run, as lines of the terminal and as a table of the report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

from bench.model.clock import NS

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


_SENTENCES: Mapping[str, Callable[[Fields], str]] = {
    "hold": lambda f: f"at step {f['step']}: {f['reason']} ({f['by']})",
    "release": lambda f: f"going on after {f['seconds']:.0f} s",
    "skip": lambda f: f"steps {f['first']} to {f['stop'] - 1} left out: {f['reason']} ({f['by']})",
    "control": lambda f: f"{f['what']} by {f['by']}" + (f": {f['reason']}" if f["reason"] else ""),
    "retake": lambda f: f"record {f['record']}: {f['reason']}",
    "error": lambda f: str(f.get("text", f.get("code", ""))),
    "interlock": lambda f: f"{f['name']} {f['state']}: {f['value']} {f['unit']}, limit {f['limit']}; {f['action']}",
    "verdict": _verdict,
    "config": lambda f: f"{f['file']} is {f['change']} on the disk; the run used its own copy",
}


def happenings(view: Events) -> list[str]:
    """One line for each thing that did not go to plan, by kind, and how punctual the run was."""
    said = [f"{kind} at {t_ns / NS:.0f} s: {text}" for kind in KINDS for t_ns, text in _of(view, kind)]
    return [*said, *punctuality(view)]


def happening_tables(view: Events) -> list[dict[str, Any]]:
    """The same as a table of the report, in order of time; none for a run to which nothing happened."""
    found = sorted((t_ns, kind, text) for kind in KINDS for t_ns, text in _of(view, kind))
    if not found:
        return []
    return [
        {
            "title": "What happened during the run",
            "caption": "Everything that did not go to plan; time on the bench clock of the part of the run.",
            "headers": ["time", "what", "in words"],
            "rows": [[f"{t_ns / NS:.0f} s", kind, text] for t_ns, kind, text in found],
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
