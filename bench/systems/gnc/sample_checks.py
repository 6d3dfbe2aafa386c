"""Samples looked at before they are fitted: what is wrong with a record, and which records may not be used."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Table
from bench.systems.gnc.estimators.sample_checks import FROZEN, SATURATED, SampleChecks, check_samples
from bench.systems.gnc.estimators.sample_clock import unwrapped_ticks_s
from bench.systems.gnc.rows import SENSORS, SampledRow

_STEPS = {
    "gyro": ("gyro_range_deg_s", "gyro_resolution_deg_s"),
    "accelerometer": ("accel_range_g", "accel_resolution_g"),
    "magnetometer": ("mag_range_gauss", "mag_resolution_gauss"),
}


@dataclass(frozen=True)
class CheckedRow:
    """A record with what was found wrong with it."""

    row: SampledRow
    checks: SampleChecks

    @property
    def reason(self) -> str:
        """Return why the record may not be used; "" if it may.

        One in which every sample of a channel is the same is not refused here: without noise that is no fault, and a
        sensor that does not answer at all determines no fit.
        """
        for finding in self.checks.findings:
            hung = finding.kind == FROZEN and finding.count < self.checks.samples
            if finding.kind == SATURATED or hung:
                return finding.sentence
        return ""


def checked(rows: Sequence[SampledRow], kinds: Sequence[str], campaign: Mapping[str, Any]) -> list[CheckedRow]:
    """Look at the samples of these sensors in every record."""
    limits, due_Hz = _limits(kinds, campaign.get("imu") or {}), campaign.get("rate_Hz")
    return [CheckedRow(row, _check(row, kinds, limits, due_Hz)) for row in rows]


def usable(rows: Sequence[CheckedRow]) -> tuple[list[SampledRow], list[str]]:
    """Return the records that may be used, and a sentence for each that may not."""
    refused = [f"record {seen.row.number} ({seen.row.item}): {seen.reason}" for seen in rows if seen.reason]
    return [seen.row for seen in rows if not seen.reason], refused


def _check(row: SampledRow, kinds: Sequence[str], limits: Mapping[str, float], due_Hz: float | None) -> SampleChecks:
    samples = row.samples
    raw = {kind: samples.columns[SENSORS[kind]] for kind in kinds}
    words = {kind: float(np.iinfo(str(values.dtype)).max) for kind, values in raw.items()}
    return check_samples(
        {kind: values.astype("int64") for kind, values in raw.items()},
        samples.counter,
        # the word of a frame may end before the range does
        limits={kind: min(limits.get(kind, math.inf), word) for kind, word in words.items()},
        interval_s=1.0 / (due_Hz or max(1, round(row.rate_Hz))),
        tick_s=unwrapped_ticks_s(samples.columns["tick"].astype("int64")),
        received_s=samples.t_ns.astype(np.float64) * 1e-9,
    )


def _limits(kinds: Sequence[str], imu: Mapping[str, Any]) -> dict[str, float]:
    """Return steps of the output at the end of each range; a sensor of which the sequence declares none has none."""
    steps = {}
    for kind in kinds:
        reach, step = (imu.get(name) for name in _STEPS[kind])
        if reach and step:
            steps[kind] = float(round(float(reach) / float(step)))
    return steps


def check_notes(rows: Sequence[CheckedRow]) -> list[str]:
    """Return what was found, one sentence per record and fault."""
    return [f"Record {seen.row.number} ({seen.row.item}): {text}." for seen in rows for text in seen.checks.sentences]


def check_table(checked_rows: Sequence[CheckedRow]) -> Table:
    """Return samples, gaps and time stamps of every record."""
    rows = []
    for seen in checked_rows:
        ticks, checks = seen.checks.ticks, seen.checks
        jitter_ms = 1e3 * ticks.worst_jitter_s if ticks else "–"
        clock = _clock(checks)
        what = ", ".join(dict.fromkeys(finding.kind for finding in checks.findings)) or "nothing"
        rows.append([seen.row.number, seen.row.item, checks.samples, checks.missing, jitter_ms, clock, what])
    headers = ["record", "item", "samples", "missing", "largest jitter, ms", "unit's clock, ppm", "found"]
    caption = (
        "Clock of the unit against that of the bench, as far as the delays of the link let it be seen; the time of "
        "every integral is the unit's own."
    )
    return Table("Samples", caption, headers, rows)


def _clock(checks: SampleChecks) -> str:
    ticks = checks.ticks
    if ticks is None or not math.isfinite(ticks.clock_bound):
        return "–"
    return f"{1e6 * ticks.clock_error:.0f} ± {1e6 * ticks.clock_bound:.0f}"
