"""What an event of a session says, in one line, for the log and the alarms of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Fields = Mapping[str, Any]


def _number(value: Any, digits: str = "g") -> str:
    return format(value, digits) if isinstance(value, int | float) else "none"


def _alarm(fields: Fields) -> str:
    if fields.get("what") == "stimulus":
        return f"{fields.get('role')} is not confirmed safe: {fields.get('code')}: {fields.get('text')}"
    if fields.get("what") == "prompt":
        return f"somebody must answer: {fields.get('text')}"
    reasons = "; ".join(str(reason) for reason in dict(fields.get("reasons") or {}).values())
    return f"still holding after {_number(fields.get('seconds'), '.0f')} s: {reasons}"


def _interlock(fields: Fields) -> str:
    name = f"{fields.get('signal')} of {fields['of']}" if fields.get("of") else str(fields.get("signal"))
    unit = fields.get("unit", "")
    if fields.get("state") == "released":
        return f"{fields.get('name')}: {name} is back inside its limits"
    if fields.get("value") is None:
        return f"{fields.get('name')}: no reading of {name}: {fields.get('action')}"
    value, limit = _number(fields["value"], ".6g"), _number(fields.get("limit"))
    return f"{fields.get('name')}: {name} is {value} {unit}, limit {limit} {unit}: {fields.get('action')}"


def _link(fields: Fields) -> str:
    name, state = fields.get("link"), fields.get("state")
    if state == "back":
        return f"{name} is back after {_number(fields.get('seconds'), '.1f')} s: {fields.get('how')}"
    if "reason" in fields:
        return f"{name} is {state}: {fields['reason']}"
    more = ", ".join(f"{key} {value}" for key, value in fields.items() if key not in ("link", "state"))
    return f"{name}: {state} {more}".strip()


def _guard(fields: Fields) -> str:
    if fields.get("state") == "withheld":
        return f"a heartbeat was withheld: no sign of life of {', '.join(map(str, fields.get('parts', ())))}"
    return f"guard {fields.get('state')}: {fields['text']}" if fields.get("text") else f"guard {fields.get('state')}"


def _verdict(fields: Fields) -> str:
    if fields.get("ok") is None:
        return f"no early verdict: {fields.get('error', 'too little is recorded yet')}"
    failed = [str(check.get("text")) for check in fields.get("checks", ()) if check.get("ok") is False]
    return f"early verdict: {'all well' if fields['ok'] else '; '.join(failed)}"


def _control(fields: Fields) -> str:
    said = f"{fields.get('what')} by {fields.get('by')}"
    done = "" if fields.get("ok", True) else f" refused ({fields.get('text', '')})"
    return f"{said}{done}" + (f": {fields['reason']}" if fields.get("reason") else "")


def _late(fields: Fields) -> str:
    last, slope = _number(fields.get("last_degC"), ".2f"), _number(fields.get("slope_degC_min"), "+.3f")
    return f"not stable at the end of its slot, last {last} degC, {slope} degC/min: {fields.get('policy')}"


def _prompt(fields: Fields) -> str:
    value = f"{fields['value']:g} {fields.get('unit', '')}" if fields.get("value") is not None else "done"
    return f"{fields.get('text')} {value} ({fields.get('by')})"


def _end(fields: Fields) -> str:
    return "the run is done" if fields.get("error") is None else f"the run ended: {fields['error']}"


SENTENCES: Mapping[str, Callable[[Fields], str]] = {
    "alarm": _alarm,
    "clock_step": lambda f: f"UTC jumped by {_number(f.get('step_s'), '+.3f')} s; durations are not touched",
    "config": lambda f: f"{f.get('file')} is {f.get('change')} on the disk; the run used its own copy",
    "control": _control,
    "end": _end,
    "error": lambda f: str(f.get("text") or f.get("code", "")),
    "gap": lambda f: f"record {f.get('record')} does not follow the one before it",
    "guard": _guard,
    "hold": lambda f: f"holding: {f.get('reason')} ({f.get('by')})",
    "interlock": _interlock,
    "late": _late,
    "link": _link,
    "notify": lambda f: f"a notification by {f.get('way')} did not get through ({f.get('why')})",
    "overrun": lambda f: f"began {_number(f.get('seconds'), '.2g')} s late, what was before it took longer",
    "phase": lambda f: f"phase {f.get('name')} begins",
    "prompt": _prompt,
    "reentry": lambda f: f"back at {_number(f.get('unit_degC'), '.2f')} degC" + (", soaked" if f.get("soaked") else ""),
    "release": lambda f: f"going on after {_number(f.get('seconds'), '.0f')} s",
    "resume": lambda f: f"gone on with after: {f.get('reason')}",
    "retake": lambda f: f"record {f.get('record')} is taken again: {f.get('reason')}",
    "safe": lambda f: "; ".join(map(str, f.get("failures", ()))) or "the bench is safe",
    "skip": lambda f: f"steps {f.get('first')} to {f['stop'] - 1} left out: {f.get('reason')} ({f.get('by')})",
    "slip": lambda f: f"{_number(f.get('seconds'), '.3g')} s later than planned ({f.get('reason')})",
    "verdict": _verdict,
}
"""By kind of event; other kinds say nothing to a person who watches."""


def sentence(kind: str, fields: Fields) -> str:
    """One line about an event; "" for kinds nobody needs to read while watching. Never raises."""
    say = SENTENCES.get(kind)
    if say is None:
        return ""
    try:
        return " ".join(say(fields).split())
    except (AttributeError, KeyError, TypeError, ValueError):  # a foreign session may say it otherwise
        return kind
