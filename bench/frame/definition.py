"""A frame definition ready for use: load it, prove it by its golden frames, decode and encode with it, time that.

The golden frames of a definition: each must be a frame of its message and decode to the values expected. Numbers
become frames vectorised for messages of fixed length, and one at a time for all.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from math import floor, log10
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bench.frame.batch import Decoder, MessageBatch, seal, store_column
from bench.frame.commands import CommandLayout, canonical_commands
from bench.frame.compiling.fields import read_hex
from bench.frame.compiling.whole import compile_frame
from bench.frame.crc import require_fast_crc
from bench.frame.explain import checks_that_fit
from bench.frame.layout import Field, Layout, Message, Span
from bench.frame.numpy_engine import NumpyDecoder
from bench.frame.packets import ESCAPES, one_by_one, why_bad
from bench.frame.parts import packed, why_refused
from bench.frame.spec import FrameSpec
from bench.model.arrays import Array, Octets
from bench.model.clock import NS, Clock
from bench.model.errors import InputError, InputErrors
from bench.model.yamlio import Document, Path_, load_yaml, parse_yaml


def _not_encoded(code: str, text: str, next_step: str = "") -> InputError:
    return InputError(code, text, where="frame encoder", next_step=next_step)


def _missing(item: Field) -> InputError:
    advice = "give every field without constant or default"
    return _not_encoded("B-FRAME-020", f"no value for the field {item.name!r}", advice)


def encode_rows(layout: Layout, message: Message, columns: Mapping[str, Any], count: int) -> Octets:
    """Return frames (count, length) uint8, check included; see FrameDefinition.encode."""
    if message.length == 0 or layout.escape:
        text = f"the message {message.name!r} has no fixed length"
        raise _not_encoded("B-FRAME-020", text, "encode it one by one with encode_one")
    return _sealed(layout, message, columns, _filled(layout, message, columns, count, message.length))


def encode_frame(layout: Layout, message: Message, values: Mapping[str, Any]) -> bytes:
    """Return one frame of any message but a line, check included; see FrameDefinition.encode_one."""
    if layout.lines:
        raise _not_encoded("B-FRAME-020", "lines are read, and not written")
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
        raise _not_encoded("B-FRAME-021", text)
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
            raise _not_encoded("B-FRAME-020", text, "give as many values for all fields of it")
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
            raise _not_encoded("B-FRAME-022", f"{message.name!r} has no field {name!r}", advice)
    if layout.length_field is not None:
        stated, left = divmod(total - layout.length_plus, layout.length_times)
        if left:
            text = f"{total} bytes are no length of a frame: their number less {layout.length_plus} must be a multiple"
            raise _not_encoded("B-FRAME-021", f"{text} of {layout.length_times}")
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
        raise _not_encoded("B-FRAME-020", text)
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
        raise _not_encoded("B-FRAME-021", f"{item.name!r} holds numbers that are not whole")
    fits = np.can_cast(values.dtype, item.dtype) and 8 * np.dtype(item.dtype).itemsize == item.width
    if not fits and values.size and (values.min() < low or values.max() > high):
        raise _out_of_range(item.name, values, low, high)


def _out_of_range(name: str, values: Array, low: int, high: int) -> InputError:
    text = f"{name!r} reaches from {values.min()} to {values.max()}, the limits are {low} and {high}"
    return _not_encoded("B-FRAME-021", text)


_DIGITS = {8: 1e-8}  # relative, of floats of that many bytes: they are written with fewer digits than they have
_MILLIONTH = 1e-6
_ROUNDING = 1e-12
_TRIED_BYTES = 8192  # longest frame on which every check is tried
_NEXT = "correct the definition or the golden frame; take the frame from the device or its manual"


def check_golden(document: Document[FrameSpec], layout: Layout) -> None:
    """Decode every golden frame and compare it with its expected values.

    Raises: InputErrors with B-FRAME-011 (no frame), 012 (other values), 013 (no such field).
    """
    errors: list[InputError] = []
    spec = document.model
    for message in layout.messages:
        part = spec if spec.messages is None else spec.messages[message.name]
        path: Path_ = () if spec.messages is None else ("messages", message.name)
        if part.golden is None or part.expect is None:
            text = "the definition has no golden frame with expected values"
            errors.append(_wrong("B-FRAME-011", text, document, path))
            continue
        batch = one_by_one(layout).feed(wire_of(layout, part.golden) or b"").messages[message.name]
        problem = _refused(layout, message, part.golden, len(batch))
        if problem:
            errors.append(_wrong("B-FRAME-011", problem, document, (*path, "golden")))
            continue
        errors += _compare(document, message, batch, part.expect, (*path, "expect"))
    if errors:
        raise InputErrors(errors)


def _wrong(code: str, text: str, document: Document[FrameSpec], path: Path_) -> InputError:
    return InputError(code, text, where=document.where(path), next_step=_NEXT)


def wire_of(layout: Layout, golden: str) -> bytes | None:
    """Return a golden frame as it stands on the wire, None if it is no hex text; of lines, it is a line."""
    return golden.strip("\r\n").encode("ascii", "replace") + b"\r\n" if layout.lines else read_hex(golden)


def _refused(layout: Layout, message: Message, text: str, found: int) -> str:
    """Return why the golden frame is no frame of this message, ``found`` times; empty if it is one."""
    wire, kind = wire_of(layout, text), "line" if layout.lines else "frame"
    if not wire:
        return f"the golden frame {_why_no_hex(text)}"
    if not layout.escape and not wire.startswith(layout.pattern, layout.sync_at):
        at = f" at byte {layout.sync_at}" if layout.sync_at else ""
        begin = wire[layout.sync_at : layout.sync_at + len(layout.pattern)]
        there, due = (repr(part)[1:] if layout.lines else part.hex(" ") for part in (begin, layout.pattern))
        return f"the golden {kind} begins{at} with {there}, not {due}"
    if layout.escape or layout.lines:
        refusal = why_bad(layout)[0](wire.removeprefix(ESCAPES[layout.escape].end) if layout.escape else wire)
    else:
        refusal = why_refused(layout, wire, message, exact=True)
    if refusal is not None:
        return (
            f"the golden {kind} {refusal.text}{_check_that_is_right(layout, wire) if refusal.cause == 'check' else ''}"
        )
    if found == 1:
        return ""
    return f"the golden {kind} is no single {layout.escape or kind} of {message.name!r}"


def _why_no_hex(text: str) -> str:
    wrong = re.search(r"[^0-9a-fA-F\s]", text)
    found = f"{wrong[0]!r} at character {wrong.start() + 1}" if wrong else "half a byte, or nothing"
    return f"is no hex text: there is {found}"


def _check_that_is_right(layout: Layout, frame: bytes) -> str:
    """Return which other check is right in a frame, as the end of a sentence; rather the one that was named."""
    plain = len(frame) <= _TRIED_BYTES and not layout.escape and not layout.lines
    fits = list(checks_that_fit([frame], least_bits=16)) if plain else []
    fit = next((fit for fit in fits if fit.name == layout.check.name), fits[0] if fits else None)
    if fit is None:
        return ""
    stop = len(frame) - fit.trailer - (fit.size if fit.at is None else 0)
    place = f"with {fit.trailer} bytes behind it" if fit.at is None else f"at byte {fit.at}"
    order = "" if fit.size == 1 else f", stored {'big' if fit.big else 'little'}"
    chance = " (perhaps by chance)" if fit.size < 3 else ""
    return f"; {fit.name} over bytes {fit.start} to {stop - 1}, {place}{order}, would be right{chance}"


def _compare(document: Document[FrameSpec], message: Message, batch: MessageBatch, expect: Mapping[str, Any],
             path: Path_) -> list[InputError]:  # fmt: skip
    errors: list[InputError] = []
    if batch.suspect.any():
        text = f"a constant of {message.name!r} differs in the golden frame"
        errors.append(_wrong("B-FRAME-012", text, document, path))
    for name, due in expect.items():
        try:
            raw = batch.raw(name)[0]
            physical = batch.scaled(name)[0] if batch.has_scale(name) else None
        except InputError as error:
            where = document.where((*path, name))
            errors.append(InputError("B-FRAME-013", error.message, where=where, next_step=error.next_step))
            continue
        item, part = message.by_name[name.partition(".")[0]], "." in name
        missing = batch.missing(name)
        if missing is not None and item.step:
            raw, physical = raw[~missing[0]], None if physical is None else physical[~missing[0]]
        elif missing is not None and missing.any():
            text = f"the golden frame does not hold {name}, expected is {due}"
            errors.append(_wrong("B-FRAME-012", text, document, (*path, name)))
            continue
        if not _equal(raw, physical, due, item, part):
            text = f"{name} of the golden frame is {_printed(raw, physical, item)}, expected is {due}"
            errors.append(_wrong("B-FRAME-012", text, document, (*path, name)))
    return errors


def _equal(raw: Any, physical: Any, due: Any, item: Field, part: bool) -> bool:
    """Compare whole numbers exactly, scaled ones to half a step and a millionth, floats to 6 or 8 digits.

    Bytes are given in hex, text as it is.
    """
    if item.is_text:
        return isinstance(due, str) and bytes(raw).rstrip(b"\0") == due.encode("ascii", "replace").rstrip(b"\0")
    if item.kind == "b":
        return isinstance(due, str) and bytes(raw) == read_hex(due)
    values = np.asarray(raw if physical is None else physical).tolist()
    step = math.inf if item.kind == "f" else 1.0 if part else abs(item.scale)
    relative = _DIGITS.get(item.size, _MILLIONTH) if item.kind == "f" else _MILLIONTH
    same = partial(_same, step=step, relative=relative)
    if not isinstance(due, list) or not isinstance(values, list):
        return same(values, due)
    return len(values) == len(due) and all(map(same, values, due))


def _same(value: Any, due: Any, step: float, relative: float) -> bool:
    if isinstance(due, bool) or not isinstance(due, int | float) or isinstance(value, bytes | list):
        return False
    if isinstance(value, int):
        return bool(value == due)
    return bool(abs(value - due) <= max(min(step / 2, relative * abs(due)), _ROUNDING))


def _printed(raw: Any, physical: Any, item: Field) -> str:
    if item.is_text:
        return repr(bytes(raw).rstrip(b"\0").decode("ascii", "backslashreplace"))
    if item.kind == "b":
        return bytes(raw).hex(" ")
    return str(np.asarray(raw if physical is None else physical).tolist())


Engine = Literal["numpy", "reference"]
_STREAM_BYTES = 1 << 16


class FrameDefinition:
    """A compiled frame file.

    Attributes: name; text (the YAML); sha256 of the canonical compiled definition (two texts that mean the same have
    the same hash); rate_Hz (None if the file states none); messages (names; "frame" where there is only one kind);
    commands (layouts of their payloads by name, empty if the file states none); golden (a frame of each message).
    """

    def __init__(self, document: Document[FrameSpec]) -> None:
        require_fast_crc()
        self.name = document.model.frame
        self.title = document.model.title or self.name
        self.text = document.text
        compiled: tuple[Layout, Mapping[str, CommandLayout]] = compile_frame(document)
        self.layout, self.commands = compiled
        check_golden(document, self.layout)
        spec = document.model
        texts = [spec.golden] if spec.messages is None else [part.golden for part in spec.messages.values()]
        self.golden = [wire_of(self.layout, text or "") or b"" for text in texts]
        self.rate_Hz = self.layout.rate_Hz
        self.messages = tuple(message.name for message in self.layout.messages)
        meaning = self.layout.canonical()
        if self.commands:
            meaning["commands"] = canonical_commands(list(self.commands.values()))
        content = json.dumps(meaning, sort_keys=True, separators=(",", ":"))
        self.sha256 = hashlib.sha256(content.encode()).hexdigest()

    def message(self, name: str = "frame") -> Message:
        """Return the layout of one message. Raises: InputError B-FRAME-023 for an unknown name."""
        for message in self.layout.messages:
            if message.name == name:
                return message
        advice = f"use one of: {', '.join(self.messages)}"
        raise InputError("B-FRAME-023", f"{self.name} has no message {name!r}", where=self.name, next_step=advice)

    def decoder(self, engine: Engine = "numpy") -> Decoder:
        """Return a fresh decoder at the start of a stream."""
        by_packets = not self.layout.pattern or self.layout.escape or self.layout.lines or engine == "reference"
        return one_by_one(self.layout) if by_packets else NumpyDecoder(self.layout)

    def encode(self, columns: Mapping[str, Any], n: int, message: str = "frame") -> Octets:
        """Return frames of a message of fixed length, check included.

        Args:
            columns: raw values by field, (n,) or (n, count), or one value for all; named bits as "field.bits".
                Length, type, constants, defaults and check are filled in.
            n: number of frames.
        Returns: (n, length) uint8.
        Raises: InputError B-FRAME-020 (missing, wrong shape), 021 (does not fit), 022 (unknown), 023 (no message).
        """
        return encode_rows(self.layout, self.message(message), columns, n)

    def encode_one(self, values: Mapping[str, Any], message: str = "frame") -> bytes:
        """One frame of any message, variable length included (its last field takes bytes); else like ``encode``."""
        return encode_frame(self.layout, self.message(message), values)


def load_frame(path: Path) -> FrameDefinition:
    """Read, check and compile a frame file. Raises: InputErrors with every mistake and its file:line:column."""
    return FrameDefinition(load_yaml(path, FrameSpec))


@lru_cache(maxsize=16)
def parse_frame(text: str, name: str) -> FrameDefinition:
    """Like ``load_frame`` for a text; ``name`` stands for the file in messages. The same text is compiled once."""
    return FrameDefinition(parse_yaml(text, name, FrameSpec))


@dataclass(frozen=True)
class Pace:
    """The engine, frames per second of it, and the rate of the frames (None if the definition states none)."""

    frame: str
    engine: Engine
    frames_per_s: float
    rate_Hz: float | None
    checked: bool

    def __str__(self) -> str:
        engine = {"numpy": "by numpy", "reference": "one by one"}[self.engine]
        if self.rate_Hz is None:
            fast = f"more than {_power(self.frames_per_s)} frames/s"
        elif self.frames_per_s < self.rate_Hz:
            fast = f"only {self.frames_per_s:.3g} frames/s, too slow for its {self.rate_Hz:g} Hz"
        else:
            fast = f"more than {_power(self.frames_per_s / self.rate_Hz)} times its {self.rate_Hz:g} Hz"
        return f"{self.frame} {engine}, {fast}{'' if self.checked else '; no check: a damaged frame counts as good'}"


def pace_of(definition: FrameDefinition, clock: Clock) -> Pace:
    """Decode the golden frames of a definition for some milliseconds."""
    frames = definition.golden * max(1, _STREAM_BYTES // sum(map(len, definition.golden)))
    stream = b"".join(frames)
    definition.decoder().feed(stream)  # tables are made at the first call
    decoder = definition.decoder()
    begin = clock.now_ns()
    decoder.feed(stream)
    frames_per_s = len(frames) * NS / max(1, clock.now_ns() - begin)
    engine: Engine = "numpy" if isinstance(decoder, NumpyDecoder) else "reference"
    return Pace(definition.name, engine, frames_per_s, definition.rate_Hz, definition.layout.check.size > 0)


def _power(value: float) -> str:
    """Return the power of ten below a value: more digits would be those of the moment."""
    return f"{10 ** max(0, floor(log10(value))):,}"
