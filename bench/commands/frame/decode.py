"""``bench decode``: any raw capture through a frame definition."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import BinaryIO

from bench.commands.console import console, named_file, print_json, say
from bench.frame import Counted, FrameDefinition, MessageBatch, Tables, decode_capture, load_frame, pace_of
from bench.model.clock import WallClock
from bench.model.errors import ExitStatus, InputError

COUNTS = ("good", "bad", "lost", "duplicate", "suspect", "other", "skipped_bytes", "bytes")
STANDARD_INPUT = Path("-")


def decode(frame: str, file: Path, csv: Path | None, parquet: Path | None, as_json: bool) -> int:
    """Print the counts of good, bad and lost frames; optionally write the fields as CSV or Parquet.

    Exit status 1 if no frame is good. Raises: InputError B-FRAME-030 (the capture cannot be read), -032, -033.
    """
    definition = load_frame(source := named_file("frames", frame))
    if parquet is not None and parquet.suffix != ".parquet":
        raise InputError("B-FRAME-032", "does not end in .parquet", where=parquet, next_step="name it so")
    with ExitStack() as open_tables:
        tables = [open_tables.enter_context(Tables(definition, path)) for path in (csv, parquet) if path is not None]
        for table in tables:
            for path in table.paths.values():
                if path.resolve() in (source.resolve(), file.resolve()):
                    raise InputError("B-FRAME-032", "is what is read", where=path, next_step="name another file")
        counted = _decoded(definition, file, tables)
    if as_json:
        print_json(counted.summary())
    else:
        _tell(counted, file, tables)
    if counted.counts.frames:
        return ExitStatus.PASS
    sys.stderr.write(f"{_nothing_good(counted)}\n")
    return ExitStatus.VERDICT_FAIL


def _decoded(definition: FrameDefinition, file: Path, tables: list[Tables]) -> Counted:
    def take(messages: Mapping[str, MessageBatch]) -> None:
        for table in tables:
            table.write(messages)

    with opened(file) as stream:
        return decode_capture(definition, stream, take)


@contextmanager
def opened(file: Path) -> Iterator[BinaryIO]:
    """Open a capture. Raises: InputError B-FRAME-030 where it cannot be read."""
    try:
        with nullcontext(sys.stdin.buffer) if file == STANDARD_INPUT else file.open("rb") as stream:
            yield stream
    except OSError as error:
        advice = "give the file of a raw capture, or - for standard input"
        raise InputError("B-FRAME-030", f"cannot be read: {error.strerror}", where=file, next_step=advice) from error


def _tell(counted: Counted, file: Path, tables: list[Tables]) -> None:
    out, summary = console(), counted.summary()
    out.print(f"{'standard input' if file == STANDARD_INPUT else file}: {summary['frame']}")
    for name in COUNTS:
        out.print(f"  {name.replace('_', ' '):<14} {summary[name]}")
    print_bad(counted)
    if counted.counts.jumps:
        out.print(
            f"  jumps of unknown size: {counted.counts.jumps}; the counter goes on elsewhere, by more than it can tell;"
            " what is missing there is not among the lost"
        )
    if counted.cut_off:
        out.print("  cut off in its last frame")
    if not counted.definition.layout.check.size:
        out.print("  these frames have no check: a damaged one counts as good")
    for table in tables:
        for path in table.paths.values():
            out.print(f"  written        {path}")


def print_bad(counted: Counted) -> None:
    """Print why bad frames are bad, by cause with the first one of each, and what mangled the capture."""
    out, told = console(), sum(kind.number for kind in counted.bad)
    for kind in counted.bad:
        out.print(f"  bad: {kind.number} by {kind.cause}; the one at byte {kind.offset} {kind.text}", highlight=False)
    if told < counted.counts.bad:
        out.print(f"  bad: {counted.counts.bad - told} more, not looked at")
    for text in counted.mangled:
        out.print(f"  mangled: {text}", highlight=False)


def _nothing_good(counted: Counted) -> str:
    seen = counted.counts
    if not seen.bytes:
        return "nothing good: the capture is empty"
    if seen.other > seen.bad:
        right = "with a right check " if counted.definition.layout.check.size else ""
        return f"nothing good: {seen.other} frames {right}are of types that the definition does not list"
    if seen.bad:
        return f"nothing good: {seen.bad} places look like the beginning of a frame, and none is one"
    if counted.cut_off:
        return "nothing good: the capture ends inside the first frame that has begun"
    sync = counted.definition.layout.sync.hex(" ")
    begin = f"the sync bytes {sync} begin no" if sync else "there is no"
    return f"nothing good: {begin} frame of a possible length in {seen.bytes} bytes"


def check(frame: str) -> None:
    """Print what a definition describes and how it is decoded. Raises: InputErrors with every mistake in it."""
    definition = load_frame(file := named_file("frames", frame))
    if file.stem != definition.name:
        say(f"warning: {file} calls itself {definition.name}; sequences name it as the file is called")
    messages = ", ".join(definition.messages)
    say(f"{definition.name}: messages {messages}; golden frames are right; sha256 {definition.sha256}")
    say(str(pace_of(definition, WallClock())))
