"""Raw captures of any length, decoded block by block; nothing of them is kept."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, BinaryIO

from bench.frame.batch import MessageBatch
from bench.frame.best import Engine
from bench.frame.definition import FrameDefinition
from bench.frame.stream import LinkBatch, LinkCounts, LinkDecoder

_BLOCK_BYTES = 4_000_000
Take = Callable[[Mapping[str, MessageBatch]], None]


@dataclass(frozen=True)
class Counted:
    """What a capture holds: counts, frames by message name, and whether it ends inside a frame."""

    definition: FrameDefinition
    counts: LinkCounts
    messages: Mapping[str, int]
    cut_off: bool

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
        }


def decode_capture(
    definition: FrameDefinition, stream: BinaryIO, take: Take = lambda messages: None, engine: Engine | None = None
) -> Counted:
    """Decode a capture to its end; without receive times a gap longer than a counter wrap looks shorter.

    Args:   take: gets the frames of each block by message name, in file order.
    Raises: OSError, and what ``take`` raises.
    """
    link = LinkDecoder(definition, engine)
    frames: Counter[str] = Counter()

    def found(batch: LinkBatch) -> None:
        frames.update({name: len(messages) for name, messages in batch.messages.items()})
        take(batch.messages)

    while block := stream.read(_BLOCK_BYTES):
        link.push(0, block)
        found(link.flush())
    cut_off = link.undecided_bytes >= max(1, len(definition.layout.sync))
    found(link.finish())
    return Counted(definition, link.counts, {name: frames[name] for name in definition.messages}, cut_off)
