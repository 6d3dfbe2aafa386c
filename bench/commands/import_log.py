"""``bench import``: a delimited log of another system becomes a session, with its bytes as they are."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any

from bench.analysis import declared_analysis
from bench.commands.console import console, say
from bench.commands.tables import print_finished
from bench.model.clock import NS, utc_stamp
from bench.model.errors import ExitStatus, FitError, InputError
from bench.model.yamlio import Document
from bench.plan import LogMapping, load_mapping, names_made_of_logs
from bench.record import SessionWriter
from bench.replay import IMPORT, LINK, MAPPING, LogParser, survey
from bench.run.observers import new_folder
from bench.run.provenance import software
from bench.session.finish import finish
from bench.session.history import chosen_url
from bench.session.service import read_view
from bench.tables import OtherLog

NO_ANALYSIS = "none"
ROTATE_BYTES = 32_000_000  # a reader holds one segment in memory


def import_log(mapping_file: Path, file: Path, out: Path) -> int:
    """Check a log against its mapping, write the session, and fit it from there if the mapping names an analysis.

    Returns: 1 if a verdict fails, a result is missing or an estimate is not sound, else 0.
    """
    document = load_mapping(mapping_file)
    mapping = document.model
    if mapping.analysis != NO_ANALYSIS:
        _known_analysis(document)
    log = OtherLog(file, mapping)
    surveyed, lines_ns = survey(log.lines(), mapping, str(file))
    if (outside := mapping.beyond(surveyed.counts.rows)) is not None:
        place, message, cure = outside
        raise InputError("B-IMP-008", message, where=document.where(place), next_step=cure)
    folder = _write(document, file, log, surveyed, lines_ns, out)
    counts = surveyed.counts
    say(f"{file}: {counts.rows} rows, {counts.overload_rows} with an overload, {counts.bad_rows} cannot be read")
    for sentence in counts.salvaged():
        say(sentence)
    if mapping.analysis == NO_ANALYSIS:
        say(f"session  {folder}")
        return ExitStatus.PASS
    finished = finish(folder, read_view(folder), chosen_url(None, out, os.environ))
    for sentence in finished.analysis.seen:
        say(sentence)
    return print_finished(finished, console())


def _known_analysis(document: Document[LogMapping]) -> None:
    """Refuse a name that is unknown, or of records instead of logs, before anything is written, with its position."""
    name = document.model.analysis
    try:
        if name in names_made_of_logs(False):
            raise FitError(
                "B-FIT-011",
                f"the analysis {name!r} is made of a bench's records, not of a log",
                next_step=f"write one of: {', '.join((*names_made_of_logs(True), NO_ANALYSIS))}",
            )
        declared_analysis(name)
    except FitError as error:
        raise InputError(
            error.code, error.message, where=document.where(("analysis",)), next_step=error.next_step
        ) from error


def _write(
    document: Document[LogMapping], file: Path, log: OtherLog, surveyed: LogParser, lines_ns: Sequence[int], out: Path
) -> Path:
    """Return the session: every line of the file is a message, stamped with the time of its row."""
    mapping = document.model
    name = session_name(mapping, surveyed)
    folder = new_folder(out, name)
    writer = SessionWriter.create(
        folder, _manifest(document, name, file, surveyed, log.origin), {MAPPING: document.text}, t_mono_ns=0
    )
    writer.clock_pair(0, surveyed.first_ns)
    since = 0
    for line, t_ns in zip(log.lines(surveyed.size), chain(lines_ns, repeat(lines_ns[-1])), strict=False):
        writer.raw(LINK, "rx", t_ns, line)
        since += len(line)
        if since > ROTATE_BYTES:
            writer.tick(t_ns)
            since = 0
    writer.clock_pair(lines_ns[-1], surveyed.last_ns)
    writer.close("imported")
    return folder


def session_name(mapping: LogMapping, surveyed: LogParser) -> str:
    """Return ``<UTC of the first row>_<mapping>_<serial number>``."""
    serial = re.sub(r"[^A-Za-z0-9.-]", "-", mapping.uut.serial)
    return f"{utc_stamp(surveyed.first_ns)}_{mapping.mapping}_{serial}"


def _manifest(
    document: Document[LogMapping], name: str, file: Path, surveyed: LogParser, origin: Mapping[str, Any]
) -> dict[str, Any]:
    """Return manifest of an imported session (docs/session-format.md); the mapping stands where a plan would."""
    mapping = document.model
    sha256 = hashlib.sha256(document.text.encode()).hexdigest()
    counts = surveyed.counts
    return {
        "schema": 1,
        "kind": IMPORT,
        "session": name,
        "sequence": mapping.mapping,
        "title": mapping.title or mapping.mapping,
        "simulated": False,
        "clock": "log",
        "campaign": mapping.campaign(),
        "standards": {},
        "identities": {},
        "links": {},
        "measurement_link": LINK,
        "plan_sha256": sha256,
        "frame_sha256": {LINK: sha256},
        "planned": {
            "prepare_s": 0.0,
            "duration_s": (surveyed.last_ns - surveyed.first_ns) / NS,
            "records": 0,
            "steps": 0,
        },
        "log": {
            "file": file.name,
            "bytes": surveyed.size,
            "sha256": surveyed.digest.hexdigest(),
            "rows": counts.rows,
            "overload_rows": counts.overload_rows,
            "bad_rows": counts.bad_rows,
            **({"origin": origin} if origin else {}),
        },
        "software": software(mapping.analysis),
    }
