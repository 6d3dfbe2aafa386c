"""Raw captures of any length, decoded block by block; nothing of them is kept."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, BinaryIO

from bench.frame.batch import MessageBatch
from bench.frame.definition import Engine, FrameDefinition
from bench.frame.layout import Layout
from bench.frame.packets import why_bad
from bench.frame.refusal import Cause, Refusal
from bench.frame.stream import LinkBatch, LinkCounts, LinkDecoder

_BLOCK_BYTES = 4_000_000
_LEAST_BLOCK_BYTES = 1 << 10
_ROW_BYTES = 1 << 25  # of a block, at most, but for blocks of the least size
_EXPLAINED = 1000  # bad candidates of a capture whose cause is looked for
_UNKNOWN = Refusal("unknown", "was given up")
Take = Callable[[Mapping[str, MessageBatch]], None]


@dataclass(frozen=True)
class BadFrames:
    """Bad candidates of one cause: how many of the first thousand; of the first one its offset and what is wrong."""

    cause: Cause
    number: int
    offset: int
    text: str


@dataclass(frozen=True)
class Counted:
    """What a capture holds: counts, frames by message name, whether it ends inside a frame, what is bad and why."""

    definition: FrameDefinition
    counts: LinkCounts
    messages: Mapping[str, int]
    cut_off: bool
    bad: tuple[BadFrames, ...] = ()

    def summary(self) -> dict[str, Any]:
        """JSON-able: the check; counts good, bad, other, lost, duplicate, suspect, of bytes; frames by message."""
        seen = asdict(self.counts)
        return {
            "frame": self.definition.name,
            "frame_sha256": self.definition.sha256,
            "check": self.definition.layout.check.name,
            "good": seen.pop("frames"),
            **seen,
            "messages": dict(self.messages),
            "cut_off": self.cut_off,
            "bad_because": [asdict(kind) for kind in self.bad],
        }


def decode_capture(
    definition: FrameDefinition, stream: BinaryIO, take: Take = lambda messages: None, engine: Engine = "numpy"
) -> Counted:
    """Decode a capture to its end; without receive times a gap longer than a counter wrap looks shorter.

    Args:   take: gets the frames of each block by message name, in file order.
    Raises: OSError, and what ``take`` raises.
    """
    link, causes = LinkDecoder(definition, engine), _Causes(definition.layout)
    frames: Counter[str] = Counter()

    def found(batch: LinkBatch) -> None:
        frames.update({name: len(messages) for name, messages in batch.messages.items()})
        causes.look_at(batch.bad_offset.tolist())
        take(batch.messages)

    while block := stream.read(_block_bytes(definition.layout)):
        link.push(0, block)
        causes.read(block)
        found(link.flush())
    cut_off = link.undecided_bytes >= _begun_bytes(definition.layout)
    found(link.finish())
    messages = {name: frames[name] for name in definition.messages}
    return Counted(definition, link.counts, messages, cut_off, tuple(causes.found.values()))


def _block_bytes(layout: Layout) -> int:
    """Return how many bytes to read at once: fewer where short frames become long rows."""
    longer = max(message.body / max(1, message.least + layout.tail) for message in layout.messages)
    return min(_BLOCK_BYTES, max(_LEAST_BLOCK_BYTES, int(_ROW_BYTES / max(1.0, longer))))


def _begun_bytes(layout: Layout) -> int:
    """Return how many bytes that wait for more are surely the beginning of a frame."""
    if layout.escape or layout.lines:
        return max(1, len(layout.sync))
    return max(1, layout.sync_at + len(layout.pattern))


class _Causes:
    """Why the first bad candidates of a capture are bad; keeps as many bytes as one may need."""

    def __init__(self, layout: Layout) -> None:
        self.found: dict[Cause, BadFrames] = {}
        self._why, self._needs = why_bad(layout)
        self._left = _EXPLAINED
        self._bytes, self._begin = b"", 0

    def read(self, block: bytes) -> None:
        """Take the next bytes of the capture."""
        kept = max(0, len(self._bytes) - self._needs)
        self._begin += kept
        self._bytes = self._bytes[kept:] + block

    def look_at(self, bad: Iterable[int]) -> None:
        """Count the causes of candidates at these offsets, which lie in the bytes read last or just before."""
        for offset in list(bad)[: self._left]:
            self._left -= 1
            at = offset - self._begin
            refusal = self._why(self._bytes[at : at + self._needs]) or _UNKNOWN
            before = self.found.get(refusal.cause) or BadFrames(refusal.cause, 0, offset, refusal.text)
            self.found[refusal.cause] = replace(before, number=before.number + 1)
