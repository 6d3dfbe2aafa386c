"""A frame definition ready for use: load it, prove it by its golden frames, decode and encode with it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bench.frame.batch import Arrivals, Extract, FrameBatch, FrameCounts, extract_column
from bench.frame.best import Engine, Kernel, best_engine, kernel, why_no_kernel
from bench.frame.commands import CommandLayout, canonical_commands
from bench.frame.compiling.fields import read_hex
from bench.frame.compiling.whole import compile_frame
from bench.frame.crc import require_fast_crc
from bench.frame.encode import encode_frame, encode_rows
from bench.frame.escape import ESCAPES
from bench.frame.explain import checks_that_fit
from bench.frame.kernel.arrays import Arrays, arrays_of, what_is_not_held
from bench.frame.kernel_encoder import KernelEncoder
from bench.frame.kernel_engine import KernelDecoder
from bench.frame.layout import Layout, Message
from bench.frame.lines import LineDecoder, LineReader
from bench.frame.numpy_engine import NumpyDecoder
from bench.frame.packets import escaped_decoder
from bench.frame.parts import unpacked
from bench.frame.reference import ReferenceDecoder, checks_of, read_column
from bench.frame.spec import FrameSpec, LinesSpec
from bench.model.errors import InputError, InputErrors
from bench.model.yamlio import Document, Path_, load_yaml, parse_yaml

_NEXT = "correct the definition or the golden frame; take the frame from the device or its manual"


class Decoder(Protocol):
    """The face of all engines; they give the same results on any input and any chunking."""

    counts: FrameCounts

    def feed(self, chunk: bytes) -> FrameBatch:
        """Decode what can be decided; the undecided tail waits for the next feed."""

    def give_up(self, before: int) -> FrameBatch:
        """Reject what was begun before the stream offset ``before`` and is not whole yet; the search goes on behind."""

    def finish(self) -> FrameBatch:
        """End of the stream: decide the tail."""


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
        self.golden = [_wire(self.layout, text or "") or b"" for text in texts]
        self.rate_Hz = self.layout.rate_Hz
        self.messages = tuple(message.name for message in self.layout.messages)
        meaning = self.layout.canonical()
        if self.commands:
            meaning["commands"] = canonical_commands(list(self.commands.values()))
        content = json.dumps(meaning, sort_keys=True, separators=(",", ":"))
        self._encoders: dict[str, KernelEncoder] = {}
        self.sha256 = hashlib.sha256(content.encode()).hexdigest()

    def message(self, name: str = "frame") -> Message:
        """Return the layout of one message. Raises: InputError B-FRAME-023 for an unknown name."""
        for message in self.layout.messages:
            if message.name == name:
                return message
        advice = f"use one of: {', '.join(self.messages)}"
        raise InputError("B-FRAME-023", f"{self.name} has no message {name!r}", where=self.name, next_step=advice)

    def command_of(self, code: int) -> CommandLayout | None:
        """The command with that code, None if there is none."""
        return next((command for command in self.commands.values() if command.code == code), None)

    @property
    def why_no_kernel(self) -> str:
        """Why the frames are not decoded by the compiled kernel, "" if they are."""
        unknown = what_is_not_held(self.layout)
        if not unknown:
            return why_no_kernel()
        instead = "one by one" if self._one_by_one else "by numpy"
        return f"{self.name}: the compiled kernel does not know {unknown}: frames are decoded {instead}"

    @property
    def _one_by_one(self) -> bool:
        return not self.layout.pattern or bool(self.layout.escape) or self.layout.lines is not None

    def _kernel(self) -> Kernel | None:
        return None if what_is_not_held(self.layout) else kernel()

    @cached_property
    def _arrays(self) -> Arrays:
        return arrays_of(self.layout)

    def decoder(self, engine: Engine | None = None, arrivals: Arrivals | None = None) -> Decoder:
        """Return a fresh decoder at the start of a stream.

        Args: engine: default: the best one there is; numpy instead of the kernel where there is no kernel.
              arrivals: of the chunks that are fed; the kernel then stamps and counts the frames too.
        """
        engine = engine or best_engine()
        compiled = self._kernel() if engine == "kernel" else None
        if compiled is not None:
            return KernelDecoder(self.layout, self._arrays, compiled.decode, arrivals)
        if engine == "reference":
            return _one_by_one(self.layout)
        return _one_by_one(self.layout, extract_column) if self._one_by_one else NumpyDecoder(self.layout)

    def encode(self, columns: Mapping[str, Any], n: int, message: str = "frame") -> NDArray[np.uint8]:
        """Return frames of a message of fixed length, check included.

        Args:
            columns: raw values by field, (n,) or (n, count), or one value for all; named bits as "field.bits".
                Length, type, constants, defaults and check are filled in.
            n: number of frames.
        Returns: (n, length) uint8.
        Raises: InputError B-FRAME-020 (missing, wrong shape), 021 (does not fit), 022 (unknown), 023 (no message).
        """
        encoder = self._encoder(message)
        rows = None if encoder is None or not n else encoder.rows(columns, n)
        return encode_rows(self.layout, self.message(message), columns, n) if rows is None else rows

    def _encoder(self, message: str) -> KernelEncoder | None:
        """Return the compiled encoder of a message, None if there is none or its frames have no fixed length."""
        encoder = self._encoders.get(message)
        compiled = self._kernel() if encoder is None else None
        if compiled is not None and self.message(message).length:
            encoder = KernelEncoder(self.layout, self.message(message), self._arrays, compiled.encode)
            self._encoders[message] = encoder
        return encoder

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


def _unescaped(layout: Layout, wire: bytes) -> bytes | None:
    """Return the one frame of an escaped golden frame, None if there is another number of packets."""
    pieces, at = [], 0
    while (packet := ESCAPES[layout.escape].next_packet(wire, at, len(wire) + 1)) is not None:
        at = packet.end
        pieces += [packet.frame] if packet.frame != b"" else []
    return pieces[0] if len(pieces) == 1 and at == len(wire) else None


def _one_by_one(layout: Layout, extract: Extract = read_column) -> ReferenceDecoder:
    if layout.lines:
        return LineDecoder(layout, layout.lines, extract)
    return escaped_decoder(layout, extract) if layout.escape else ReferenceDecoder(layout, extract)


def _wire(layout: Layout, golden: str) -> bytes | None:
    """Return a golden frame as it stands on the wire, None if it is no hex text; of lines, it is a line."""
    return golden.strip().encode("ascii", "replace") + b"\r\n" if layout.lines else read_hex(golden)


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
    wire = _wire(layout, text)
    frame = wire
    if wire is not None and layout.lines:
        return _why_no_line(layout, layout.lines, message, wire)
    if wire is not None and layout.escape:
        frame = _unescaped(layout, wire)
    if wire is None or frame is None:
        return "the golden frame is no hex text" if wire is None else f"the golden frame is no {layout.escape} packet"
    if not frame.startswith(layout.pattern, layout.sync_at):
        there = frame[layout.sync_at : layout.sync_at + len(layout.pattern)].hex(" ")
        at = f" at byte {layout.sync_at}" if layout.sync_at else ""
        return f"the golden frame begins{at} with {there}, not {layout.pattern.hex(' ')}"
    if message.length not in (0, len(frame)) or len(frame) < message.least + layout.tail:
        due = message.length or f"at least {message.least + layout.tail}"
        return f"the golden frame of {message.name!r} has {len(frame)} bytes, due are {due}"
    if len(_one_by_one(layout).feed(wire).messages[message.name]) == 1:
        return ""
    return _why_refused(layout, message, frame)


def _why_no_line(layout: Layout, lines: LinesSpec, message: Message, wire: bytes) -> str:
    """Return why a golden line is no line of this message; empty if it is one."""
    if not wire.startswith(layout.sync):
        return f"the golden line does not begin with {layout.sync.decode('ascii', 'replace')!r}"
    if len(wire) > lines.max:
        return f"the golden line has {len(wire)} bytes with its end, 'lines: max' is {lines.max}"
    read = LineReader(layout, lines).read(wire[len(layout.sync) : -2])
    if isinstance(read, str):
        return f"the golden line {read}"
    if len(_one_by_one(layout).feed(wire).messages[message.name]) == 1:
        return ""
    return f"the golden line is no single line of {message.name!r}"


def _why_refused(layout: Layout, message: Message, frame: bytes) -> str:
    """Return why a frame of the right length with the right sync bytes is refused."""
    right, computed, stored = checks_of(layout, message, frame)
    if right and not frame.endswith(layout.trailer):
        return f"the golden frame does not end with {layout.trailer.hex(' ')}"
    if right and len(frame) > layout.max_length:
        return f"the golden frame has {len(frame)} bytes, 'length: max' is {layout.max_length}"
    contents = unpacked(message, frame, len(frame) - layout.tail) if right and message.parts else ""
    if isinstance(contents, str) and contents:
        return f"the golden frame {contents}"
    if right:
        return f"the length or type inside the golden frame is not that of {message.name!r}"
    stop = len(frame) - layout.tail if message.cover_stop is None else message.cover_stop
    digits = 2 * layout.check.size
    return (
        f"the golden frame fails its check: {layout.check.name} over bytes {message.cover_start} to {stop - 1} is "
        f"0x{computed:0{digits}x}, stored is 0x{stored:0{digits}x}{_what_fits(frame)}"
    )


def _what_fits(frame: bytes) -> str:
    """Return which other check is right in a frame, as the end of a sentence."""
    fit = next(checks_that_fit([frame], least_bits=16), None)
    if fit is None:
        return ""
    stop = len(frame) - fit.trailer - (fit.size if fit.at is None else 0)
    place = f"with {fit.trailer} bytes behind it" if fit.at is None else f"at byte {fit.at}"
    order = "" if fit.size == 1 else f", stored {'big' if fit.big else 'little'}"
    chance = " (perhaps by chance)" if fit.size < 3 else ""
    return f"; {fit.name} over bytes {fit.start} to {stop - 1}, {place}{order}, would be right{chance}"


def _compare(document: Document[FrameSpec], layout: Layout, message: Message, golden: str, expect: Mapping[str, Any],
             path: Path_) -> list[InputError]:  # fmt: skip
    batch = _one_by_one(layout).feed(_wire(layout, golden) or b"").messages[message.name]
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
        missing = batch.missing(name)
        if missing is not None and message.by_name[name.partition(".")[0]].step:
            raw, physical = raw[~missing[0]], None if physical is None else physical[~missing[0]]
        elif missing is not None and missing.any():
            text = f"the golden frame does not hold {name}, expected is {due}"
            errors.append(InputError("B-FRAME-012", text, where=where, next_step=_NEXT))
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
