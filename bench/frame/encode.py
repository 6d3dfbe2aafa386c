"""Numbers to frames: vectorised for messages of fixed length, one at a time for all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.frame.batch import seal, store_column
from bench.frame.layout import Field, Layout, Message, Span
from bench.frame.packets import ESCAPES
from bench.frame.parts import packed
from bench.model.arrays import Array, Octets
from bench.model.errors import InputError


def _wrong(code: str, text: str, next_step: str = "") -> InputError:
    return InputError(code, text, where="frame encoder", next_step=next_step)


def _missing(item: Field) -> InputError:
    advice = "give every field without constant or default"
    return _wrong("B-FRAME-020", f"no value for the field {item.name!r}", advice)


def encode_rows(layout: Layout, message: Message, columns: Mapping[str, Any], count: int) -> Octets:
    """Return frames (count, length) uint8, check included; see FrameDefinition.encode."""
    if message.length == 0 or layout.escape:
        text = f"the message {message.name!r} has no fixed length"
        raise _wrong("B-FRAME-020", text, "encode it one by one with encode_one")
    return _sealed(layout, message, columns, _filled(layout, message, columns, count, message.length))


def encode_frame(layout: Layout, message: Message, values: Mapping[str, Any]) -> bytes:
    """Return one frame of any message but a line, check included; see FrameDefinition.encode_one."""
    if layout.lines:
        raise _wrong("B-FRAME-020", "lines are read, and not written")
    rest, columns = b"", dict(values)
    if message.rest is not None:
        if message.rest.name not in columns:
            raise _missing(message.rest)
        rest = bytes(columns.pop(message.rest.name))
    columns = with_counts(message, columns) if message.parts else columns
    row = _filled(layout, message, columns, 1, message.body).tobytes()
    wire = packed(message, row, rest) if message.parts else row + rest
    total = len(wire) + layout.tail
    if total > layout.max_length:
        text = f"the frame would be {total} bytes long, the limit is {layout.max_length}"
        raise _wrong("B-FRAME-021", text)
    rows = np.frombuffer(wire + bytes(layout.tail), np.uint8).reshape(1, total).copy()
    rows = _sealed(layout, message, columns, rows)
    return ESCAPES[layout.escape].packed(rows.tobytes()) if layout.escape else rows.tobytes()


def _sealed(layout: Layout, message: Message, columns: Mapping[str, Any], rows: Octets) -> Octets:
    """Return frames with their length, check and trailer, which depend on the rest."""
    if layout.length_field is not None:
        _put(rows, layout.length_field, with_automatic(layout, message, columns, rows.shape[1]), len(rows))
    seal(layout, message, rows)
    return rows


def _filled(layout: Layout, message: Message, columns: Mapping[str, Any], count: int, width: int) -> Octets:
    """Return rows (count, width) with sync bytes and fields; the length is left out."""
    rows = np.zeros((count, width), np.uint8)
    rows[:, layout.sync_at : layout.sync_at + len(layout.sync)] = np.frombuffer(layout.sync, np.uint8)
    given = with_automatic(layout, message, columns, layout.length_plus)
    for item in message.fields:
        if not item.rest and item is not layout.length_field:
            _put(rows, item, given, count)
    return rows


def with_counts(message: Message, columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return columns with the counts and flags that follow from what is given, and zeros for what is not there.

    The values of a group are as many as it has sets.
    """
    given = dict(columns)
    parts = [item for item in message.fields if item.given]
    for item in parts:
        values = np.ravel(given.get(item.name, ()))
        if item.name in given and item.given.partition(".")[0] not in columns:
            given.setdefault(item.given, len(values) if item.step else 1)
        if item.name in given and item.step:
            given[item.name] = np.pad(values, (0, max((item.count or 1) - len(values), 0)))
    required = {item.name: int(item.required) for part in message.parts for item in part.items}
    given = required | given
    for item in parts:
        base, _, bits = item.given.partition(".")
        if base not in given:
            given.setdefault(item.given, 0)
        low, width = message.by_name[base].bits.get(bits, (0, message.by_name[base].width))
        number = given[item.given] if item.given in given else int(given[base]) >> low & (1 << width) - 1
        if item.name not in given and not np.any(number):
            given[item.name] = np.zeros(item.count) if item.count is not None else 0
        stated = int(number) if item.step else int(bool(number))
        number_given = len(np.ravel(columns.get(item.name, ()))) if item.step else 1
        if item.name in columns and stated != number_given and not (item.step and stated > (item.count or 1)):
            text = f"{number_given} values are given for {item.name!r}, {item.given!r} says {stated}"
            raise _wrong("B-FRAME-020", text, "give as many values for all fields of it")
    return given


