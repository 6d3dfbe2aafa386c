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

__all__ = [
    "FOLDER",
    "HEAD",
    "HELD_S",
    "LEVELS_S",
    "OPEN_MARKER",
    "SHORTER",
    "UNIT_TEMPERATURE",
    "BenchRows",
    "Block",
    "ChunkPlace",
    "Damage",
    "Files",
    "FrameTimes",
    "Journal",
    "JournalEntry",
    "LinkReduction",
    "Message",
    "PackedList",
    "PackedRows",
    "Part",
    "RecordCutter",
    "RecordError",
    "RecordRow",
    "RecordedReadings",
    "Samples",
    "SegmentChunks",
    "SessionReader",
    "SessionWriter",
    "SignalValues",
    "Survey",
    "TrendReader",
    "TrendRows",
    "TrendWindow",
    "TrendWriter",
    "Walk",
    "canonical_json",
    "concatenated",
    "damaged",
    "is_being_written",
    "is_off_target",
    "joined",
    "read_head",
    "read_journal",
    "recover_session",
    "resume_session",
    "row_of_readings",
    "sources_of",
]
