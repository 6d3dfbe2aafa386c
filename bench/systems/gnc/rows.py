"""Records with samples, as the analyses of inertial sensors take them: by item, with the pose they were taken in, and
looked at before they are fitted: what is wrong with a record, and which records may not be used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bench.analysis import CONTINUES, Document, Floats, Material, Table, number, with_uncertainty, worded_table
from bench.maths.arrays import Integers
from bench.maths.samples import SATURATED, Finding, SampleChecks, bad_samples, bridged, check_samples
from bench.maths.stamps import TickFindings, check_ticks, unwrapped_ticks_s
from bench.model.errors import FitError
from bench.systems.gnc.declaration import AXES, SENSORS
from bench.systems.gnc.estimators.clocks import UnitClock, power_ons, unit_clock
from bench.systems.gnc.estimators.earth_rate import Pose, Site
from bench.systems.gnc.wording import channel_name, record_name, say

if TYPE_CHECKING:
    from bench.record import Samples

STANDARD_GRAVITY_M_S2 = 9.80665  # the g of every unit here; gravity of the site is stated in m/s2
_CRYSTAL = 1e-4  # error of a quartz clock: a record that cannot tell as much says nothing about it


@dataclass(frozen=True)
class SampledRow:
    """A record with its samples. ``time_s``: since its first sample, by the clock of the unit."""

    number: int
    conditions: Document
    samples: Samples
    lost: int

    @property
    def item(self) -> str:
        """Return what the record is for."""
        return str(self.conditions.get("item", ""))

    @property
    def begin_s(self) -> float:
        """Bench clock at its first sample."""
        return float(self.samples.t_ns[0]) * 1e-9

    @property
    def time_s(self) -> Floats:
        """(n,) seconds since the first sample, by the unit's own clock."""
        return unwrapped_ticks_s(self.samples.columns["tick"].astype(np.int64))

    @property
    def rate_Hz(self) -> float:
        """Samples per second, by the unit's own clock."""
        return 1.0 / float(np.median(np.diff(self.time_s)))

    @property
    def pose(self) -> Pose:
        """Angles of the table and the mounting of the unit. Raises: as ``pose_of``."""
        return pose_of(self.number, self.conditions)

    def values(self, kind: str) -> Floats:
        """(n, 3) of "gyro" (deg/s), "accelerometer" (g) or "magnetometer" (gauss)."""
        return self.samples.scaled(SENSORS[kind].prefix)

    @property
    def temperature_degC(self) -> Floats:
        """(n,) of the unit's own sensor."""
        return self.samples.scaled("temperature")


def pose_of(number: int, conditions: Document) -> Pose:
    """Return the pose of a record. Raises: FitError B-GNC-004 if its conditions name none."""
    try:
        outer, middle, inner = (float(conditions[name]) for name in ("outer_deg", "middle_deg", "inner_deg"))
        return Pose(outer, middle, inner, str(conditions["mounting"]))
    except (KeyError, ValueError) as error:
        raise FitError(
            "B-GNC-004",
            f"the conditions of the record do not give its pose ({error})",
            where=f"record {number}",
            next_step="state mounting, outer, middle and inner angle as conditions of the record",
        ) from error


def sampled_rows(material: Material, items: Sequence[str]) -> tuple[list[SampledRow], list[str]]:
    """Records of these items in their order, and a sentence for each that holds no sample.

    Raises: FitError B-GNC-003 if there is not one.
    """
    sampled, empty = [], []
    for row in material.rows:
        item = str(row.window.conditions.get("item", ""))
        if item not in items:
            continue
        if row.samples is None or len(row.samples) < 2:
            empty.append(say("missing.no_samples", number=row.window.number, item=item))
        elif CONTINUES in row.window.conditions:
            empty.append(say("missing.not_following", number=row.window.number, item=item))
        else:
            sampled.append(SampledRow(row.window.number, row.window.conditions, row.samples, row.lost))
    if not sampled:
        raise no_records(items)
    return sampled, empty


def no_records(items: Sequence[str]) -> FitError:
    """Return the error of a session without a record of these items."""
    return FitError(
        "B-GNC-003",
        f"the session holds no record with samples of {', '.join(items)}",
        next_step="look at the session with 'bench recover'; records need 'samples: true' and the condition 'item'",
    )


