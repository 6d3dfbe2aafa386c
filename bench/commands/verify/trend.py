"""Whether the trend of a session, from which the page draws its history, is what the raw bytes give."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from bench.frame import BENCH
from bench.record import FOLDER, HEAD, LEVELS_S, OPEN_MARKER, read_head
from bench.replay import build_trend
from bench.session.verification import Verification

ADVICE = "it is no part of the recording: remove the folder 'trend', and the page makes it again"


def check_trend(found: Verification, folder: Path) -> None:
    """Make the trend again and compare its files byte by byte; what differs is noted, with what to do.

    Of the bench's own temperatures nothing is compared: a trend that is made again knows the times of set-points by the
    plan alone (docs/session-format.md). A session that is damaged or not closed is not looked at.
    """
    if found.changes or (folder / OPEN_MARKER).exists() or not (folder / FOLDER).is_dir():
        return
    head = read_head(folder / FOLDER)
    if head is None:
        found.notes.append(f"{FOLDER}/{HEAD} cannot be read; {ADVICE}")
        return
    with TemporaryDirectory() as place:
        build_trend(folder, Path(place))
        made = read_head(Path(place) / FOLDER)
        assert made is not None
        differing = [] if head.sources == made.sources else [HEAD]
        for source in made.sources if not differing else ():
            for level_s in LEVELS_S if source.name != BENCH else ():
                stored, due = (source.path(one / FOLDER, level_s) for one in (folder, Path(place)))
                if not stored.is_file() or stored.read_bytes() != due.read_bytes():
                    differing.append(stored.name)
    found.notes += [f"{FOLDER}/{name} is not what the session gives; {ADVICE}" for name in differing]
