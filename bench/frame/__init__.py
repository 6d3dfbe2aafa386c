"""Floor 1: frame definitions to decoders and encoders; checks; resynchronisation; counters of a link."""

from bench.frame.batch import FrameBatch, FrameCounts, MessageBatch
from bench.frame.catalogue import CATALOGUE, CrcModel, find_model
from bench.frame.checksums import CHECKSUMS, Check
from bench.frame.commands import CommandLayout, PayloadLayout
from bench.frame.crc import Crc
from bench.frame.cumulative import CumulativeCount, Increments
from bench.frame.definition import Decoder, FrameDefinition, load_frame, parse_frame
from bench.frame.schema import FrameSpec, frame_schema
from bench.frame.stream import LinkBatch, LinkCounts, LinkDecoder
from bench.frame.table import FileDecode, decode_file, write_csv

__all__ = [
    "CATALOGUE",
    "CHECKSUMS",
    "Check",
    "CommandLayout",
    "Crc",
    "CrcModel",
    "CumulativeCount",
    "Decoder",
    "FileDecode",
    "FrameBatch",
    "FrameCounts",
    "FrameDefinition",
    "FrameSpec",
    "Increments",
    "LinkBatch",
    "LinkCounts",
    "LinkDecoder",
    "MessageBatch",
    "PayloadLayout",
    "decode_file",
    "find_model",
    "frame_schema",
    "load_frame",
    "parse_frame",
    "write_csv",
]
