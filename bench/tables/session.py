"""A recorded session for people who compute: its tables, each read when it is asked for the first time."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import estimates_of, validate_results
from bench.frame import FrameDefinition, LinkDecoder, Message, cells_of
from bench.model.clock import NS
from bench.model.errors import BenchError, InputError
from bench.model.events import Reading
from bench.model.quantities import Quality
from bench.model.segments import session_segments
from bench.plan import driver_actions
from bench.record import Damage, RecordRow, SessionReader
from bench.replay import (
    IMPORT,
    Course,
    DecodedFrames,
    Replayed,
    decoded_frames,
    read_course,
    replay_rows,
    replay_series,
    session_frames,
)
from bench.session.record_states import row_problem, sample_problem
from bench.tables.columns import UNITS, spread, table, table_of_estimates, typed, unit_of
from bench.tables.library import pandas

if TYPE_CHECKING:
    from pandas import DataFrame

if TYPE_CHECKING:
    from pandas import DataFrame


Window = tuple[int | None, int | None]
"""UTC, ns: frames that came later than the first and not later than the second; None: no bound."""
_INTEGERS = "iu"


def message_of(definition: FrameDefinition, link: str, name: str | None) -> Message:
    """Return a message of a link; without a name the only one, or the one that counts frames.

    Raises: InputError B-TAB-003 if the link has no message of that name, or several and none was named.
    """
    messages = {message.name: message for message in definition.layout.messages}
    if name is None:
        streamed = [message for message in messages.values() if message.counter is not None]
        if len(messages) == 1 or len(streamed) == 1:
            return streamed[0] if len(streamed) == 1 else next(iter(messages.values()))
    elif name in messages:
        return messages[name]
    raise InputError(
        "B-TAB-003",
        f"there is no message {name!r}" if name is not None else "several messages, and none of them was named",
        where=f"link {link}",
        next_step=f"name one of: {', '.join(messages)}",
    )


def window_of(start: object, stop: object) -> Window:
    """Return what pandas reads as times, UTC where they name no zone. Raises: InputError B-TAB-004."""
    return _utc_ns(start), _utc_ns(stop)


def _utc_ns(moment: object) -> int | None:
    if moment is None:
        return None
    try:
        stamp = pandas().Timestamp(moment)
        stamp = stamp.tz_localize("UTC") if stamp.tz is None else stamp.tz_convert("UTC")
        return int(stamp.as_unit("ns").value)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(
            "B-TAB-004",
            f"{moment!r} is no time",
            where="start, stop",
            next_step="give a UTC time such as '2000-01-01T12:00:00', or one of the index of a table",
        ) from error


def blocks_of_frames(
    folder: Path, link: str, definition: FrameDefinition, course: Course, messages: Collection[str],
    window: Window = (None, None), columns: Sequence[str] | None = None,
) -> Iterator[tuple[str, DataFrame]]:  # fmt: skip
    """Yield name of a message and a table of some of its frames, in order; those of a message make one table.

    Args:   window: frames of start < time <= stop.   columns: names of fields, or of their elements; None: all.
    Raises: InputError B-TAB-005 for a column that is none; those of ``decoded_frames``.
    """
    chosen = {name: _chosen(definition, name, columns) for name in messages}
    low, high = window
    seconds = None if low is None and high is None else ((low or 0) / NS, 4e9 if high is None else high / NS)
    for frames in decoded_frames(folder, link, definition, course, seconds):
        name = frames.batch.message.name
        if name in chosen:
            shown = _table(frames, course.utc_offset_ns, window, chosen[name])
            if len(shown):
                yield name, shown


def no_frames(definition: FrameDefinition, name: str, columns: Sequence[str] | None = None) -> DataFrame:
    """Return the table of a message of which no frame came: all its columns, no row."""
    frames = DecodedFrames(LinkDecoder(definition).flush().messages[name], np.empty(0, np.int64))
    return _table(frames, 0, (None, None), _chosen(definition, name, columns))


def _chosen(definition: FrameDefinition, name: str, columns: Sequence[str] | None) -> Collection[str] | None:
    """Return names of columns, an array field standing for all of its elements; None for all."""
    if columns is None:
        return None
    known = no_frames(definition, name).columns.tolist()
    fields = {item.name: item for message in definition.layout.messages if message.name == name
              for item in message.fields}  # fmt: skip
    found: list[str] = []
    for column in columns:
        count = fields[column].count if column in fields else None
        of_array = [f"{column}_{element + 1}" for element in range(count or 0)]
        names = [column] if column in known else [element for element in of_array if element in known]
        if not names:
            raise InputError("B-TAB-005", f"there is no column {column!r}", where=f"message {name}",
                             next_step=f"use one of: {', '.join(known[1:])}")  # fmt: skip
        found += names
    return found


def _table(frames: DecodedFrames, offset_ns: int, window: Window, chosen: Collection[str] | None) -> DataFrame:
    inside = _inside(frames.t_mono_ns + offset_ns, window)
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    for item in frames.batch.message.fields:
        if item.constant is None and (chosen is None or any(name.startswith(item.name) for name in chosen)):
            for name, unit, values in cells_of(frames.batch, item):
                if chosen is None or name in chosen:
                    columns[name], units[name] = _column(values[inside]), unit
    return table(columns, units, frames.t_mono_ns[inside], offset_ns)


def _inside(t_utc_ns: NDArray[np.int64], window: Window) -> Any:
    """Return which of some times lie in a window; all of them as a slice, which copies nothing."""
    low, high = window
    if low is None and high is None:
        return slice(None)
    above = np.ones(len(t_utc_ns), np.bool_) if low is None else t_utc_ns > low
    return above if high is None else above & (t_utc_ns <= high)


def _column(values: Any) -> Any:
    """Return values with those that are not there as NA."""
    plain = np.ascontiguousarray(np.ma.getdata(values))
    if not np.ma.isMaskedArray(values):
        return plain
    mask = np.ma.getmaskarray(values)
    if plain.dtype.kind in _INTEGERS:
        return pandas().arrays.IntegerArray(plain, mask.copy())
    plain = plain.copy()
    plain[mask] = None if plain.dtype.hasobject else np.nan
    return plain


RESULTS = "results.json"


class Session:
    """A recorded session. Nothing is read before it is asked for, and a table is kept once it is read.

    Tables are pandas DataFrames. ``attrs["units"]`` has the unit of each column that has one, ``attrs["session"]`` the
    name of the session, ``attrs["simulated"]`` whether it is simulated. The index ``time`` is UTC; a session that
    holds no UTC counts from 1970. ``t_mono_ns`` is the monotonic time of the session, on which order and lengths rest.

    Args:   folder: the session's folder.
    Raises: InputError B-REC-010 if there is no session, B-TAB-001 from tables if pandas is missing; SessionDamaged
            B-REC-012, B-REC-014 for what is lost, B-RPL-002, B-RPL-003 from ``records``.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        session_segments(self.folder)
        self._reader = SessionReader(self.folder)

    def __repr__(self) -> str:
        return f"<Session {self.folder}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Session, (self.folder,)

    @property
    def manifest(self) -> Mapping[str, Any]:
        """Return the manifest: what was run, on which unit, with which standards (docs/session-format.md)."""
        return self._reader.manifest

    @property
    def texts(self) -> Mapping[str, str]:
        """Return text of the compiled plan and of every YAML file it was run from, by name."""
        return self._reader.texts

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Return names of the links whose frames can be decoded."""
        return tuple(self._definitions)

    def messages(self, link: str) -> tuple[str, ...]:
        """Return the messages of a link's frames. Raises: InputError B-TAB-002 if there is no such link."""
        return tuple(message.name for message in self._definition(link).layout.messages)

    @cached_property
    def events(self) -> DataFrame:
        """Return everything that happened, in order: ``t_mono_ns``, ``kind`` and ``fields``, a dictionary."""
        return self._named(table_of_events(self._course))

    @cached_property
    def readings(self) -> DataFrame:
        """Return readings of instruments in order: ``role``, ``name`` (action), ``value``, its ``unit``, conditions."""
        return self._named(table_of_readings(self._course, self.manifest))

    @cached_property
    def log(self) -> DataFrame:
        """Return the columns of an imported log in base units, NaN for an overload; empty for any other session.

        Raises: as ``bench replay`` of it.
        """
        if self.manifest.get("kind") != IMPORT:
            return self._named(table({}, {}, []))
        columns = dict(replay_series(self.folder).columns)
        units = {column["name"]: column["unit"] for column in self.manifest["campaign"]["columns"]}
        t_mono_ns = np.rint(columns.pop("t_s") * NS)
        return self._named(table(columns, units, t_mono_ns, self.utc_offset_ns))

    @property
    def records(self) -> DataFrame:
        """Return records by number, cut anew from the raw bytes: counts, quality, conditions, sums, means."""
        return self._records[0]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return sentences about damage and what is understood differently today; reads what ``records`` reads."""
        damage, notes = self._records[1:]
        return (*(f"damaged: {place}" for place in damage), *notes)

    @property
    def damaged(self) -> bool:
        """Return whether anything of the session cannot be read as it was written."""
        return bool(self._records[1])

    @cached_property
    def estimates(self) -> DataFrame:
        """Return the estimates of results.json: quantity, unit, value, uncertainties, verdict, quality, conditions.

        Raises: InputError B-TAB-006 if there are no results, B-FIT-010 if they are not in their form.
        """
        return self._named(table_of_estimates(estimates_of(self.results)))

    @cached_property
    def results(self) -> Mapping[str, Any]:
        """Return the document results.json. Raises: as ``estimates``."""
        path = self.folder / RESULTS
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(
                "B-TAB-006", f"cannot be read: {error}", where=str(path),
                next_step="fit the session: 'bench fit SESSION --json', or bench.fit(path)",
            ) from error  # fmt: skip
        validate_results(document, str(path))
        results: Mapping[str, Any] = document
        return results

    def frames(
        self, link: str, message: str | None = None, start: object = None, stop: object = None,
        columns: Sequence[str] | None = None,
    ) -> DataFrame:  # fmt: skip
        """Decode the frames of a link: (n, fields) in the units of the frame file, elements of arrays as columns.

        Frames that fail their check are not in it; what a frame does not hold is NA. Only chunks that touch the window
        are read, block by block, so memory is that of what is returned.

        Args:   message: which of several.   start, stop: frames of start < time <= stop, UTC as text, datetime or
                Timestamp; None: from the beginning, to the end. Times are those of reception: which frames a record
                has exactly, its ``first_counter`` says.   columns: fields (an array stands for all
                its elements) or single columns such as ``npp_3``; None: all.
        Raises: InputError B-TAB-002 (no such link), B-TAB-003 (message), B-TAB-004 (time), B-TAB-005 (column).
        """
        definition = self._definition(link)
        name, window = message_of(definition, link, message).name, window_of(start, stop)
        found = blocks_of_frames(self.folder, link, definition, self._course, (name,), window, columns)
        blocks = [block for _, block in found]
        if not blocks:
            return self._named(no_frames(definition, name, columns))
        joined = pandas().concat(blocks)
        joined.attrs.update(blocks[0].attrs)
        return self._named(joined)

    def frame_blocks(self, link: str) -> Iterator[tuple[str, DataFrame]]:
        """Yield the frames of all messages of a link, block by block: name of the message, a table as ``frames``."""
        definition = self._definition(link)
        found = blocks_of_frames(self.folder, link, definition, self._course, self.messages(link))
        yield from ((name, self._named(block)) for name, block in found)

    def empty_frames(self, link: str, message: str) -> DataFrame:
        """Return the columns that ``frames`` of a message has, without a row."""
        return self._named(no_frames(self._definition(link), message))

    @cached_property
    def _definitions(self) -> Mapping[str, FrameDefinition]:
        return session_frames(self.folder)

    def _definition(self, link: str) -> FrameDefinition:
        if link not in self._definitions:
            raise InputError(
                "B-TAB-002",
                f"the session has no link {link!r} with a frame definition",
                where=str(self.folder),
                next_step=f"use one of: {', '.join(self.links) or 'none'}",
            )
        return self._definitions[link]

    @property
    def utc_offset_ns(self) -> int:
        """Return UTC minus ``t_mono_ns``, ns; 0 for a session that holds no UTC."""
        return self._course.utc_offset_ns

    @cached_property
    def _records(self) -> tuple[DataFrame, tuple[Damage, ...], tuple[str, ...]]:
        """Return the table, what is damaged, and notes; the samples that a record may hold are not kept."""
        replayed = replay_rows(self.folder)
        records = self._named(table_of_records(replayed, self._definitions))
        return records, replayed.damage, replayed.notes

    @cached_property
    def _course(self) -> Course:
        return read_course(self.folder)

    def _named(self, frame: DataFrame) -> DataFrame:
        frame.attrs["session"] = str(self.manifest.get("session", self.folder.name))
        frame.attrs["simulated"] = bool(self.manifest.get("simulated"))
        return frame


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
