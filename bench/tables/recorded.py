"""Tables of what a session holds beside its frames: events, readings of instruments, records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bench.frame import FrameDefinition
from bench.model.errors import BenchError
from bench.model.events import Reading
from bench.model.quantities import Quality
from bench.plan import driver_actions
from bench.record import RecordRow
from bench.replay import Course, Replayed
from bench.session.record_states import row_problem, sample_problem
from bench.tables.columns import UNITS, spread, table, typed, unit_of

if TYPE_CHECKING:
    from pandas import DataFrame

VALUE, UNIT = "value", "unit"


def table_of_events(course: Course) -> DataFrame:
    """Return every event, a row each: ``kind`` and ``fields``, a dictionary (docs/session-format.md)."""
    columns = {
        "kind": typed([kind for _, kind, _ in course.events]),
        "fields": typed([dict(fields) for _, _, fields in course.events]),
    }
    return table(columns, {}, [t_ns for t_ns, _, _ in course.events], course.utc_offset_ns)


def table_of_readings(course: Course, manifest: Mapping[str, Any]) -> DataFrame:
    """Return every reading of an instrument, a row each; a value of several numbers is spread over columns of its own.

    ``value`` is a number in the ``unit`` of its row, NaN where the instrument gave none (``code`` says why) or gave
    words, which are in ``value_text``. The unit is the one
    that the driver declares for its action; NA where it declares none or is not installed here.
    """
    readings = [(t_ns, fields) for t_ns, kind, fields in course.events if kind == Reading.kind]
    fields = [reading for _, reading in readings]
    values = [reading.get(VALUE) for reading in fields]
    columns: dict[str, list[Any]] = {name: [row.get(name) for row in fields] for name in ("step", "role", "name")}
    columns[VALUE] = [value if isinstance(value, int | float) else None for value in values]
    actions = [(row.get("role"), row.get("name")) for row in fields]
    units = {action: _unit(manifest, *action) for action in set(actions)}
    columns[UNIT] = [
        None if isinstance(value, Mapping) else units[action] for value, action in zip(values, actions, strict=True)
    ]
    parts = [{f"{VALUE}_text": value} if isinstance(value, str) else value for value in values]
    columns |= spread([part if isinstance(part, Mapping) else {} for part in parts], columns, f"{VALUE}_")
    for name in ("quality", "code", "text", "uut"):
        columns[name] = [row.get(name) for row in fields]
    columns |= spread([row.get("conditions") or {} for row in fields], columns)
    frame = _timed(columns, [t_ns for t_ns, _ in readings], course.utc_offset_ns)
    frame[VALUE] = frame[VALUE].astype("float64")
    return frame


def _unit(manifest: Mapping[str, Any], role: Any, name: Any) -> str | None:
    """Return the unit that the driver of a role declares for an action."""
    standard = manifest.get("standards", {}).get(role, {})
    try:
        action = driver_actions(str(standard.get("driver"))).get(name)
    except BenchError:  # the driver of another laboratory
        return None
    return None if action is None else action.returns or None


def table_of_records(replayed: Replayed, definitions: Mapping[str, FrameDefinition]) -> DataFrame:
    """Return every record that counts, a row each, indexed by its start.

    ``stop``: UTC of its end; ``frames`` of the ``frames_asked`` are good; ``valid``: no analysis leaves it out for its
    own sake, else ``problem`` says why; ``flags``: names of its quality flags. Conditions are columns, ``mean_<name>``
    are means of the housekeeping, ``sum_<field>`` sums of what its frames count, as sent.
    """
    rows, offset_ns = replayed.rows, replayed.utc_offset_ns or 0
    columns = _of_windows(rows)
    columns |= spread([row.window.conditions for row in rows], columns)
    columns |= spread([{f"mean_{name}": mean for name, mean in row.context.items()} for row in rows], columns)
    columns |= spread([_sums(row) for row in rows], columns)
    frame = _timed(columns, [row.window.t_start_ns for row in rows], offset_ns)
    frame.attrs[UNITS] |= {name: unit for name, unit in _units_of_sums(definitions) if name in frame}
    stop = table({}, {}, [row.window.t_end_ns for row in rows], offset_ns).index
    frame.insert(1, "stop", stop)
    return frame


def _of_windows(rows: Sequence[RecordRow]) -> dict[str, list[Any]]:
    problems = [sample_problem(row) if row.samples is not None else row_problem(row) for row in rows]
    return {
        **_attributes([row.window for row in rows], ("t_end_ns", "number", "link", "step", "uut")),
        "valid": [not problem for problem in problems],
        "problem": problems,
        "flags": [" ".join(str(flag.name) for flag in Quality if flag in row.quality) for row in rows],
        "first_counter": [row.window.first_counter for row in rows],
        "frames_asked": [row.window.frames for row in rows],
        **_attributes(rows, ("frames", "lost", "bad", "duplicate", "suspect", "readings", "unread")),
    }


def _attributes(rows: Sequence[object], names: Sequence[str]) -> dict[str, list[Any]]:
    """Return columns of what rows have under these names."""
    return {name: [getattr(row, name) for row in rows] for name in names}


def _sums(row: RecordRow) -> dict[str, int]:
    sums: dict[str, int] = {}
    for name, total in row.sums.items():
        if total.ndim == 0:
            sums[f"sum_{name}"] = int(total)
        else:
            sums |= {f"sum_{name}_{element}": value for element, value in enumerate(total.tolist(), 1)}
    return sums


def _units_of_sums(definitions: Mapping[str, FrameDefinition]) -> Iterator[tuple[str, str]]:
    for definition in definitions.values():
        for item in (item for message in definition.layout.messages for item in message.fields):
            for element in ("", *(f"_{number + 1}" for number in range(item.count or 0))):
                if item.unit and not item.scaled:
                    yield f"sum_{item.name}{element}", item.unit


def _timed(columns: Mapping[str, Sequence[Any]], t_mono_ns: Sequence[int], offset_ns: int) -> DataFrame:
    units = {name: unit_of(name) for name in columns}
    return table({name: typed(values) for name, values in columns.items()}, units, t_mono_ns, offset_ns)
