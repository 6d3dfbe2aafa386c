"""``bench import --guess``: a mapping proposed from what a log shows; what it cannot tell is marked ``FILL_IN``."""

from __future__ import annotations

import re
import sys
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.commands.console import warn
from bench.commands.importing.sniff import Seen, sniff
from bench.model.declaration import Hint
from bench.model.errors import ExitStatus
from bench.model.systems import system_refusals, systems

FILL_IN = "FILL_IN"
_TIME = re.compile(r"(^|[^a-z])(t|ts|utc|tow|sec|secs|seconds|ms|us|ns)([^a-z]|$)|time|date|stamp|epoch")
_EPOCHS = (("s", 5e8, 5e9), ("ms", 5e11, 5e12), ("us", 5e14, 5e15), ("ns", 5e17, 5e18))
_NO_DATE = "1970-01-01T00:00:00Z"
_AXIS = re.compile(r"[xyz](?![a-z])")
_UNIT = re.compile(r"[\[(]\s*([^\])\s]+)\s*[\])]\s*$")
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./]*")
Numbers = NDArray[np.float64]


def guess(path: Path) -> int:
    """Print the proposal; it runs as soon as each FILL_IN is replaced."""
    sys.stdout.write(proposal(sniff(path), path))
    for offer, error in system_refusals():
        warn(f"without {offer.what} of {offer.release}: {error}")
    return ExitStatus.PASS


def proposal(seen: Seen, path: Path) -> str:
    """Return the text of a mapping."""
    numbers = {name: _numbers(values) for name, values in seen.columns.items()}
    time, time_line = _time(seen, numbers)
    lines, hints, units = [], [], _units(numbers)
    for name, values in _together(numbers).items():
        if name == time:
            continue
        hint = None if values is None else _hint(name)
        axis = _axis(name, [other for other in numbers if other != time])
        lines.append(f"  {_key(name)}: {_column(name, hint, axis, units)}  # {_range(values)}")
        hints += [hint] if hint is not None else []
    analysis, others = _analysis(hints)
    missing = any(values is not None and np.isnan(values).any() for values in numbers.values())
    slug = re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_")
    name = slug if slug[:1].isalpha() else f"log_{slug}"
    form = ", ".join(f"{key}: {value}" for key, value in seen.form.items())
    head = [
        f"# Proposed for {path.name} ({seen.kind}) by its first {max(map(len, seen.columns.values()))} rows.",
        f"# Replace each {FILL_IN}, look at roles and units, and name an analysis (docs/importing.md).",
        f"mapping: {name[:40].rstrip('_')}",
        f"uut: {{model: {FILL_IN}, serial: {FILL_IN}}}",
        f"analysis: {analysis}{others}",
        *([f"file: {{{form}}}"] if form else []),
        *(["overload: {values: [nan, '']}  # numbers are missing"] if missing else []),
        "columns:",
        time_line,
    ]
    return "\n".join([*head, *lines]) + "\n"


def _analysis(hints: Sequence[Hint]) -> tuple[str, str]:
    """Return an analysis that takes all roles and asks for nothing more, and a comment with the others that do."""
    roles = {hint.role for hint in hints}
    taking = [
        declared.name
        for system in systems()
        for declared in system.analyses
        if hints and declared.roles and roles <= {*declared.roles, "temperature"}
    ]
    proposed = next((hint.analysis for hint in hints if hint.analysis in taking), "none")
    others = [name for name in taking if name != proposed]
    return proposed, f"  # or: {', '.join(others)}" if others else ""


def _together(numbers: Mapping[str, Numbers | None]) -> dict[str, Numbers | None]:
    """Return the columns with those of one role that come by number as one, ``{0..423}`` in its name."""
    alone: dict[str, Numbers | None] = {}
    groups: dict[tuple[str, str], dict[int, Numbers]] = {}
    for name, values in numbers.items():
        hint, digits = _hint(name), list(re.finditer(r"\d+", name))
        if values is None or hint is None or not hint.numbered or not digits:
            alone[name] = values
        else:
            around = name[: digits[-1].start()], name[digits[-1].end() :]
            groups.setdefault(around, {})[int(digits[-1][0])] = values
    return alone | {
        f"{before}{{{min(group)}..{max(group)}}}{behind}": np.concatenate(list(group.values()))
        for (before, behind), group in groups.items()
    }


def _numbers(values: Sequence[str]) -> Numbers | None:
    """Return a column as numbers, NaN where one is missing; None if it holds other texts."""
    try:
        return np.array([float(text) if text else np.nan for text in values])
    except ValueError:
        return None


