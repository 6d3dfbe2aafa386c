"""From what a session and its analysis hold to the model of a report."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bench.model.clock import utc_of_stamp, utc_text
from bench.model.quantities import Quality
from bench.plan import Step
from bench.record import RecordRow
from bench.report.model import RecordCounts, ReportModel, Residual
from bench.report.timetable import timetable

_ORIGIN = ("sequence", "station", "clock", "seed", "links", "settings", "software")
_NO_DATE = "1970"


def report_model(
    results: Mapping[str, Any],
    rows: Sequence[RecordRow],
    plan_steps: Sequence[Step],
    manifest: Mapping[str, Any],
    prepare_s: float,
    residuals: Iterable[Mapping[str, Any]] = (),
) -> ReportModel:
    """Gather what a report shows of a session; nothing is fitted here and nothing is read from disk.

    What an analysis and the run itself say is put into it by whoever knows it.

    Args:
        results: the document of results.json.   rows: the records as cut, in order.
        plan_steps: the compiled plan ((), if the session has none).   prepare_s: length of the preparation.
        manifest: the session's manifest; "campaign", "standards", "title" and the entries on versions are read.
        residuals: per row of the fit {"channel", "kind", "temperature_degC", "current_A" (signed), "residual_ppm"
            or "residual_A", optionally "std_ppm"}.
    """
    return ReportModel(
        title=str(manifest.get("title") or results.get("campaign", "Campaign")),
        results=results,
        campaign=manifest.get("campaign", {}),
        standards=manifest.get("standards", {}),
        origin={name: manifest[name] for name in _ORIGIN if name in manifest},
        identities=manifest.get("identities", {}),
        timetable=timetable(plan_steps, prepare_s),
        residuals=tuple(residual for item in residuals if (residual := _residual(item)) is not None),
        counts=record_counts(rows),
        started_utc=started_utc(str(results.get("session", ""))),
    )


def record_counts(rows: Sequence[RecordRow]) -> RecordCounts:
    """Count records and frames, and every quality flag by name (one record may carry several)."""
    flags: Counter[str] = Counter()
    for row in rows:
        flags.update(str(flag.name).lower() for flag in Quality(row.quality))
    return RecordCounts(
        records=len(rows),
        flagged=sum(1 for row in rows if row.quality),
        frames=sum(row.frames for row in rows),
        bad=sum(row.bad for row in rows),
        lost=sum(row.lost for row in rows),
        by_flag=dict(sorted(flags.items())),
        by_channel=_by_channel(rows),
    )


def _by_channel(rows: Sequence[RecordRow]) -> dict[int, tuple[int, int, int, int, int]]:
    counts: dict[int, tuple[int, int, int, int, int]] = {}
    for row in rows:
        channel = row.window.conditions.get("channel")
        if isinstance(channel, int):
            so_far = counts.get(channel, (0, 0, 0, 0, 0))
            more = (1, int(bool(row.quality)), row.frames, row.bad, row.lost)
            counts[channel] = tuple(map(sum, zip(so_far, more, strict=True)))  # type: ignore[assignment]
    return dict(sorted(counts.items()))


def started_utc(session: str) -> str:
    """Return the start of a session by its name, to the second, ISO 8601; empty if the name does not say.

    A log without a date counts from 1970, which is no day of a measurement.
    """
    utc_ns = utc_of_stamp(session)
    return "" if utc_ns is None or session.startswith(_NO_DATE) else utc_text(utc_ns)


def _residual(item: Mapping[str, Any]) -> Residual | None:
    """Return one residual in ppm of its level; rows at zero current have none."""
    current_A = float(item.get("current_A", 0.0))
    ppm = item.get("residual_ppm")
    if ppm is None and current_A and item.get("residual_A") is not None:
        ppm = 1e6 * float(item["residual_A"]) / abs(current_A)
    if ppm is None or not math.isfinite(ppm) or not current_A:
        return None
    conditions = item.get("conditions", item)
    return Residual(
        channel=int(conditions["channel"]),
        kind=str(conditions.get("kind", "")),
        temperature_degC=float(conditions["temperature_degC"]),
        current_A=current_A,
        residual_ppm=float(ppm),
        std_ppm=float(item.get("std_ppm", math.nan)),
    )
