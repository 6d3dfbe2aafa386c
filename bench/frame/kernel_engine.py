"""The compiled engine: same offsets, counts and fields as the two others, in one pass of the kernel over each block.

Whole quanta in running sums, counted in one pass of the kernel.
"""

from __future__ import annotations

import ctypes
import struct
import sys
from array import array
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.frame.batch import Arrivals, FrameBatch, FrameCounts, MessageBatch, extract_column
from bench.frame.best import kernel, why_no_kernel
from bench.frame.counter import REPEAT_REACH
from bench.frame.kernel import task as order
from bench.frame.kernel.arrays import Arrays
from bench.frame.layout import Layout, Message
from bench.frame.numpy_engine import rows_of
from bench.model.clock import NS

_FEW_BAD = 64  # rejected candidates that there is room for at first
_HELD = 2  # references to a memory that nobody else holds: of its block and of the question
_STEP = 64  # frames; blocks of live feeds, which vary by a few, serve each other
_TOLD = struct.Struct(f"{order.TOLD}q")
_HEAD = _TOLD.size
_LENGTH = ".length"
_FOUND = {"offset": ".offset", "t_ns": ".t_ns", "counter": ".counter", "suspect": ".suspect"}  # no name of a field

_Place = tuple[int | None, np.dtype[Any], int]  # elements, type, bytes per frame of the columns before
Int64 = NDArray[np.int64]
Counts = NDArray[np.uint16]
_SPARE = ctypes.byref(ctypes.c_int64())
_Memory = ctypes.c_char * 1


class Kind(NamedTuple):
    """What the frames of one message have in common.

    ``places``: of what the kernel has written of them, fields and the rest, where it begins in a block; ``timed``:
    whether they have stamps; ``size``: of the check.
    """

    message: Message
    places: Mapping[str, _Place]
    timed: bool
    size: int


class Block:
    """Memory for what the kernel writes of up to ``room`` frames; ``views``: arrays of it by kind and name, so far."""

    __slots__ = ("address", "memory", "room", "views")

    def __init__(self, frame_bytes: int, room: int, kinds: int) -> None:
        self.memory = np.empty(frame_bytes * room, np.uint8)
        self.address = int(self.memory.ctypes.data)
        self.room = room
        self.views: list[dict[str, NDArray[Any]]] = [{} for _ in range(kinds)]

    @property
    def free(self) -> bool:
        """Whether nobody else holds an array of this memory."""
        views = self.views
        known = len(views[0]) if len(views) == 1 else sum(map(len, views))
        return sys.getrefcount(self.memory) == _HELD + known


class CutBatch(MessageBatch):
    """Frames of one message whose fields the kernel has cut; arrays are made of its block when they are asked for."""

    __slots__ = ("_frames", "_kind", "_memory", "_position", "_room", "_stream", "_views")

    def __init__(self, kind: Kind, block: Block, index: int, frames: int, stream: bytes, position: int) -> None:
        self.message = kind.message
        self.ends = None
        self._columns = {}
        self._kind = kind
        self._memory = block.memory
        self._room = block.room
        self._views = block.views[index]
        self._frames = frames
        self._stream = stream
        self._position = position

    def __len__(self) -> int:
        return self._frames

    def raw(self, name: str) -> NDArray[Any]:
        """Raw values of a field; see ``MessageBatch.raw``."""
        column = self._columns.get(name)
        if column is None:
            view = self._views.get(name)
            if view is None:
                column = self._written(name) if name in self._kind.places else self._cut(name)
            else:
                column = view[: self._frames]
            self._columns[name] = column
        return column

    def __getattr__(self, name: str) -> Any:
        """Make an attribute that is asked for the first time."""
        found = self._made(name)
        setattr(self, name, found)
        return found

    def _written(self, name: str) -> NDArray[Any]:
        """Return what the kernel has written, (n,) or (n, count)."""
        view = self._views.get(name)
        if view is None:
            count, kind, before = self._kind.places[name]
            shape = (self._room,) if count is None else (self._room, count)
            view = self._views[name] = np.ndarray(shape, kind, self._memory, before * self._room)
        return view[: self._frames]

    def _made(self, name: str) -> Any:
        kind = self._kind
        if name in ("t_ns", "counter") and not (kind.timed and (name == "t_ns" or kind.message.counter)):
            return None
        if name in _FOUND:
            return self._written(_FOUND[name])
        if name == "_extract":
            return extract_column
        if name == "rows":
            return rows_of(np.frombuffer(self._stream, np.uint8), self.offset - self._position, kind.message)
        if name == "rest":
            return self._rest()
        raise AttributeError(name)

    def _rest(self) -> list[bytes] | None:
        if self.message.rest is None:
            return None
        begin, size = self.message.body, self._kind.size
        starts, lengths = (self.offset - self._position).tolist(), self._written(_LENGTH).tolist()
        return [self._stream[at + begin : at + length - size] for at, length in zip(starts, lengths, strict=True)]


