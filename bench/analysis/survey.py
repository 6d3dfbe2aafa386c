"""Survey of an imported log before any fit: what its rows show by themselves, each finding with what becomes of it.

Rows that say the same again, or hold a code for no reading, are left out, or make a log doubtful whose mapping names
rows; a clock that was set forward is refused; pauses, values that are perhaps a code, a gravity that another unit
would explain and stamps that tell no rate are told, and doubted where they move numbers. An analysis sees the log only
behind it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.doubt import Evidence
from bench.analysis.estimates import Document
from bench.analysis.material import Material
from bench.analysis.wording import say
from bench.maths.arrays import Flags, Floats, Integers
from bench.maths.samples import is_silent, piled_up, repeated_rows, sentinel
from bench.maths.stamps import sample_stamps
from bench.model.errors import FitError

_READ = ("temperature", "reading")  # a fit of one that stands still would be one of rounding
_OF_ROWS = ("temperature", "set_point")  # move on by themselves, whatever the recorder's clock says
_PAUSE = 20.0  # usual steps: a shorter gap is one of rows, the business of who counts them
_BESIDE = 20  # rows on either side of a pause that tell how a column moves
_NO_NUMBER = 1e30  # overloads are 9.9E37 and 9.91E37 (SCPI-99, 7.2.1.4 and 7.2.1.5), or the largest of their type
_FEWEST = 3  # rows
_SIGMA = 8.0  # beyond the scatter of a column: what it should have moved through a pause
_G = 9.80665  # m/s2
_GRAVITY = 0.1  # of g: how far bias, scale and site leave the mean of three axes
_UNITS = {"m/s2": 1.0, "g": 1.0 / _G, "mg": 1e3 / _G, "cm/s2": 100.0}  # of one m/s2


@dataclass(frozen=True)
class Surveyed:
    """``material`` without the rows that say nothing; ``notes`` and ``evidence`` of the survey.

    ``left_out``: number of rows with codes for no reading.
    """

    material: Material
    notes: list[str]
    evidence: list[Evidence]
    left_out: int


def surveyed(material: Material) -> Surveyed:
    """Look at the columns of an imported log; what is no log comes back as it is.

    Raises: FitError B-FIT-144 if its clock jumps forward while the unit goes on unbroken, B-FIT-145 for a column
            that never moves and must, and if codes for no reading leave fewer than three rows.
    """
    columns = [column for column in material.campaign.get("columns", ()) if column.get("name") in material.series]
    t_s = material.series.get("t_s", np.empty(0))
    if t_s.size < _FEWEST or not t_s[-1] > t_s[0]:
        return Surveyed(material, [], [], 0)
    left_out, coded, notes, evidence = _no_readings(columns, material)
    series = _rows(material.series, ~left_out)
    again = _repeated(columns, series)
    row = np.flatnonzero(~left_out) + 1  # of the file
    if again.any():
        times = 1.0 / (1.0 - float(again.mean()))
        about = {"count": int(again.sum()), "of": again.size, "times": times}
        if material.campaign.get("segments"):
            evidence.append(Evidence("repeated_rows", say("survey.repeated_kept", **about), times, 0.0))
        else:
            notes.append(say("survey.repeated", **about))
            series, row = _rows(series, ~again), row[~again]
    material, t_s = replace(material, series=series), series["t_s"]
    stamps = sample_stamps(t_s)
    steps = np.diff(t_s) * stamps.rate_Hz
    long = np.flatnonzero(steps > _PAUSE)
    _refuse_set_clock(steps, stamps.rate_Hz, long, columns, material.series, row)
    if long.size:
        worst, pauses_s = long[int(np.argmax(steps[long]))], steps[long] / stamps.rate_Hz
        about = {"whole": float(pauses_s.sum()), "longest": float(pauses_s.max())}
        notes.append(say("survey.pauses", count=long.size, row=row[worst], **about))
    if not stamps.sure and any(column.get("axis") for column in columns):
        evidence.append(Evidence("no_rate", say("survey.no_rate", rate=stamps.rate_Hz), stamps.crowded, 0.0))
    for column in columns:
        values = material.series[str(column["name"])]
        if column["role"] in _READ and is_silent(values):
            raise _still(f"the column {column['header']} has one and the same value in all rows")
        if column.get("axis") and column not in coded:
            evidence += _clipped(column, values)
    return Surveyed(material, notes, [*evidence, *_gravity(columns, material.series)], int(left_out.sum()))


def _repeated(columns: list[Document], series: Mapping[str, Floats]) -> Flags:
    """Return the rows that repeat every column but those that may stand still, of a log with sensors; else none."""
    if not any(column.get("axis") for column in columns):
        return np.zeros(series["t_s"].size, np.bool_)
    return repeated_rows([series[str(column["name"])] for column in columns if column["role"] not in _OF_ROWS])


def _refuse_set_clock(
    steps: Floats, rate_Hz: float, long: Integers, columns: list[Document], series: Mapping[str, Floats], row: Integers
) -> None:
    """Refuse a pause through which a column that moves steadily has not moved: the clock was set, nothing is missing.

    Raises: FitError B-FIT-144.
    """
    for column in columns:
        if column.get("role") not in _OF_ROWS:
            continue
        values = series[str(column["name"])]
        for at in long.tolist():
            if _unbroken(values, at, steps[at]):
                raise FitError(
                    "B-FIT-144",
                    f"the time jumps forward by {steps[at] / rate_Hz:.6g} s behind row {row[at]}, while "
                    f"{column['header']} goes on as from one row to the next",
                    where=f"row {row[at + 1]}",
                    next_step="the clock was set (summer time?): take the offset off these stamps, or map "
                    "'format: rows' with the rate of the recorder",
                )


def _unbroken(values: Floats, at: int, steps: float) -> bool:
    """Return whether a column moves steadily on both sides of a pause of so many steps, and through it by one of them.

    ``at``: row in front of the pause.
    """
    before, behind = values[max(0, at - _BESIDE + 1) : at + 1], values[at + 1 : at + 1 + _BESIDE]
    if min(before.size, behind.size) < _BESIDE or not (np.isfinite(before).all() and np.isfinite(behind).all()):
        return False
    row = np.arange(_BESIDE)
    lines = [np.polyfit(row, part, 1) for part in (before, behind)]
    left = [part - np.polyval(line, row) for part, line in zip((before, behind), lines, strict=True)]
    noise = float(np.std(np.concatenate(left))) * 2.0 / _BESIDE**0.5 + 1e-12 * float(np.abs(values[at]))
    slope = (float(lines[0][0]) + float(lines[1][0])) / 2.0
    moved = float(np.polyval(lines[1], 0.0) - np.polyval(lines[0], _BESIDE - 1.0))
    return bool(abs(slope) * (steps - 1.0) > 4.0 * _SIGMA * noise and abs(moved - slope) < _SIGMA * noise)


def _no_readings(
    columns: list[Document], material: Material
) -> tuple[Flags, list[Document], list[str], list[Evidence]]:
    """Return the rows to leave out because they hold a code for no reading, columns with codes, notes and doubts.

    Raises: FitError B-FIT-145 if fewer than three rows are left.
    """
    left_out = np.zeros(material.series["t_s"].size, np.bool_)
    coded: list[Document] = []
    notes: list[str] = []
    evidence: list[Evidence] = []
    for column in columns:
        for value, there, sure in _codes(column, material.series[str(column["name"])]):
            coded.append(column)
            count, row = int(there.sum()), int(there.argmax()) + 1
            about = {"name": column["header"], "value": value, "count": count, "row": row}
            if sure and not material.campaign.get("segments"):
                notes.append(say("survey.no_reading", **about))
                left_out |= there
            else:
                sentence = say("survey.sentinel", **about)
                evidence.append(Evidence("no_reading", sentence, float(count), 0.0, conditions=_place(column)))
    if left_out.size - left_out.sum() < _FEWEST:
        raise _still(f"of {left_out.size} rows {left_out.sum()} hold codes for no reading")
    return left_out, coded, notes, evidence


def _codes(column: Document, values: Floats) -> Iterator[tuple[float, Flags, bool]]:
    """Yield each value that stands in place of readings, the rows with it, and whether nothing else explains it."""
    no_number = np.abs(values) >= _NO_NUMBER
    if no_number.any():
        yield float(values[no_number][0]), no_number, True
    code = None if column["role"] == "set_point" else sentinel(np.where(no_number, np.nan, values))
    if code:
        value, outside = code
        yield value, values == value, outside


def _rows(series: Mapping[str, Floats], kept: Flags) -> Mapping[str, Floats]:
    return {name: values[kept] for name, values in series.items()}


def _still(why: str) -> FitError:
    return FitError(
        "B-FIT-145",
        why,
        next_step="map the column that moves, or leave this one out of the mapping ('role: ignore')",
    )


def _clipped(column: Document, values: Floats) -> Iterator[Evidence]:
    """Yield a doubt for each end of the range of a sensor that its readings pile up at."""
    for end in piled_up(str(column["header"]), values[np.isfinite(values)]):
        about = {"value": end.figures["extreme"], "count": end.count, "of": end.of}
        sentence = say("survey.clipped", name=column["header"], **about)
        yield Evidence("clipped", sentence, None, 0.0, conditions=_place(column))


def _place(column: Document) -> Document:
    """Return the conditions of estimates of a sensor; of any other column all estimates are."""
    return {"kind": column["role"], "axis": column["axis"]} if column.get("axis") else {}


def _gravity(columns: list[Document], series: Mapping[str, Floats]) -> Iterator[Evidence]:
    """Yield a doubt where three accelerometers read another gravity than there is: they have another unit or scale."""
    axes = {column.get("axis"): column for column in columns if column.get("role") == "accelerometer"}
    unit = str(next(iter(axes.values()), {}).get("unit"))
    if set(axes) != {"x", "y", "z"} or unit not in _UNITS:
        return
    triad = np.column_stack([series[str(column["name"])] for column in axes.values()])
    with np.errstate(over="ignore"):
        size = float(np.nanmedian(np.sqrt(np.square(triad).sum(axis=1)))) / _UNITS[unit]
    if abs(size / _G - 1.0) <= _GRAVITY or not np.isfinite(size):
        return
    right = [name for name, factor in _UNITS.items() if abs(size * _UNITS[unit] / factor / _G - 1.0) <= _GRAVITY]
    key = "survey.gravity_unit" if right else "survey.gravity"
    sentence = say(key, size=size * _UNITS[unit], unit=unit, due=_G * _UNITS[unit], right=right[0] if right else "")
    yield Evidence("gravity", sentence, size / _G, 0.0, conditions={"kind": "accelerometer"})
