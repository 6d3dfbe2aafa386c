"""Finished records and events of a long run, kept in little memory until its end; their large samples in a file."""

from __future__ import annotations

import pickle
import tempfile
import weakref
import zlib
from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import suppress
from dataclasses import replace
from typing import IO, Any, Generic, TypeVar

from bench.model.arrays import Column
from bench.model.posix import read_at, write_at
from bench.record.samples import Samples
from bench.record.window import RecordRow

Item = TypeVar("Item")

BLOCK = 64
_LEVEL = 6
_DICTIONARY_BYTES = 1 << 15  # as far back as the compression looks
LARGE_BYTES = 1_000_000  # of a column; smaller ones stay in memory


class PackedRows(MutableMapping[int, RecordRow]):
    """Records by number. Each is packed for itself, with the first one as the dictionary of the compression.

    One with large samples is kept as it is, and these in a file.
    """

    def __init__(self) -> None:
        self._dictionary = b""
        self._packed: dict[int, bytes | RecordRow] = {}
        self._store = SampleStore()

    def __setitem__(self, number: int, row: RecordRow) -> None:
        stored = self._store.kept(row)
        if stored is not row:
            self._packed[number] = stored
            return
        plain = pickle.dumps(row, pickle.HIGHEST_PROTOCOL)
        self._dictionary = self._dictionary or plain[-_DICTIONARY_BYTES:]
        packer = zlib.compressobj(_LEVEL, zdict=self._dictionary)
        self._packed[number] = packer.compress(plain) + packer.flush()

    def __getitem__(self, number: int) -> RecordRow:
        packed = self._packed[number]
        if isinstance(packed, RecordRow):
            return packed
        row: RecordRow = pickle.loads(zlib.decompressobj(zdict=self._dictionary).decompress(packed))
        return row

    def __delitem__(self, number: int) -> None:
        del self._packed[number]

    def __iter__(self) -> Iterator[int]:
        return iter(self._packed)

    def __len__(self) -> int:
        return len(self._packed)


class PackedList(Generic[Item]):
    """A list that only grows; full blocks of it are packed."""

    def __init__(self) -> None:
        self._blocks: list[bytes] = []
        self._newest: list[Item] = []

    def append(self, item: Item) -> None:
        """Add one item; it must not be changed afterwards."""
        self._newest.append(item)
        if len(self._newest) == BLOCK:
            self._blocks.append(zlib.compress(pickle.dumps(self._newest, pickle.HIGHEST_PROTOCOL), _LEVEL))
            self._newest = []

    def __iter__(self) -> Iterator[Item]:
        for block in self._blocks:
            unpacked: list[Any] = pickle.loads(zlib.decompress(block))
            yield from unpacked
        yield from self._newest


class SampleStore:
    """A file without a name that large columns go to; where it cannot be written they stay in memory."""

    def __init__(self) -> None:
        self._file: IO[bytes] | None = None
        self._end = 0

    def kept(self, row: RecordRow) -> RecordRow:
        """Return a record whose large columns are read when they are asked for; the same one if none is large."""
        sampled = [*row.beside.values(), *([] if row.samples is None else [row.samples])]
        if not any(_bytes_of(column) >= LARGE_BYTES for samples in sampled for column in samples.columns.values()):
            return row
        samples = None if row.samples is None else self._stored(row.samples)
        return replace(row, samples=samples, beside={link: self._stored(sent) for link, sent in row.beside.items()})

    def _stored(self, samples: Samples) -> Samples:
        return replace(samples, columns=StoredColumns(self, samples.columns))

    def write(self, column: Column) -> tuple[int, int] | None:
        """Return where a column stands now, (offset, bytes), None if it is small or there is no room for it."""
        if _bytes_of(column) < LARGE_BYTES:
            return None
        content = memoryview(pickle.dumps(column, pickle.HIGHEST_PROTOCOL))
        with suppress(OSError):
            opened, written = self._opened(), 0
            while written < len(content):
                written += write_at(opened.fileno(), content[written:], self._end + written)
            self._end += len(content)
            return self._end - len(content), len(content)
        return None

    def _opened(self) -> IO[bytes]:
        if self._file is None:
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - closed with the store
            weakref.finalize(self, self._file.close)
        return self._file

    def read(self, at: int, count: int) -> Column:
        """Return the column that stands there. Raises: OSError."""
        assert self._file is not None
        content = bytearray()
        while len(content) < count:
            piece = read_at(self._file.fileno(), count - len(content), at + len(content))
            if not piece:
                raise OSError("the file of the samples is shorter than it was")
            content += piece
        column: Column = pickle.loads(content)
        return column


class StoredColumns(Mapping[str, Column]):
    """Columns of samples by name; one that stands in a file is read each time it is asked for."""

    def __init__(self, store: SampleStore, columns: Mapping[str, Column]) -> None:
        self._store = store
        self._places = {name: store.write(column) for name, column in columns.items()}
        self._here = {name: column for name, column in columns.items() if self._places[name] is None}

    def __getitem__(self, name: str) -> Column:
        place = self._places[name]
        return self._here[name] if place is None else self._store.read(*place)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


def _bytes_of(column: Column) -> int:
    return sum(map(len, column.tolist())) if column.dtype == object else column.nbytes