class KernelDecoder:
    """Compiled decoder; where it is told the arrivals it gives frames their stamps and counters too."""

    def __init__(self, layout: Layout, arrays: Arrays, decode: Callable[..., Any],
                 arrivals: Arrivals | None = None) -> None:  # fmt: skip
        self._arrivals = arrivals or Arrivals(array("q"), array("q"))
        self._arrays = arrays  # the kernel reads them by their address
        self._shortest = arrays.shortest
        self._decode = decode
        self._kinds = [
            Kind(message, _places(message, index, arrays), arrivals is not None, layout.check.size)
            for index, message in enumerate(layout.messages)
        ]
        kinds = len(self._kinds)
        self._frame_bytes = (order.FOUND_BYTES + 1) * kinds + arrays.width
        self._counters = _counters(layout)
        self._address, self._counted = arrays.numbers.ctypes.data, self._counters.ctypes.data
        self._task = (ctypes.c_int64 * (order.MESSAGES + order.PER_MESSAGE * kinds))()
        self._at_task = ctypes.byref(self._task)
        self._at_spare = ctypes.byref(ctypes.c_int64())
        self._given = struct.Struct(f"{order.GIVEN + order.PER_MESSAGE * kinds}q")
        self._blocks: list[Block] = []
        self._make_room(_FEW_BAD)
        self._tail = b""
        self._position = 0
        self.counts = FrameCounts(by_message={message.name: 0 for message in layout.messages})

    def feed(self, chunk: bytes) -> FrameBatch:
        """Decode what can be decided; the undecided tail waits for the next feed."""
        self.counts.bytes += len(chunk)
        return self._run(self._tail + chunk if self._tail else bytes(chunk), final=False)

    def finish(self) -> FrameBatch:
        """End of the stream: candidates whose bytes never came are no frames."""
        return self._run(self._tail, final=True)

    def give_up(self, before: int) -> FrameBatch:
        """Reject what was begun before the stream offset ``before`` and is not whole yet, byte by byte."""
        return self._run(self._tail, final=False, before=before - self._position)

    def _run(self, stream: bytes, final: bool, before: int = 0) -> FrameBatch:
        block = self._block_of(len(stream) // self._shortest)
        position, arrivals, kinds = self._position, self._arrivals, self._kinds
        (ends, chunks), (stamps, _) = arrivals.ends.buffer_info(), arrivals.stamps.buffer_info()
        _TOLD.pack_into(self._task, 0, self._address, len(stream), position, final, before, block.room, block.address,
                        self._bad_address, self._bad_room, ends, stamps, chunks, self._counted)  # fmt: skip
        self._decode(self._at_spare, None, stream, self._at_task)
        decided, rejected, accepted, lost, duplicate, suspect, *of_messages = self._given.unpack_from(self._task, _HEAD)
        if rejected > self._bad_room:  # once more, with room for every rejected candidate
            self._make_room(rejected)
            return self._run(stream, final, before)
        batches, counts = {}, self.counts
        for index, kind in enumerate(kinds):
            name, frames = kind.message.name, of_messages[order.PER_MESSAGE * index]
            batches[name] = CutBatch(kind, block, index, frames, stream, position)
            counts.frames += frames
            counts.by_message[name] += frames
        counts.bad += rejected
        counts.skipped_bytes += decided - accepted
        self._tail = stream[decided:]
        self._position += decided
        offset, bad_t_ns = self._bad[:, :rejected].copy() if rejected else (_NONE, _NONE)
        if not chunks:
            return FrameBatch(batches, offset, self._position)
        return FrameBatch(batches, offset, self._position, bad_t_ns, lost, duplicate, suspect)

    def _make_room(self, rejected: int) -> None:
        """Have memory for offsets and stamps of so many rejected candidates."""
        self._bad, self._bad_room = np.empty((2, rejected), np.int64), rejected
        self._bad_address = int(self._bad.ctypes.data)

    def _block_of(self, frames: int) -> Block:
        """Return memory for so many frames: that of an earlier call if nobody holds it any more."""
        for block in self._blocks:
            if frames <= block.room <= 4 * frames + _STEP and block.free:
                return block
        room = frames + _STEP & -_STEP  # a column begins at a multiple of eight bytes
        self._blocks = [Block(self._frame_bytes, room, len(self._kinds)), *self._blocks[:1]]
        return self._blocks[0]


def _places(message: Message, index: int, arrays: Arrays) -> dict[str, _Place]:
    """Return where in a block the numbers of a message begin; see bench.frame.kernel.scan."""
    kinds, fields, found = len(arrays.columns), message.by_name, order.FOUND_BYTES * index
    begin = order.FOUND_BYTES * kinds
    written = (_FOUND["offset"], _LENGTH, _FOUND["t_ns"], _FOUND["counter"])
    places: dict[str, _Place] = {
        name: (None, np.dtype(np.int64), found + 8 * number) for number, name in enumerate(written)
    }
    places[_FOUND["suspect"]] = (None, np.dtype(np.bool_), begin + arrays.width + index)
    for name, before in arrays.columns[index].items():
        places[name] = (fields[name].count, np.dtype(fields[name].dtype), begin + before)
    return places


_NONE = np.empty(0, np.int64)


def _counters(layout: Layout) -> NDArray[np.int64]:
    """Return what is known of the counter of every message: nothing yet."""
    rows = np.zeros((len(layout.messages), order.COUNTER_NUMBERS), np.int64)
    rows[:, order.REJECTED_RAW] = -1
    rate = 0.0 if layout.rate_Hz is None else layout.rate_Hz / NS
    rows[:, order.PER_NS] = np.float64(rate).view(np.int64)
    for row, message in zip(rows, layout.messages, strict=True):
        if message.counter is not None:
            wrap = message.counter.wrap or 1 << (8 * message.counter.size)
            row[[order.WRAP, order.REACH]] = wrap, min(REPEAT_REACH, wrap // 4)
    return rows


def kernel_quanta(
    noise: NDArray[np.int32], clocks: Int64, sign: Int64, size: Int64, quantum: Int64, start: Int64
) -> tuple[Counts, Counts, Int64]:
    """Count the quanta that become whole as each row's sum goes on from ``start`` by (size + sign * noise) * clocks.

    Args:
        noise: (rows, n); no step is negative.   clocks: (n,).   sign: +1 or -1, (rows,).   size, quantum, start:
            (rows,), the start above -2^62; no sum reaches 2^62, none holds 2^50 quanta.
    Returns:
        Quanta of each step, modulo 2^16, of the rows with sign +1 and of those with -1, zeros in the others, (rows, n)
        each; what each sum holds beyond whole quanta, (rows,).
    Raises:
        RuntimeError: there is no kernel.
    """
    compiled = kernel()
    if compiled is None:
        raise RuntimeError(why_no_kernel())
    rows, stretches = noise.shape
    noise = noise if noise.strides[1] == noise.itemsize else np.ascontiguousarray(noise)
    clocks = np.ascontiguousarray(clocks)
    counts = np.zeros((2, rows, stretches), np.uint16)
    task = np.empty(order.OF_ROWS + order.ROW_NUMBERS * rows, np.int64)
    task[: order.OF_ROWS] = noise.ctypes.data, noise.strides[0], clocks.ctypes.data, stretches, rows
    of_rows = task[order.OF_ROWS :].reshape(rows, order.ROW_NUMBERS)
    of_rows[:, order.COUNTS] = counts.ctypes.data + counts.strides[1] * (np.arange(rows) + rows * (sign < 0))
    for place, values in ((order.SIGN, sign), (order.SIZE, size), (order.QUANTUM, quantum), (order.START, start)):
        of_rows[:, place] = values
    compiled.count_quanta(_SPARE, None, _Memory.from_buffer(task.data))
    return counts[0], counts[1], of_rows[:, order.START]
