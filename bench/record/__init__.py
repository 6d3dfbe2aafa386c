"""Floor 2: the session container: write, read, recover; records cut from frames; the step journal."""

from bench.record.cut import RecordCutter
from bench.record.journal import Journal, JournalEntry, read_journal
from bench.record.layout import Message, canonical_json
from bench.record.packed import PackedList, PackedRows
from bench.record.reader import SessionReader
from bench.record.samples import Samples
from bench.record.scan import Damage
from bench.record.window import RecordRow
from bench.record.writer import RecordError, SessionWriter

__all__ = [
    "Damage",
    "Journal",
    "JournalEntry",
    "Message",
    "PackedList",
    "PackedRows",
    "RecordCutter",
    "RecordError",
    "RecordRow",
    "Samples",
    "SessionReader",
    "SessionWriter",
    "canonical_json",
    "read_journal",
]
