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
