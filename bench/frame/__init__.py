"""Floor 1: frame definitions to decoders and encoders; checks; resynchronisation; counters of a link."""

from bench.frame.batch import FrameBatch, MessageBatch
from bench.frame.capture import Counted, decode_capture, undone
from bench.frame.commands import CommandLayout
from bench.frame.definition import Engine, FrameDefinition, Pace, load_frame, pace_of, parse_frame
from bench.frame.explain import LOOKED_AT_BYTES, Guess, LineGuess, draft, guesses, line_guess
from bench.frame.layout import Message
from bench.frame.signals import (
    BENCH,
    BENCH_FIELDS,
    MEAN_S,
    Block,
    Signal,
    all_signals,
    blocks,
    columns,
    expand,
    means,
    of_message,
    rate_of,
    rates_among,
    rates_Hz,
    signal_of,
    trailing_means,
)
from bench.frame.spec import FrameSpec
from bench.frame.stream import LinkBatch, LinkCounts, LinkDecoder
from bench.frame.table import Tables, cells_of

__all__ = [
    "BENCH",
    "BENCH_FIELDS",
    "LOOKED_AT_BYTES",
    "MEAN_S",
    "Block",
    "CommandLayout",
    "Counted",
    "Engine",
    "FrameBatch",
    "FrameDefinition",
    "FrameSpec",
    "Guess",
    "LineGuess",
    "LinkBatch",
    "LinkCounts",
    "LinkDecoder",
    "Message",
    "MessageBatch",
    "Pace",
    "Signal",
    "Tables",
    "all_signals",
    "blocks",
    "cells_of",
    "columns",
    "decode_capture",
    "draft",
    "expand",
    "guesses",
    "line_guess",
    "load_frame",
    "means",
    "of_message",
    "pace_of",
    "parse_frame",
    "rate_of",
    "rates_Hz",
    "rates_among",
    "signal_of",
    "trailing_means",
    "undone",
]
