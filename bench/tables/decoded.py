"""Decoded frames of a link as DataFrames, block by block."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.frame import FrameDefinition, LinkDecoder, Message, cells_of
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.replay import Course, DecodedFrames, decoded_frames
from bench.tables.columns import table
from bench.tables.library import pandas

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
