"""Finished records and events of a long run, kept in little memory until its end."""

from __future__ import annotations

import pickle
import zlib
from collections.abc import Iterator, MutableMapping
from typing import Any, Generic, TypeVar

from bench.record.stored import SampleStore
from bench.record.window import RecordRow

Item = TypeVar("Item")

BLOCK = 64
_LEVEL = 6
_DICTIONARY_BYTES = 1 << 15  # as far back as the compression looks


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