def clock_of(rows: Sequence[SampledRow]) -> UnitClock:
    """Return the unit's clock against the bench clock, over all records."""
    return unit_clock(_stamps(rows), 1.0 / rows[0].rate_Hz) if rows else UnitClock()


def power_on_of(rows: Sequence[SampledRow]) -> dict[int, int]:
    """Return number of the power-on of the unit, from 0, by the number of the record."""
    return {rows[place].number: number for number, places in enumerate(power_ons(_stamps(rows))) for place in places}


def _stamps(rows: Sequence[SampledRow]) -> list[tuple[Integers, Floats]]:
    return [(row.samples.columns["tick"].astype(np.int64), row.samples.t_ns.astype(np.float64) * 1e-9) for row in rows]


def site_of(campaign: Document) -> Site:
    """Latitude and azimuth of the table, and how well it holds a pose (0 if the campaign does not say).

    Raises: FitError B-GNC-005 if the campaign does not state the first two.
    """
    site = campaign.get("site") or {}
    try:
        tilt_deg = float(site.get("tilt_std_deg", 0.0))
        return Site(float(site["latitude_deg"]), float(site["azimuth_deg"]), tilt_std_deg=tilt_deg)
    except KeyError as error:
        raise _no_site(error) from error


def gravity_g(campaign: Document) -> float:
    """Local gravity in g of 9.80665 m/s2. Raises: FitError B-GNC-005 if the campaign does not state it."""
    site = campaign.get("site") or {}
    try:
        return float(site["gravity_m_s2"]) / STANDARD_GRAVITY_M_S2
    except KeyError as error:
        raise _no_site(error) from error


def _no_site(error: KeyError) -> FitError:
    return FitError(
        "B-GNC-005",
        f"the campaign does not state {error} of the site",
        where="manifest: campaign.site",
        next_step="give latitude, gravity and azimuth of the inner axis in the section 'site' of the sequence",
    )


def temperature_span(rows: Sequence[SampledRow]) -> tuple[float, float]:
    """Return lowest and highest mean temperature of the records, degC."""
    means = [float(np.mean(row.temperature_degC)) for row in rows]
    return min(means), max(means)


