"""Survey of an imported log before any fit: what its rows show by themselves, each finding with what becomes of it.

Rows that say the same again are left out, or make a log doubtful whose mapping names rows; a clock that was set forward
is refused; pauses, values that stand for no reading, a gravity that another unit would explain and stamps that tell no
rate are told, and doubted where they move numbers. An analysis sees the log only behind it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.doubt import Evidence
from bench.analysis.form import Document
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
_SIGMA = 8.0  # beyond the scatter of a column: what it should have moved through a pause
_G = 9.80665  # m/s2
_GRAVITY = 0.1  # of g: how far bias, scale and site leave the mean of three axes
_UNITS = {"m/s2": 1.0, "g": 1.0 / _G, "mg": 1e3 / _G, "cm/s2": 100.0}  # of one m/s2


@dataclass(frozen=True)
class Surveyed:
    """``material`` without the rows that say nothing; ``notes`` and ``evidence`` of the survey."""

    material: Material
    notes: list[str]
    evidence: list[Evidence]


def surveyed(material: Material) -> Surveyed:
    """Look at the columns of an imported log; what is no log comes back as it is.

    Raises: FitError B-FIT-144 if its clock jumps forward while the unit goes on unbroken, B-FIT-145 for a column
            that never moves and must.
    """
    columns = [column for column in material.campaign.get("columns", ()) if column.get("name") in material.series]
    t_s = material.series.get("t_s", np.empty(0))
    if t_s.size < 3 or not t_s[-1] > t_s[0]:
        return Surveyed(material, [], [])
    notes: list[str] = []
    evidence: list[Evidence] = []
    again = _repeated(columns, material.series)
    if again.any():
        times = 1.0 / (1.0 - float(again.mean()))
        if material.campaign.get("segments"):
            sentence = say("survey.repeated_kept", count=int(again.sum()), of=again.size, times=times)
            evidence.append(Evidence("repeated_rows", sentence, times, 0.0))
        else:
            notes.append(say("survey.repeated", count=int(again.sum()), of=again.size, times=times))
            series = {name: values[~again] for name, values in material.series.items()}
            material, t_s = replace(material, series=series), t_s[~again]
    row = np.flatnonzero(~again) + 1 if t_s.size < again.size else np.arange(again.size) + 1  # of the file
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
            raise FitError(
                "B-FIT-145",
                f"the column {column['header']} has one and the same value in all rows",
                next_step="map the column that moves, or leave this one out of the mapping ('role: ignore')",
            )
        evidence += _no_readings(column, values, row)
    return Surveyed(material, notes, [*evidence, *_gravity(columns, material.series)])


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


def _no_readings(column: Document, values: Floats, row: Integers) -> Iterator[Evidence]:
    """Yield a doubt for a value in place of readings, such as 9.9e37, 85 or 0, and for the end of a range."""
    found = None if column.get("role") == "set_point" else sentinel(values)
    if found is None:
        for end in piled_up(str(column["header"]), values[np.isfinite(values)]) if column.get("axis") else []:
            about = {"value": end.figures["extreme"], "count": end.count, "of": end.of}
            yield Evidence("clipped", say("survey.clipped", name=column["header"], **about), None, 0.0,
                           conditions=_place(column))  # fmt: skip
        return
    rows = np.flatnonzero(values == found)
    sentence = say("survey.sentinel", name=column["header"], value=found, count=rows.size, row=row[rows[0]])
    yield Evidence("no_reading", sentence, float(rows.size), 0.0, conditions=_place(column))


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
