"""What the list says of a run that has not ended: enough to decide whether somebody has to get up at night."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.record import is_being_written
from bench.run.guard.diary import guard_word

MOST_ALARMS = 3
ALL = "all"  # in the place of a role: a guard that is at it has not said yet which instruments are safe
_UNKNOWN_BENCH: Mapping[str, Any] = {
    "state": "unknown", "confirmed_utc_s": None, "good_for_s": None, "ended_utc_s": None, "unconfirmed": None,
    "parts": [], "remains": ["mains"],
}  # fmt: skip


def now_of(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a state document that a card shows."""
    unshelved = (alarm for alarm in state.get("alarms") or () if not alarm.get("shelved"))
    alarms = [alarm for alarm in unshelved if alarm["active"] or not alarm["acknowledged"]]
    prompt = state.get("prompt") or {}
    return {
        "attention": state.get("attention", "none"),
        "bench": state.get("bench") or dict(_UNKNOWN_BENCH),
        "t_utc_s": state.get("t_utc_s"),
        "what": (state.get("step") or {}).get("what"),
        "wait": state.get("wait"),
        "prompt": prompt.get("text"),
        "progress": state.get("progress"),
        "eta": state.get("eta"),
        "alarm_count": len(alarms),
        "alarms": [{key: alarm[key] for key in ("severity", "code", "text")} for alarm in alarms[:MOST_ALARMS]],
    }


def silent_row(folder: Path) -> dict[str, Any]:
    """Return state and card of a run that was not closed and does not answer: what its guard did, if it did.

    "lost": its process is still there; "stopped": it is gone.
    """
    guard = guard_word(folder)
    bench = dict(_UNKNOWN_BENCH) if guard is None else guarded_bench(guard)
    now: dict[str, Any] = {"attention": "much", "bench": bench, "guard": guard, "alarm_count": 0, "alarms": []}
    return {"state": "lost" if is_being_written(folder) else "stopped", "now": now}


def guarded_bench(guard: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entry ``bench`` of a run that its guard ended: off only where the guard has confirmed all of it."""
    if not guard["safe"]:
        return {**_UNKNOWN_BENCH, "unconfirmed": guard["unsafe"] or {ALL: ""}}
    utc_s = _utc_s(guard["utc"])
    return {**_UNKNOWN_BENCH, "state": "off", "confirmed_utc_s": utc_s, "ended_utc_s": utc_s, "unconfirmed": {}}


def number_of(value: object) -> float | None:
    """Return a finite number that somebody else's document says, None for anything else."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if is_number else None  # type: ignore[arg-type]


def _utc_s(text: object) -> float | None:
    try:
        return datetime.fromisoformat(str(text)).timestamp()
    except ValueError:
        return None
