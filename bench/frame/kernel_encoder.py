"""The compiled encoder: the same frames as those of ``bench.frame.encode``, written in one pass of the kernel."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.frame.encode import values_of, with_automatic
from bench.frame.kernel import task as order
from bench.frame.kernel.arrays import AT, FIELD_NUMBERS, FIELDS, FIELDS_AT, MESSAGE_NUMBERS, MESSAGES_AT, Arrays
from bench.frame.layout import Field, Layout, Message

_AT_ONCE = 4096  # frames; their stage stays in the second-level cache
_SIGNED = "bhilq"
_SPARE = ctypes.byref(ctypes.c_int64())
_Memory = ctypes.c_char * 1


class _Stage(NamedTuple):
    """Memory for the columns that the kernel takes, up to ``room`` frames; ``views``: its arrays by field and type."""

    memory: NDArray[np.uint8]
    address: ctypes.Array[ctypes.c_char]
    room: int
    task: ctypes.Array[ctypes.c_int64]
    views: dict[tuple[str, str], NDArray[Any]]


class _Place(NamedTuple):
    """A field: its number in the definition, elements, elements of the fields before, dimensions of its column.

    ``kinds``: of the types of values that the kernel takes; ``char``: the type that they get first, "" for none.
    """

    item: Field
    number: int
    elements: int
    before: int
    dimensions: int
    kinds: str
    char: str


class KernelEncoder:
    """Compiled encoder of one message of fixed length."""

    def __init__(self, layout: Layout, message: Message, arrays: Arrays, encode: Callable[..., Any]) -> None:
        self._layout = layout
        self._message = message
        self._encode = encode
        self._arrays = arrays  # the kernel reads them by their address
        self._address = int(arrays.numbers.ctypes.data)
        self._places = _places(layout, message, arrays)
        stop = message.length - layout.check.size if message.cover_stop is None else message.cover_stop
        self._covered = message.cover_start, stop
        self._elements = sum(place.elements for place in self._places)
        self._template = _template(layout, message)
        self._stages: list[_Stage] = []  # taken while they are used: threads may encode at the same time

    def rows(self, columns: Mapping[str, Any], count: int) -> NDArray[np.uint8] | None:
        """Return frames (count, length) uint8; None if something is wrong or unusual, numpy's encoder then says what.

        Raises: InputError as ``FrameDefinition.encode``.
        """
        given = with_automatic(self._layout, self._message, columns, self._message.length)
        taken = []
        for place in self._places:
            values = values_of(place.item, given)
            if not isinstance(values, bytes):
                if values.dtype.kind not in place.kinds or values.ndim > place.dimensions:
                    return None
                taken.append((place, values))
        rows = np.empty((count, self._message.length), np.uint8)
        if count <= _AT_ONCE:
            return rows if self._write(rows, taken) else None
        for start in range(0, count, _AT_ONCE):
            part = slice(start, min(count, start + _AT_ONCE))
            if not self._write(rows[part], [(place, _cut(place, values, part, count)) for place, values in taken]):
                return None
        return rows

    def _write(self, rows: NDArray[np.uint8], taken: list[tuple[_Place, NDArray[Any]]]) -> bool:
        """Write frames; return whether all numbers have the right shape and fit."""
        count, stage = len(rows), self._stage_of(len(rows))
        task = [self._address, count, self._message.length, len(taken), *self._covered]
        try:
            for place, values in taken:
                char = place.char or values.dtype.char
                view = stage.views.get((place.item.name, char))
                if view is None:
                    view = stage.views[place.item.name, char] = _view(stage, place, char)
                view[:count] = values
                task += (place.number, 8 * place.before * stage.room, view.itemsize, char in _SIGNED)
        except ValueError:  # another shape
            return False
        struct.pack_into(f"{len(task)}q", stage.task, 0, *task)
        self._encode(_SPARE, None, _Memory.from_buffer(rows.data), self._template, stage.address, stage.task)
        fits = bool(stage.task[0])
        self._stages.append(stage)
        return fits

    def _stage_of(self, count: int) -> _Stage:
        try:
            stage = self._stages.pop()
        except IndexError:
            stage = None
        if stage is not None and stage.room >= count:
            return stage
        room = 1 << max(count - 1, 63).bit_length()
        memory = np.empty(8 * self._elements * room + 8, np.uint8)
        task = (ctypes.c_int64 * (order.OF_GIVEN + order.GIVEN_NUMBERS * len(self._places)))()
        return _Stage(memory, _Memory.from_buffer(memory.data), room, task, {})


def _view(stage: _Stage, place: _Place, char: str) -> NDArray[Any]:
    """Return the column of a field in a stage for values of that type."""
    shape = (stage.room,) if place.item.count is None else (stage.room, place.elements)
    return np.ndarray(shape, np.dtype(char), stage.memory, 8 * place.before * stage.room)


def _cut(place: _Place, values: NDArray[Any], part: slice, count: int) -> NDArray[Any]:
    """Return the values of some frames; what is the same for all frames stays."""
    each = values.ndim == place.dimensions and len(values) == count
    return values[part] if each else values


def _places(layout: Layout, message: Message, arrays: Arrays) -> list[_Place]:
    numbers, index = arrays.numbers, layout.messages.index(message)
    number = int(numbers[numbers[MESSAGES_AT] + MESSAGE_NUMBERS * index + FIELDS])
    places: list[_Place] = []
    before = 0
    for item in message.fields:
        elements = 1 if item.count is None else item.count
        assert numbers[numbers[FIELDS_AT] + FIELD_NUMBERS * number + AT] == item.offset
        dimensions, real = 1 if item.count is None else 2, item.kind == "f"
        char = np.dtype(item.dtype).char if real else ""
        places.append(_Place(item, number, elements, before, dimensions, "f" if real else "iub", char))
        number, before = number + 1, before + elements
    return places


def _template(layout: Layout, message: Message) -> bytes:
    """Return a frame with its sync bytes and what the definition fixes, else zeros."""
    frame = bytearray(message.length)
    frame[: len(layout.sync)] = layout.sync
    for item in message.fields:
        fixed = item.constant or item.default
        if fixed is not None:
            frame[item.offset : item.offset + item.length] = fixed
    return bytes(frame)
