"""An imported temperature ramp as the fits take it (whole rows only, readings against their references, ramps and
holds), and the fits of its readings.

Rows of an imported log that are not what they seem: single ones unlike their neighbours, repeated stamps, gaps, and
columns that stand still.

One bad row among thousands is named, left out and counted; a column that stands still makes every result doubtful.
Source: docs/method-uncertainty.md; Hampel, J. Am. Stat. Assoc. 69 (1974) 383 (median of the neighbourhood).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Document, Evidence, Floats, Material
from bench.maths.arrays import Flags, Integers
from bench.maths.samples import few, lone_values, still_columns
from bench.model.errors import FitError
from bench.systems.af_converter.estimators.drift_ramp import (
    Blocks,
    BranchDifference,
    DriftFit,
    RampHysteresis,
    branch_differences,
    fit_drift,
    fit_ramp_hysteresis,
)
from bench.systems.af_converter.estimators.gates import Drive, usable_drive
from bench.systems.af_converter.estimators.segments import Segment, branches, find_segments
from bench.systems.af_converter.wording import say

_MOST = 0.01  # of the rows; more are not single rows
_LEAST_FILLED = 0.5  # of a block that tells branches apart: one cut by a pause scatters more than the others
LEAST_ROWS = 100
MEAN = "mean"
_WINDOWS = 150  # of the search for ramps, in a record
_SHORTEST_WINDOW_ROWS = 10


def bad_rows(t_s: Floats, columns: Mapping[str, Floats]) -> tuple[Flags, list[Evidence]]:
    """Return rows (k,) to be left out: a stamp not later than all before, a value unlike its neighbours.

    If values of more than one row in a hundred are so, they stay, with a doubt.
    """
    repeated = np.concatenate(([False], t_s[1:] <= np.maximum.accumulate(t_s)[:-1]))
    lone = {name: lone_values(values) for name, values in columns.items()}
    odd = np.any(list(lone.values()), axis=0)
    count = int(odd.sum())
    if few(count, odd.size, _MOST):
        return repeated | odd, []
    text = say("evidence.lone", name=max(lone, key=lambda name: lone[name].sum()), count=count, of=odd.size)
    return repeated, [Evidence("lone_samples", text, float(count), 0.0)]


def row_notes(bad: Floats) -> list[str]:
    """Return a sentence on the rows left out, by their times (b,)."""
    if not bad.size:
        return []
    named = ", ".join(f"{time_s / 3600.0:.3f} h" for time_s in bad[:5]) + (" ..." if bad.size > 5 else "")
    return [say("log.left_out", count=bad.size, times=named)]


def still_evidence(t_s: Floats, columns: Mapping[str, Floats], programme: Sequence[str]) -> Iterator[Evidence]:
    """Yield a doubt for each column that stands still (``samples.still_columns``)."""
    for still in still_columns(columns, programme):
        begin_s, hours = float(t_s[still.first]), float(t_s[still.first + still.count - 1] - t_s[still.first]) / 3600.0
        sentence = say("evidence.stands_still", name=still.channel, hours=hours, begin=begin_s / 3600.0)
        yield Evidence("stands_still", sentence, hours, 0.0)


@dataclass(frozen=True)
class RampColumns:
    """Rows (k,) in which every column has a value, in order of time.

    ``sensors``: temperatures by name, their mean first if there are several.   ``readings`` by name: ppm of the median
    of the ratio to the mean of the references, or as read if there are none; ``unit`` of both.
    ``row_notes``, ``doubt``: what the rows themselves show (rows.py); ``dropped`` holds ``overloaded`` and bad rows.
    ``programme_degC``: set-point, or the mean sensor without one.
    """

    t_s: Floats
    programme_degC: Floats
    has_set_point: bool
    sensors: Mapping[str, Floats]
    readings: Mapping[str, Floats]
    unit: str
    dropped: int
    segments: list[Segment]
    overloaded: int
    row_notes: Sequence[str]
    doubt: Sequence[Evidence]

    @property
    def temperature_degC(self) -> Floats:
        """Return the sensor that the fits use: the mean, or the only one."""
        return next(iter(self.sensors.values()))

    @property
    def branch(self) -> Integers:
        """1 up, -1 down, 0 hold, (k,)."""
        return branches(self.t_s, self.segments)

    def main_ramps(self) -> dict[str, Segment]:
        """Return the ramp up and the ramp down that cover the widest span."""
        widest: dict[str, Segment] = {}
        for segment in sorted(self.segments, key=lambda segment: abs(segment.end_degC - segment.start_degC)):
            widest[segment.kind] = segment
        return {kind: widest[kind] for kind in ("up", "down") if kind in widest}


def ramp_columns(material: Material) -> RampColumns:
    """Gather the columns by role.

    Raises: FitError B-FIT-060 if the session holds no log with a temperature and a reading, or too few whole rows;
            B-FIT-061 if the log has no ramp up and down.
    """
    roles = _by_role(material)
    used = [name for names in roles.values() for name in names]
    whole = np.all([np.isfinite(material.series[name]) for name in ("t_s", *used)], axis=0)
    rows = int(np.count_nonzero(whole))
    if rows < LEAST_ROWS:
        raise _unusable(f"{rows} of {whole.size} rows have a value in every column, {LEAST_ROWS} are due")
    overloaded = whole.size - rows
    held = [name for name in used if name not in roles["set_point"]]
    series_s = material.series["t_s"]
    bad, doubt = bad_rows(series_s[whole], {name: material.series[name][whole] for name in held})
    bad_s = series_s[whole][bad]
    whole[np.flatnonzero(whole)[bad]] = False
    columns = {name: np.asarray(material.series[name][whole]) for name in ("t_s", *used)}
    t_s, sensors = columns["t_s"], {name: columns[name] for name in roles["temperature"]}
    mean = np.mean(list(sensors.values()), axis=0)
    sensors = {MEAN: mean, **sensors} if len(sensors) > 1 else sensors
    programme = columns[roles["set_point"][0]] if roles["set_point"] else mean
    readings, unit = _readings(roles, columns, material)
    window_s = max(float(t_s[-1] - t_s[0]) / _WINDOWS, _SHORTEST_WINDOW_ROWS * float(np.median(np.diff(t_s))))
    log_columns = RampColumns(
        t_s=t_s,
        programme_degC=programme,
        has_set_point=bool(roles["set_point"]),
        sensors=sensors,
        readings=readings,
        unit=unit,
        dropped=overloaded + bad_s.size,
        overloaded=overloaded,
        row_notes=row_notes(bad_s),
        doubt=[*doubt, *still_evidence(t_s, {name: columns[name] for name in used}, roles["set_point"])],
        segments=find_segments(t_s, programme, window_s),
    )
    if len(log_columns.main_ramps()) < 2:
        kinds = ", ".join(segment.kind for segment in log_columns.segments)
        raise FitError(
            "B-FIT-061",
            f"the log has no ramp up and ramp down to compare (found: {kinds})",
            next_step="import the whole ramp, or map its set-point or a sensor that follows it",
        )
    return log_columns


def _by_role(material: Material) -> dict[str, list[str]]:
    roles: dict[str, list[str]] = {role: [] for role in ("temperature", "reading", "reference", "set_point")}
    for column in material.campaign.get("columns", ()):
        if column["name"] in material.series:
            roles[column["role"]].append(column["name"])
    if not (material.series and roles["temperature"] and roles["reading"]):
        raise _unusable("there is no imported log with a column of temperature and one of readings")
    return roles


def _unusable(why: str) -> FitError:
    return FitError(
        "B-FIT-060",
        why,
        where="temperature_ramp",
        next_step="import a log with 'bench import' (docs/importing.md) and look at its overloads",
    )


def _readings(
    roles: Mapping[str, list[str]], columns: Mapping[str, Floats], material: Material
) -> tuple[dict[str, Floats], str]:
    """Readings as the fits take them, and their unit."""
    if not roles["reference"]:
        unit = next(str(column["unit"]) for column in material.campaign["columns"] if column["role"] == "reading")
        return {name: columns[name] for name in roles["reading"]}, unit
    reference = np.mean([columns[name] for name in roles["reference"]], axis=0)
    ratios = {}
    for name in roles["reading"]:
        ratio = columns[name] / reference
        ratios[name] = (ratio / np.median(ratio) - 1.0) * 1e6
    return ratios, "ppm"


def ramp_drive(columns: RampColumns, blocks: Blocks) -> Drive:
    """Return the temperature that drives lag and play: means of a minute, or of a tenth of a block if that is shorter.

    The corners of a fast ramp are rounded by a stretch; over a block that is a hundredth of what it turns.
    """
    stretch_s = min(60.0, float(np.median(blocks.end_s - blocks.start_s)) / 10.0)
    _, member = np.unique((columns.t_s // stretch_s).astype(np.int64), return_inverse=True)
    count = np.bincount(member)
    return usable_drive(np.bincount(member, columns.t_s) / count, np.bincount(member, columns.temperature_degC) / count)


def plain_campaign(campaign: Document) -> tuple[dict[str, Any], float]:
    """Unit under test and reference temperature."""
    return dict(campaign["uut"]), float(campaign.get("reference_temperature_degC", 20.0))


@dataclass(frozen=True)
class ReadingFit:
    """Everything fitted to one reading; ``differences`` and ``after_drift`` by name of the sensor."""

    name: str
    readings: Floats  # block means
    drift: DriftFit
    differences: dict[str, list[BranchDifference]]
    after_drift: dict[str, DriftFit]
    joint: RampHysteresis | None


def fit_reading(name: str, columns: RampColumns, blocks: Blocks, reference_degC: float, method: str) -> ReadingFit:
    """Fit one reading: drift and up/down term by every sensor and, with the method "joint", lag and hysteresis."""
    readings, branch = blocks.mean(columns.readings[name]), blocks.mean(columns.branch / 2.0)
    sensors = {sensor: blocks.mean(values) for sensor, values in columns.sensors.items()}
    main = next(iter(sensors.values()))
    drift = fit_drift(blocks, main, readings, branch, reference_degC)
    others = {
        sensor: drift if values is main else fit_drift(blocks, values, readings, branch, reference_degC, drift.noise)
        for sensor, values in sensors.items()
    }
    ramps, filled = columns.main_ramps(), blocks.count >= _LEAST_FILLED * np.median(blocks.count)
    indices = tuple(
        np.flatnonzero(filled & (blocks.start_s >= ramps[kind].start_s) & (blocks.end_s <= ramps[kind].end_s))
        for kind in ("up", "down")
    )
    differences = {
        sensor: branch_differences(drift, values, readings, (indices[0], indices[1]), _whole_degrees(values, indices))
        for sensor, values in sensors.items()
    }
    joint = None
    if method == "joint":
        joint = fit_ramp_hysteresis(blocks, readings, ramp_drive(columns, blocks), drift.noise, reference_degC)
    return ReadingFit(name, readings, drift, differences, others, joint)


def _whole_degrees(values: Floats, ramps: tuple[Integers, ...]) -> list[float]:
    """Whole degrees that both ramps reach."""
    low = max(float(values[ramp].min()) for ramp in ramps if ramp.size)
    high = min(float(values[ramp].max()) for ramp in ramps if ramp.size)
    return [float(at) for at in range(int(np.ceil(low)), int(np.floor(high)) + 1)]
