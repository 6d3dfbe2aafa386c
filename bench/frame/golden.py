"""The golden frame of a definition: known bytes that must decode to known values, or the definition is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.frame.compile_fields import read_hex
from bench.frame.layout import Layout, Message
from bench.frame.reference import ReferenceDecoder
from bench.frame.schema import FrameSpec
from bench.model.errors import InputError, InputErrors
from bench.model.yamlio import Document, Path_

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
            errors.append(InputError("B-FRAME-011", text, where=document.where(path), next_step=_NEXT))
            continue
        problem = _refused(layout, message, part.golden)
        if problem:
            where = document.where((*path, "golden"))
            errors.append(InputError("B-FRAME-011", problem, where=where, next_step=_NEXT))
            continue
        errors += _compare(document, layout, message, part.golden, part.expect, (*path, "expect"))
    if errors:
        raise InputErrors(errors)


def _refused(layout: Layout, message: Message, text: str) -> str:
    """Return why the golden frame is no frame of this message; empty if it is one."""
    frame = read_hex(text)
    if frame is None:
        return "the golden frame is no hex text"
    if not frame.startswith(layout.pattern):
        return f"the golden frame begins with {frame[: len(layout.pattern)].hex(' ')}, not {layout.pattern.hex(' ')}"
    size = layout.check.size
    if message.length not in (0, len(frame)) or len(frame) < message.body + size:
        due = message.length or f"at least {message.body + size}"
        return f"the golden frame of {message.name!r} has {len(frame)} bytes, due are {due}"
    if len(ReferenceDecoder(layout).feed(frame).messages[message.name]) == 1:
        return ""
    stop = len(frame) - size if message.cover_stop is None else message.cover_stop
    computed = layout.check.of(frame[message.cover_start : stop])
    stored = int.from_bytes(frame[-size:], "big" if layout.stored_big else "little")
    if computed == stored:
        return f"the length or type inside the golden frame is not that of {message.name!r}"
    digits = 2 * size
    return (
        f"the golden frame fails its check: {layout.check.name} over bytes {message.cover_start} to {stop - 1} is "
        f"0x{computed:0{digits}x}, stored is 0x{stored:0{digits}x}"
    )


def _compare(document: Document[FrameSpec], layout: Layout, message: Message, golden: str, expect: Mapping[str, Any],
             path: Path_) -> list[InputError]:  # fmt: skip
    batch = ReferenceDecoder(layout).feed(bytes.fromhex(golden)).messages[message.name]
    errors: list[InputError] = []
    if batch.suspect.any():
        text = f"a constant of {message.name!r} differs in the golden frame"
        errors.append(InputError("B-FRAME-012", text, where=document.where(path), next_step=_NEXT))
    for name, due in expect.items():
        where = document.where((*path, name))
        try:
            raw = batch.raw(name)[0]
            physical = batch.scaled(name)[0] if batch.has_scale(name) else None
        except InputError as error:
            errors.append(InputError("B-FRAME-013", error.message, where=where, next_step=error.next_step))
            continue
        if not _equal(raw, physical, due):
            text = f"{name} of the golden frame is {_printed(raw, physical)}, expected is {due}"
            errors.append(InputError("B-FRAME-012", text, where=where, next_step=_NEXT))
    return errors


def _equal(raw: Any, physical: Any, due: Any) -> bool:
    """Plain integers exactly, other numbers within their print rounding, bytes by hex text."""
    if isinstance(due, str):
        wanted = read_hex(due)
        return wanted is not None and bytes(raw) == wanted
    values = np.asarray(raw if physical is None else physical).tolist()
    if not isinstance(due, list) or not isinstance(values, list):
        return _same(values, due)
    return len(values) == len(due) and all(map(_same, values, due))


def _same(value: Any, due: Any) -> bool:
    if isinstance(due, bool) or not isinstance(due, int | float) or isinstance(value, bytes | list):
        return False
    return bool(value == due) if isinstance(value, int) else math.isclose(value, due, rel_tol=1e-6, abs_tol=1e-12)


def _printed(raw: Any, physical: Any) -> str:
    if isinstance(raw, bytes):
        return raw.hex(" ")
    return str(np.asarray(raw if physical is None else physical).tolist())
