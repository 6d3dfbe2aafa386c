"""What the list says of a run that has not ended: enough to decide whether somebody has to get up at night."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.record import is_being_written
from bench.run.feed.bench_state import UNHEARD
from bench.session.recorded_state import unheard

MOST_ALARMS = 3


def now_of(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a state document that a card shows."""
    unshelved = (alarm for alarm in state.get("alarms") or () if not alarm.get("shelved"))
    alarms = [alarm for alarm in unshelved if alarm["active"] or not alarm["acknowledged"]]
    prompt = state.get("prompt") or {}
    return {
        "attention": state.get("attention", "none"),
        "bench": state.get("bench") or dict(UNHEARD),
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
    now: dict[str, Any] = {"attention": "much", **unheard(folder), "alarm_count": 0, "alarms": []}
    return {"state": "lost" if is_being_written(folder) else "stopped", "now": now}


def number_of(value: object) -> float | None:
    """Return a finite number that somebody else's document says, None for anything else."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if is_number else None  # type: ignore[arg-type]
