"""Floor 2: the session container: write, read, recover; records cut from frames; the step journal."""

from bench.model.segments import OPEN_MARKER
from bench.record.block import Block
from bench.record.cut import PackedList, PackedRows, RecordCutter
from bench.record.journal import Journal, JournalEntry, is_being_written, read_journal
from bench.record.layout import Files, Message, canonical_json
from bench.record.reader import SHORTER, ChunkPlace, SegmentChunks, SessionReader, damaged
from bench.record.recover import Survey, recover_session, resume_session
from bench.record.samples import Samples, SignalValues
from bench.record.scan import Damage
from bench.record.trend import (
    FOLDER,
    HEAD,
    HELD_S,
    LEVELS_S,
    BenchRows,
    FrameTimes,
    LinkReduction,
    TrendRows,
    TrendWriter,
    concatenated,
    read_head,
    sources_of,
)
from bench.record.trend_reader import Part, TrendReader, TrendWindow, joined
from bench.record.walk import Walk
from bench.record.window import UNIT_TEMPERATURE, RecordedReadings, RecordRow, is_off_target, row_of_readings
from bench.record.writer import RecordError, SessionWriter

__all__ = ["UNIT_TEMPERATURE", "RecordRow", "Samples", "is_off_target"]
