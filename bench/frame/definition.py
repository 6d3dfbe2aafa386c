"""A frame definition ready for use: load it, prove it by its golden frames, decode and encode with it, time that."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import floor, log10
from pathlib import Path
from typing import Any, Literal

from bench.frame.batch import Decoder
from bench.frame.commands import CommandLayout, canonical_commands
from bench.frame.compiling.whole import compile_frame
from bench.frame.crc import require_fast_crc
from bench.frame.encode import encode_frame, encode_rows
from bench.frame.golden import check_golden, wire_of
from bench.frame.layout import Layout, Message
from bench.frame.numpy_engine import NumpyDecoder
from bench.frame.packets import one_by_one
from bench.frame.spec import FrameSpec
from bench.model.arrays import Octets
from bench.model.clock import NS, Clock
from bench.model.errors import InputError
from bench.model.yamlio import Document, load_yaml, parse_yaml

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