def with_automatic(layout: Layout, message: Message, columns: Mapping[str, Any], total: int) -> dict[str, Any]:
    """Return columns with the fields that follow from the definition: length, type, a place for the check.

    Raises: InputError B-FRAME-021 if no value of the length field says the length, 022 for an unknown field.
    """
    fields = message.by_name
    given = dict(columns)
    for name in [name for name in columns if name not in fields]:
        base, dot, part = name.partition(".")
        if base not in fields or (dot and part not in fields[base].bits):
            advice = f"use one of: {', '.join(fields)}"
            raise _wrong("B-FRAME-022", f"{message.name!r} has no field {name!r}", advice)
    if layout.length_field is not None:
        stated, left = divmod(total - layout.length_plus, layout.length_times)
        if left:
            text = f"{total} bytes are no length of a frame: their number less {layout.length_plus} must be a multiple"
            raise _wrong("B-FRAME-021", f"{text} of {layout.length_times}")
        _state(given, layout.length_field, layout.length_bits, stated)
    if layout.type_field is not None:
        _state(given, layout.type_field, layout.type_bits, message.type_value)
    if layout.check_field is not None:
        given[layout.check_field.name] = 0
    return given


def _state(given: dict[str, Any], item: Field, bits: Span | None, value: int | None) -> None:
    """Give a field, or the bits of it that say this, a value where the caller gives none."""
    if item.name not in given:
        part = next((name for name, span in item.bits.items() if span == bits), "")
        given.setdefault(f"{item.name}.{part}" if part else item.name, value)


def values_of(item: Field, given: Mapping[str, Any]) -> Array | bytes:
    """Return the values of a field, or its bytes where the definition says them.

    Raises: InputError B-FRAME-020 if there are none, 021 if a bit range does not fit.
    """
    if item.name in given:
        values = np.asarray(given[item.name])
        if item.kind == "b" and values.dtype.kind == "S":
            return np.frombuffer(bytes(given[item.name]), np.uint8)
        return values
    if item.bits and any(f"{item.name}.{part}" in given for part in item.bits):
        return _join_bits(item, given)
    if (fixed := item.constant or item.default) is not None:
        return fixed
    raise _missing(item)


def _put(rows: Octets, item: Field, given: Mapping[str, Any], count: int) -> None:
    values = values_of(item, given)
    if isinstance(values, bytes):
        rows[:, item.span] = np.frombuffer(values, np.uint8)
        return
    shaped = values if item.count is not None else values[..., np.newaxis]
    shaped = shaped.reshape((1,) * (2 - shaped.ndim) + shaped.shape)
    if shaped.ndim != 2 or shaped.shape[0] not in (1, count) or shaped.shape[1] not in (1, item.elements):
        text = f"{item.name!r} has the shape {values.shape}, due is {(count, item.elements)}"
        raise _wrong("B-FRAME-020", text)
    _check_values(values, item)
    store_column(rows, item, shaped)


def _join_bits(item: Field, given: Mapping[str, Any]) -> Array:
    """Return a whole field from its named bits; those that are not given are as in its default, or 0."""
    whole: Array = np.array(int.from_bytes(item.default or b"", item.order), item.dtype)
    for part, (low, width) in item.bits.items():
        if f"{item.name}.{part}" not in given:
            continue
        whole = whole & np.dtype(item.dtype).type(~(((1 << width) - 1) << low) & ((1 << 8 * item.size) - 1))
        values = np.asarray(given[f"{item.name}.{part}"])
        if values.size and (values.min() < 0 or int(values.max()) >= 1 << width):
            raise _out_of_range(f"{item.name}.{part}", values, 0, (1 << width) - 1)
        whole = whole | (values.astype(item.dtype) << np.dtype(item.dtype).type(low))
    return whole


def _check_values(values: Array, item: Field) -> None:
    """Refuse values that a field would wrap or clip."""
    if item.kind == "f":
        return
    low, high = item.bounds
    if values.dtype.kind == "f" and values.size and (values != np.rint(values)).any():
        raise _wrong("B-FRAME-021", f"{item.name!r} holds numbers that are not whole")
    fits = np.can_cast(values.dtype, item.dtype) and 8 * np.dtype(item.dtype).itemsize == item.width
    if not fits and values.size and (values.min() < low or values.max() > high):
        raise _out_of_range(item.name, values, low, high)


def _out_of_range(name: str, values: Array, low: int, high: int) -> InputError:
    text = f"{name!r} reaches from {values.min()} to {values.max()}, the limits are {low} and {high}"
    return _wrong("B-FRAME-021", text)
