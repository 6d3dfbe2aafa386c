"""Raw capture files as tables: decode, count, write CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from bench.frame.batch import MessageBatch
from bench.frame.best import Engine
from bench.frame.definition import FrameDefinition
from bench.frame.layout import Field
from bench.frame.stream import LinkBatch, LinkCounts, LinkDecoder
from bench.model.errors import InputError

_BLOCK_BYTES = 4_000_000
_ROWS_AT_ONCE = 20_000


@dataclass(frozen=True)
class FileDecode:
    """A decoded capture: counts, and the frames by message name in file order."""

    definition: FrameDefinition
    counts: LinkCounts
    messages: dict[str, MessageBatch]

    def summary(self) -> dict[str, Any]:
        """JSON-able counts: good, bad, lost, duplicate, suspect, skipped and total bytes, frames by message."""
        seen = asdict(self.counts)
        return {
            "frame": self.definition.name,
            "frame_sha256": self.definition.sha256,
            "good": seen.pop("frames"),
            **seen,
            "messages": {name: len(batch) for name, batch in self.messages.items()},
        }


def decode_file(definition: FrameDefinition, path: Path, engine: Engine | None = None) -> FileDecode:
    """Decode a whole capture file; without receive times a gap longer than a counter wrap looks shorter.

    Raises: InputError B-FRAME-030 if the file cannot be read.
    """
    link = LinkDecoder(definition, engine)
    parts: list[LinkBatch] = []
    try:
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK_BYTES):
                link.push(0, block)
                parts.append(link.flush())
    except OSError as error:
        raise InputError("B-FRAME-030", f"cannot be read: {error.strerror}", where=str(path)) from error
    parts.append(link.finish())
    messages = {name: MessageBatch.join([part.messages[name] for part in parts]) for name in definition.messages}
    return FileDecode(definition, link.counts, messages)


def write_csv(decoded: FileDecode, path: Path) -> list[Path]:
    """Write one CSV per message: byte offset, then every field in its unit, arrays and bit ranges spread.

    A definition with several messages writes ``<stem>.<message><suffix>``. Returns the files written.
    Raises: InputError B-FRAME-032 if a file cannot be written.
    """
    single = len(decoded.messages) == 1
    written = []
    for name, batch in decoded.messages.items():
        target = path if single else path.with_name(f"{path.stem}.{name}{path.suffix}")
        try:
            with target.open("w", newline="", encoding="utf-8") as stream:
                _write(batch, stream)
        except OSError as error:
            raise InputError("B-FRAME-032", f"cannot be written: {error.strerror}", where=str(target)) from error
        written.append(target)
    return written


def _write(batch: MessageBatch, stream: TextIO) -> None:
    writer = csv.writer(stream, lineterminator="\n")
    fields = [item for item in batch.message.fields if item.constant is None]
    writer.writerow(["offset", *(title for item in fields for title in _titles(item))])
    for start in range(0, len(batch), _ROWS_AT_ONCE):
        part = slice(start, start + _ROWS_AT_ONCE)
        columns = [batch.offset[part].tolist()]
        columns += [column for item in fields for column in _texts(batch, item, part)]
        writer.writerows(zip(*columns, strict=True))


def _titles(item: Field) -> Iterator[str]:
    unit = f" [{item.unit}]" if item.unit else ""
    if item.count is None or item.kind == "b":
        yield f"{item.name}{unit}"
    else:
        yield from (f"{item.name}_{index}{unit}" for index in range(1, item.count + 1))
    if item.count is None:
        yield from (f"{item.name}.{part}" for part in item.bits)


def _texts(batch: MessageBatch, item: Field, part: slice) -> Iterator[list[Any]]:
    """Yield the CSV columns of one field; floats in the fewest digits that give the same number back."""
    if item.kind == "b":
        yield [bytes(value).hex() for value in batch.raw(item.name)[part]]
        return
    values = (batch.scaled(item.name) if batch.has_scale(item.name) else batch.raw(item.name))[part]
    texts = values.astype(str) if values.dtype == np.float32 else values
    yield from [texts.tolist()] if item.count is None else texts.T.tolist()
    if item.count is None:
        yield from (batch.raw(f"{item.name}.{name}")[part].tolist() for name in item.bits)
