"""The golden frames of a definition: each must be a frame of its message and decode to the values expected."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from bench.frame.batch import MessageBatch
from bench.frame.compiling.fields import read_hex
from bench.frame.explain import checks_that_fit
from bench.frame.layout import Field, Layout, Message
from bench.frame.packets import ESCAPES, one_by_one, why_bad
from bench.frame.refusal import why_refused
from bench.frame.spec import FrameSpec
from bench.model.errors import InputError, InputErrors
from bench.model.yamlio import Document, Path_

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