def _time(seen: Seen, numbers: Mapping[str, Numbers | None]) -> tuple[str | None, str]:
    """Return the column that says when a row was taken and its line, or a line that numbers the rows."""
    for name in sorted(numbers, key=lambda name: not _TIME.search(name.lower())):
        values = numbers[name]
        told = _TIME.search(name.lower()) is not None
        if values is None:
            if (entry := _dated(seen.columns[name])) is not None:
                return name, f"  {_key(name)}: {entry}  # {seen.columns[name][0]}"
        elif (told or _may_be_time(name, numbers)) and _rises(values):
            return name, f"  {_key(name)}: {_counted(values)}"
    return None, f"  row: {{role: time, format: rows, rate: {FILL_IN}, start: {_NO_DATE}}}  # no column tells the time"


def _may_be_time(name: str, names: Collection[str]) -> bool:
    """Return False for what is known as something else that rises, such as a counter, or is one of x, y and z."""
    hint = _hint(name)
    coordinate = name[-1:] in "xyz" and all(name[:-1] + axis in names for axis in "xyz")
    return (hint is None or hint.by_axis) and not coordinate


def _rises(values: Numbers) -> bool:
    return values.size > 1 and bool(np.all(np.diff(values) >= 0.0)) and bool(values[-1] > values[0])


def _dated(values: Sequence[str]) -> str | None:
    try:
        first = datetime.fromisoformat(values[0])
    except (ValueError, IndexError):
        return None
    return f"{{role: time, format: iso, zone: {'UTC' if first.tzinfo else FILL_IN}}}"


def _counted(values: Numbers) -> str:
    """Return the entry of a column of time in numbers, with the rate that it means."""
    step = float(values[-1] - values[0]) / (values.size - 1)
    for unit, low, high in _EPOCHS:
        if low < values[0] < high:
            return f"{{role: time, format: unix, unit: {unit}}}  # a step of {step:.6g} {unit}"
    if step == 1.0 and np.all(values == np.round(values)):
        return f"{{role: time, format: samples, rate: {FILL_IN}, start: {_NO_DATE}}}  # numbers of samples"
    unit = "s" if 0.0 < step < 1.0 else FILL_IN
    return f"{{role: time, format: elapsed, unit: {unit}, start: {_NO_DATE}}}  # a step of {step:.6g}"


def _hints() -> list[Hint]:
    return [hint for system in systems() for hint in system.log_hints]


def _hint(name: str) -> Hint | None:
    plain = re.sub(r"[\[(][^\])0-9]*[\])]", "", name).lower()
    return next((hint for hint in _hints() if re.search(hint.pattern, plain)), None)


def _units(numbers: Mapping[str, Numbers | None]) -> dict[str, str]:
    """Return the unit of each role by the largest magnitude of its columns, where ranges tell."""
    largest: dict[str, float] = {}
    for name, values in numbers.items():
        hint = None if values is None else _hint(name)
        if hint is not None and values is not None and np.isfinite(values).any():
            largest[hint.role] = max(largest.get(hint.role, 0.0), float(np.nanmedian(np.abs(values))))
    found = {}
    for hint in _hints():
        fitting = [unit for unit, low, high in hint.units or () if low <= largest.get(hint.role, -1.0) < high]
        if len(fitting) == 1:
            found[hint.role] = fitting[0]
    return found


def _column(name: str, hint: Hint | None, axis: str, units: Mapping[str, str]) -> str:
    if hint is None:
        return "{role: ignore}"
    written = _UNIT.search(name)
    unit = written[1] if written and not written[1].isdigit() else units.get(hint.role, FILL_IN)
    entries, behind = [f"role: {hint.role}"], [] if hint.units is None else [f"unit: {unit}"]
    if hint.by_axis:
        entries.append(f"axis: {axis}")
    entries += [f"{key}: {value}" for key, value in hint.more.items()]
    return f"{{{', '.join([*entries, *behind])}}}"


def _axis(name: str, names: Sequence[str]) -> str:
    """Return the axis by the last letter x, y or z of a name, or by its place among three columns of one matrix."""
    bracket = name.rfind("[")
    if name.endswith("]") and name[bracket + 1 : -1].isdigit():
        siblings = [other for other in names if other[: other.rfind("[")] == name[:bracket]]
        return "xyz"[siblings.index(name)] if len(siblings) == 3 else FILL_IN
    found = _AXIS.findall(name.lower())
    return found[-1] if found else FILL_IN


def _range(values: Numbers | None) -> str:
    if values is None or not np.isfinite(values).any():
        return "texts" if values is None else "no numbers"
    return f"{np.nanmin(values):.4g} to {np.nanmax(values):.4g}, median {np.nanmedian(values):.4g}"


def _key(name: str) -> str:
    return name if _PLAIN.fullmatch(name) else "'" + name.replace("'", "''") + "'"