@dataclass(frozen=True)
class CheckedRow:
    """A record with what was found wrong with it."""

    row: SampledRow
    checks: SampleChecks
    ticks: TickFindings

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Faults of its samples, then of their time stamps."""
        return (*self.checks.findings, *self.ticks.faults)

    @property
    def reason(self) -> str:
        """Return why the record may not be used; "" if it may."""
        return next((finding_text(finding) for finding in self.findings if finding.refused), "")


def finding_text(finding: Finding) -> str:
    """Return the sentence on a fault of samples or stamps."""
    name = channel_name(finding.channel)
    return say(f"check.{finding.kind}", name=name, count=finding.count, of=finding.of, first=finding.first,
               **finding.figures)  # fmt: skip


def checked(rows: Sequence[SampledRow], kinds: Sequence[str], campaign: Document) -> list[CheckedRow]:
    """Look at the samples of these sensors in every record."""
    limits, due_Hz = _limits(kinds, campaign.get("imu") or {}), campaign.get("rate_Hz")
    return [_check(row, kinds, limits, due_Hz) for row in rows]


def usable(rows: Sequence[CheckedRow]) -> tuple[list[SampledRow], list[str]]:
    """Return the records that may be used, and a sentence for each that may not."""
    refused = [
        _at_limit(seen) or say("missing.record", number=seen.row.number, item=seen.row.item, why=seen.reason)
        for seen in rows
        if seen.reason
    ]
    return [seen.row for seen in rows if not seen.reason], refused


def _at_limit(seen: CheckedRow) -> str:
    """Return which sensor is at the end of its range, where, when and what to do; "" if that is not what is wrong."""
    row = seen.row
    for finding in seen.findings:
        if finding.kind == SATURATED:
            kind, _, axis = finding.channel.partition(" ")
            scale, _, unit = row.samples.scales[SENSORS[kind].prefix]
            shown = [row.conditions[name] for name in ("up", "axis", "turn_deg") if name in row.conditions]
            named = [f"{one:+g}" if isinstance(one, float) else str(one) for one in shown]
            return say(
                "missing.at_limit",
                sensor=channel_name(finding.channel),
                what=" ".join([record_name(row.item), *named]),
                number=row.number,
                value=float(row.values(kind)[finding.first, AXES.index(axis)]),
                limit=finding.figures["limit"] * scale,
                unit=unit,
                count=finding.count,
                first=finding.first,
            )
    return ""


def without_bad_samples(rows: Sequence[SampledRow], kinds: Sequence[str]) -> tuple[list[SampledRow], list[str]]:
    """Return the records with the mean of the neighbours for each sample that stands alone, and a sentence for each."""
    mended, notes = [], []
    for row in rows:
        columns = dict(row.samples.columns)
        for kind in kinds:
            name = SENSORS[kind].prefix
            raw, (step, _, unit) = columns[name], row.samples.scales[name]
            values = raw.astype(np.float64)
            bad = bad_samples(values, 1.0)
            bridge = bridged(values, bad)
            columns[name] = np.rint(bridge).astype(raw.dtype)
            notes += [
                say(
                    "note.alone",
                    number=row.number,
                    item=row.item,
                    sensor=channel_name(f"{kind} {AXES[axis]}"),
                    sample=int(place),
                    step=float(step * (values[place, axis] - bridge[place, axis])),
                    unit=unit,
                )
                for place, axis in zip(*np.nonzero(bad), strict=True)
            ]
        mended.append(replace(row, samples=replace(row.samples, columns=columns)))
    return mended, notes


def _check(row: SampledRow, kinds: Sequence[str], limits: Mapping[str, float], due_Hz: float | None) -> CheckedRow:
    samples = row.samples
    raw = {kind: samples.columns[SENSORS[kind].prefix] for kind in kinds}
    words = {kind: float(np.iinfo(str(values.dtype)).max) for kind, values in raw.items()}
    checks = check_samples(
        {kind: values.astype("int64") for kind, values in raw.items()},
        samples.counter,
        # the word of a frame may end before the range does
        limits={kind: min(limits.get(kind, math.inf), word) for kind, word in words.items()},
    )
    ticks = check_ticks(
        row.time_s,
        samples.counter,
        1.0 / (due_Hz or max(1, round(row.rate_Hz))),
        samples.t_ns.astype(np.float64) * 1e-9,
    )
    return CheckedRow(row, checks, ticks)


def _limits(kinds: Sequence[str], imu: Document) -> dict[str, float]:
    """Return steps of the output at the end of each range; a sensor without declared range and step is left out."""
    steps = {}
    for kind in kinds:
        reach, step = imu.get(SENSORS[kind].range), imu.get(SENSORS[kind].resolution)
        if reach and step:
            steps[kind] = float(round(float(reach) / float(step)))
    return steps


def check_notes(rows: Sequence[CheckedRow]) -> list[str]:
    """Return the temperature the records hold for, and what was found, one sentence per record and fault."""
    if not rows:
        return []
    low, high = temperature_span([seen.row for seen in rows])
    faults = [
        say("note.of_record", number=seen.row.number, item=seen.row.item, text=finding_text(finding))
        for seen in rows
        for finding in seen.findings
    ]
    return [say("note.temperature", low=low, high=high), *faults]


def check_table(checked_rows: Sequence[CheckedRow]) -> Table:
    """Return samples, gaps and time stamps of every record."""
    rows = []
    for seen in checked_rows:
        found = dict.fromkeys(say(f"found.{finding.kind}") for finding in seen.findings)
        rows.append(
            [
                seen.row.number,
                record_name(seen.row.item),
                seen.checks.samples,
                seen.checks.missing,
                number(1e6 * seen.ticks.worst_jitter_s, 0),
                _clock(seen.ticks),
                say.listed(found or [say("found.nothing")]),
            ]
        )
    heads = ["record", "item", "samples", "missing", "jitter", "clock", "found"]
    return worded_table(say, "samples", heads, rows)


def _clock(ticks: TickFindings) -> str:
    if not ticks.clock_bound <= _CRYSTAL:
        return "–"
    return with_uncertainty(1e6 * ticks.clock_error, 1e6 * ticks.clock_bound)
