"""Floor 1: frame definitions to decoders and encoders; checks; resynchronisation; counters of a link."""

from bench.frame.batch import FrameBatch, MessageBatch
from bench.frame.commands import CommandLayout
from bench.frame.definition import FrameDefinition, load_frame, parse_frame
from bench.frame.stream import LinkBatch, LinkCounts, LinkDecoder

__all__ = [
    "CommandLayout",
    "FrameBatch",
    "FrameDefinition",
    "LinkBatch",
    "LinkCounts",
    "LinkDecoder",
    "MessageBatch",
    "load_frame",
    "parse_frame",
]
