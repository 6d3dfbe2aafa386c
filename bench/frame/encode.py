"""Numbers to frames: vectorised for messages of fixed length, one at a time for all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame.layout import Field, Layout, Message
from bench.model.errors import InputError

_WHERE = "frame encoder"


def encode_rows(layout: Layout, message: Message, columns: Mapping[str, Any], count: int) -> NDArray[np.uint8]:
    """Return frames (count, length) uint8, check included; see FrameDefinition.encode."""
    if message.length == 0:
        text = f"the message {message.name!r} has no fixed length"
        raise InputError("B-FRAME-020", text, where=_WHERE, next_step="encode it one by one with encode_one")
    rows = np.zeros((count, message.length), np.uint8)
    rows[:, : len(layout.sync)] = np.frombuffer(layout.sync, np.uint8)
    given = with_automatic(layout, message, columns, message.length)
    for item in message.fields:
        _put(rows, item, given, count)
    size = layout.check.size
    stop = message.length - size if message.cover_stop is None else message.cover_stop
    values = layout.check.of_rows(rows[:, message.cover_start : stop]).astype("<u8")
    stored = values.view(np.uint8).reshape(count, 8)[:, :size]
    rows[:, message.length - size :] = stored[:, ::-1] if layout.stored_big else stored
    return rows


def encode_frame(layout: Layout, message: Message, values: Mapping[str, Any]) -> bytes:
    """Return one frame of any message, check included; see FrameDefinition.encode_one."""
    rest = b""
    columns = dict(values)
    if message.rest is not None:
        rest = bytes(_taken(columns, message.rest.name, message))
        del columns[message.rest.name]
    size = layout.check.size
    total = message.body + len(rest) + size
    if total > layout.max_length:
        text = f"the frame would be {total} bytes long, the limit is {layout.max_length}"
        raise InputError("B-FRAME-021", text, where=_WHERE)
    rows = np.zeros((1, message.body), np.uint8)
    rows[0, : len(layout.sync)] = np.frombuffer(layout.sync, np.uint8)
    given = with_automatic(layout, message, columns, total)
    for item in message.fields:
        if not item.rest:
            _put(rows, item, given, 1)
    frame = rows.tobytes() + rest
    stop = len(frame) if message.cover_stop is None else message.cover_stop
    value = layout.check.of(frame[message.cover_start : stop])
    return frame + value.to_bytes(size, "big" if layout.stored_big else "little")


def with_automatic(layout: Layout, message: Message, columns: Mapping[str, Any], total: int) -> dict[str, Any]:
    """Return columns with the fields that follow from the definition: length, type, constants."""
    fields = message.by_name
    given = dict(columns)
    for name in [name for name in columns if name not in fields]:
        base, _, part = name.partition(".")
        if base not in fields or (part and part not in fields[base].bits):
            advice = f"use one of: {', '.join(fields)}"
            raise InputError("B-FRAME-022", f"{message.name!r} has no field {name!r}", where=_WHERE, next_step=advice)
    if layout.length_field is not None:
        given.setdefault(layout.length_field.name, total - layout.length_plus)
    if layout.type_field is not None:
        given.setdefault(layout.type_field.name, message.type_value)
    return given


def _taken(columns: Mapping[str, Any], name: str, message: Message) -> Any:
    if name not in columns:
        text = f"the message {message.name!r} needs a value for {name!r}"
        raise InputError("B-FRAME-020", text, where=_WHERE, next_step="give every field without constant or default")
    return columns[name]


def values_of(item: Field, given: Mapping[str, Any]) -> NDArray[Any] | bytes:
    """Return the values of a field, or its bytes where the definition says them.

    Raises: InputError B-FRAME-020 if there are none, 021 if a bit range does not fit.
    """
    if item.name in given:
        values = np.asarray(given[item.name])
        if item.kind == "b" and values.dtype.kind == "S":
            return np.frombuffer(bytes(given[item.name]), np.uint8)
        return values
    if (fixed := item.constant or item.default) is not None:
        return fixed
    if item.bits and any(f"{item.name}.{part}" in given for part in item.bits):
        return _join_bits(item, given)
    text = f"no value for the field {item.name!r}"
    raise InputError("B-FRAME-020", text, where=_WHERE, next_step="give every field without constant or default")


def _put(rows: NDArray[np.uint8], item: Field, given: Mapping[str, Any], count: int) -> None:
    target = rows[:, item.offset : item.offset + item.length]
    values = values_of(item, given)
    if isinstance(values, bytes):
        target[:] = np.frombuffer(values, np.uint8)
        return
    elements = 1 if item.count is None else item.count
    shaped = values if item.count is not None else values[..., np.newaxis]
    try:
        full = np.broadcast_to(shaped, (count, elements))
    except ValueError:
        text = f"{item.name!r} has the shape {values.shape}, due is {(count, elements)}"
        raise InputError("B-FRAME-020", text, where=_WHERE) from None
    _store(target, _checked(full, values, item), item)


def _join_bits(item: Field, given: Mapping[str, Any]) -> NDArray[Any]:
    """Return a whole field from its named bits; bits that are not given are 0."""
    whole: NDArray[Any] = np.zeros((), item.dtype)
    for part, (low, width) in item.bits.items():
        values = np.asarray(given.get(f"{item.name}.{part}", 0))
        if values.size and (values.min() < 0 or int(values.max()) >= 1 << width):
            raise _out_of_range(f"{item.name}.{part}", values, 0, (1 << width) - 1)
        whole = whole | (values.astype(item.dtype) << np.dtype(item.dtype).type(low))
    return whole


def _checked(full: NDArray[Any], values: NDArray[Any], item: Field) -> NDArray[Any]:
    """Return the values in the memory type of the field; never wrapped, never clipped."""
    if item.kind == "f":
        return full.astype(item.dtype, copy=False)
    bits = 8 * item.size
    low, high = (0, (1 << bits) - 1) if item.kind in "ub" else (-(1 << (bits - 1)), (1 << (bits - 1)) - 1)
    if values.dtype.kind == "f" and values.size and (values != np.rint(values)).any():
        raise InputError("B-FRAME-021", f"{item.name!r} holds numbers that are not whole", where=_WHERE)
    fits = np.can_cast(values.dtype, item.dtype) and np.dtype(item.dtype).itemsize == item.size
    if not fits and values.size and (values.min() < low or values.max() > high):
        raise _out_of_range(item.name, values, low, high)
    return full.astype(item.dtype, copy=False)


def _out_of_range(name: str, values: NDArray[Any], low: int, high: int) -> InputError:
    text = f"{name!r} reaches from {values.min()} to {values.max()}, the limits are {low} and {high}"
    return InputError("B-FRAME-021", text, where=_WHERE)


def _store(target: NDArray[np.uint8], values: NDArray[Any], item: Field) -> None:
    count, elements = values.shape
    width = values.dtype.itemsize
    wire = np.ascontiguousarray(values, values.dtype.newbyteorder(">" if item.big else "<"))
    packed = wire.view(np.uint8).reshape(count, elements, width)
    cut = packed[:, :, width - item.size :] if item.big else packed[:, :, : item.size]
    target[:] = cut.reshape(count, elements * item.size)
