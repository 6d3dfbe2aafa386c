"""A session written for other tools: one file per table in a new folder, or one MCAP file with a channel per table."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

from bench.model.errors import InputError
from bench.session.output import writing
from bench.tables.files import CsvFile, Hdf5File, MatFile, ParquetFile, TableFile
from bench.tables.library import library
from bench.tables.mcap_file import McapFile
from bench.tables.session import RESULTS, Session

if TYPE_CHECKING:
    from pandas import DataFrame

MCAP = "mcap"
_FILES: dict[str, type[CsvFile] | type[ParquetFile] | type[Hdf5File] | type[MatFile]] = {
    "csv": CsvFile, "parquet": ParquetFile, "hdf5": Hdf5File, "mat": MatFile,
}  # fmt: skip
_NEEDS = {"parquet": "pyarrow", "hdf5": "h5py", MCAP: "mcap"}
FORMATS = (*_FILES, MCAP)
Open = Callable[[str, "DataFrame"], TableFile]


def export_session(session: Session, form: str, folder: Path) -> dict[str, int]:
    """Write events, readings, records, an imported log, estimates (where there are results) and all frames of links.

    The folder has its name when all of it is whole; frames pass block by block.

    Args:    form: one of ``FORMATS``.   folder: new; the one above it must be there or can be made.
    Returns: rows by table: ``events``, ..., ``frames.<link>.<message>``.
    Raises:  InputError B-TAB-001 (library missing), B-TAB-007 (folder exists), B-TAB-009 (no such format), B-TAB-008
             (too large for MATLAB), B-CLI-007 (cannot be written); those of ``Session``.
    """
    if form not in FORMATS:
        raise InputError("B-TAB-009", f"{form!r} is no format", where="--to", next_step=f"use {', '.join(FORMATS)}")
    for name in ("pandas", _NEEDS.get(form, "pandas")):
        library(name)
    if folder.exists():
        raise InputError("B-TAB-007", "is there already, and nothing is written over", where=str(folder),
                         next_step="name another folder by --out, or move this one away")  # fmt: skip
    with writing(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as room:
            place = Path(room) / "tables"
            place.mkdir()
            if form == MCAP:
                rows = _write_mcap(session, place)
            else:
                kind = _FILES[form]
                rows = _write(session, lambda name, _: kind(place / f"{name}{kind.SUFFIX}"))
            place.replace(folder)
    return rows


def _tables(session: Session) -> Iterator[tuple[str, DataFrame]]:
    """Yield the tables that are no frames, by name."""
    yield from (("events", session.events), ("readings", session.readings), ("records", session.records))
    if len(session.log):
        yield "log", session.log
    if (session.folder / RESULTS).exists():
        yield "estimates", session.estimates


def _write(session: Session, opened: Open) -> dict[str, int]:
    rows: dict[str, int] = {}
    for name, table in _tables(session):
        with closing(opened(name, table)) as file:
            file.write(table)
        rows[name] = len(table)
    for link in session.links:
        with ExitStack() as stack:
            files: dict[str, TableFile] = {}
            for message in session.messages(link):
                name, empty = f"frames.{link}.{message}", session.empty_frames(link, message)
                files[message] = file = stack.enter_context(closing(opened(name, empty)))
                file.write(empty)
                rows[name] = 0
            for message, block in session.frame_blocks(link):
                files[message].write(block)
                rows[f"frames.{link}.{message}"] += len(block)
    return rows


def _write_mcap(session: Session, place: Path) -> dict[str, int]:
    file = McapFile(place / f"{session.folder.name}.mcap", session.utc_offset_ns)
    try:
        rows = _write(session, lambda name, block: file.channel("/" + "/".join(name.split(".", 2)), block))
        file.close()
    finally:
        file.abandon()
    return rows
