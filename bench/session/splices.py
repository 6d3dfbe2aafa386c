"""Splices of a session as results.json and the report show them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from bench.analysis import Table
from bench.model.clock import NS
from bench.replay import Splice

_HEADERS = ["stopped (UTC)", "gone on (UTC)", "away", "at step", "reason", "unit's temperature meanwhile", "then"]


def splice_documents(splices: Sequence[Splice]) -> list[dict[str, Any]]:
    """Return entries of "splices" in results.json."""
    return [
        {
            "stopped": _utc(one.stopped_utc_ns),
            "started": _utc(one.started_utc_ns),
            "away_s": one.away_s,
            "step": one.step,
            "reason": one.reason,
            "drift_degC": one.drift_degC,
            "soaked": one.soaked,
        }
        for one in splices
    ]


def splice_tables(splices: Sequence[Splice]) -> list[Table]:
    """Return the table "Splices" of the report; none for a run that was never stopped."""
    if not splices:
        return []
    rows = [
        [
            _utc(one.stopped_utc_ns) or "unknown",
            _utc(one.started_utc_ns) or "unknown",
            "unknown" if one.away_s is None else f"{one.away_s:.0f} s",
            str(one.step),
            one.reason,
            "unknown" if one.drift_degC is None else f"{one.drift_degC:+.2f} degC",
            "soaked again" if one.soaked else "went on at once",
        ]
        for one in splices
    ]
    caption = (
        "The run was stopped and gone on with here. Records from before and after stand in one result; times behind a "
        "splice are placed by UTC, and the lines of the temperatures are broken there."
    )
    return [Table("Splices", caption, _HEADERS, rows, prose=True)]


def _utc(t_ns: int | None) -> str | None:
    if t_ns is None:
        return None
    return datetime.fromtimestamp(t_ns // NS, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
