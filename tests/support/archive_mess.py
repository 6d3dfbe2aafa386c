"""A folder of sessions as years leave them: whole ones, 27 kinds of damage, and what each of them is to the archive."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rehearsal import writable_copy

from bench.record import SessionReader, SessionWriter

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "sessions" / "0.1.0"
OTHER = GOLDEN / "20000101T000000Z_golden_rlg_GOLDEN"
SEGMENT, RESULTS, OPEN = "session.0001.mcap", "results.json", "session.open"
LOCKED = "locked"  # may not be listed
Spoil = Callable[[Path], object]


def of_bytes(change: Callable[[bytes], bytes], name: str = SEGMENT) -> Spoil:
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def of_results(change: Callable[[dict[str, Any]], object]) -> Spoil:
    def spoil(folder: Path) -> None:
        document = json.loads((folder / RESULTS).read_text())
        change(document)
        (folder / RESULTS).write_text(json.dumps(document))

    return spoil


def alter(document: dict[str, Any]) -> None:
    document["estimates"][0]["value"] *= 1.0 + 1e-7


def _all(*spoils: Spoil) -> Spoil:
    return lambda folder: [spoil(folder) for spoil in spoils]


def _flip(at: int) -> Spoil:
    return of_bytes(lambda raw: raw[:at] + bytes([raw[at] ^ 0xFF]) + raw[at:][1:])


def gone(name: str) -> Spoil:
    return lambda folder: (folder / name).unlink()


def _instead(name: str, make: Callable[[Path], object]) -> Spoil:
    return _all(gone(name), lambda folder: make(folder / name))


def _linked(name: str) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / name).rename(folder / f"real.{name}")
        (folder / name).symlink_to(f"real.{name}")

    return spoil


def _only(*names: str) -> Spoil:
    def spoil(folder: Path) -> None:
        for path in folder.iterdir():
            if path.name not in names:
                path.unlink()

    return spoil


def _opened(folder: Path) -> None:
    (folder / OPEN).touch()


def _recorded(error: str | None) -> Spoil:
    """A session of a few events, whose run ended or was stopped."""

    def spoil(folder: Path) -> None:
        source = SessionReader(folder)
        manifest, texts, end = source.manifest, source.texts, next(fields for _, _, fields in source.events("end"))
        shutil.rmtree(folder)
        writer = SessionWriter.create(folder, manifest, texts, t_mono_ns=0)
        writer.event("end", 1, {**end, "error": error})
        writer.close("done" if error is None else error)

    return spoil


CUT, END_CUT = of_bytes(lambda raw: raw[:60_000]), of_bytes(lambda raw: raw[:-3000])
SHORT, WRONG = "damaged B-ARC-004", "damaged B-REC-011"
UNREADABLE, UNFINISHED = "unreadable B-ARC-007", "unfinished B-STORE-013"
# What a folder is, by what was done to a whole session: the kind, and the code of one that is not whole.
KINDS: Mapping[str, tuple[Spoil, str]] = {
    "whole": (lambda _: None, "entered"),
    "no_results": (gone(RESULTS), "entered"),
    "linked": (_all(_linked(SEGMENT), _linked(RESULTS)), "entered"),
    "open_by_a_copy": (_opened, "entered"),
    "with_a_trend": (lambda folder: (folder / "trend").mkdir(), "entered"),
    "strange ünicode ' name": (lambda _: None, "entered"),
    "done_without_results": (_recorded(None), "entered"),
    "cut": (CUT, SHORT),
    "cut_early": (of_bytes(lambda raw: raw[:1000]), SHORT),
    "empty": (of_bytes(lambda _: b""), SHORT),
    "cut_with_broken_results": (_all(CUT, of_bytes(lambda _: b"{", RESULTS)), SHORT),
    "cut_and_nothing_says_more": (_all(CUT, gone(RESULTS)), "damaged B-STORE-013"),
    "end_cut": (END_CUT, WRONG),
    "flipped": (_flip(50_000), WRONG),
    "flipped_manifest": (_flip(400), WRONG),
    "flipped_summary": (_flip(-100), WRONG),
    "appended": (of_bytes(lambda raw: raw + b"more"), WRONG),
    "zeroed": (of_bytes(lambda raw: raw[:50_000] + bytes(500) + raw[50_500:]), WRONG),
    "second_gone": (lambda folder: (folder / SEGMENT).rename(folder / "session.0002.mcap"), WRONG),
    "broken_results": (of_bytes(lambda _: b"{", RESULTS), "damaged B-FIT-010"),
    "provenance": (of_results(lambda document: document.update(provenance="")), "damaged B-FIT-010"),
    "foreign_results": (lambda folder: shutil.copy(OTHER / RESULTS, folder), "damaged B-STORE-013"),
    "altered": (of_results(alter), "entered"),  # verify computes it
    "pipe": (_instead(SEGMENT, os.mkfifo), UNREADABLE),
    "results_pipe": (_instead(RESULTS, os.mkfifo), UNREADABLE),
    "dead_link": (_instead(SEGMENT, lambda path: path.symlink_to("/no/such/file")), UNREADABLE),
    "bad\udcffname": (lambda _: None, UNREADABLE),
    LOCKED: (lambda _: None, UNREADABLE),
    "running": (_all(_recorded(None), END_CUT, _opened), UNFINISHED),
    "killed": (_all(CUT, gone(RESULTS), _opened), UNFINISHED),
    "stopped": (_recorded("B-RUN-010"), "stopped B-STORE-013"),
    "results_only": (_only(RESULTS), "no_recording"),
    "marker_only": (_all(_only(), _opened), "no_recording"),
    "nothing": (_only(), "no_recording"),
}
COMPUTED = (
    "altered",
    "broken_results",
    "provenance",
    "foreign_results",
)  # beside those entered: the recording is whole
ALTERED = "damaged B-ARC-008"


def make(root: Path, sessions: Sequence[Path], count: int) -> dict[str, tuple[str, str]]:
    """Make ``count`` folders and a link, some of them deep; returns name of the session and what it is, by folder."""
    due, kinds = {}, list(KINDS)
    for number in range(count):
        session, kind = sessions[number % len(sessions)], kinds[number % len(kinds)]
        name = f"{number:03d} {kind}"
        KINDS[kind][0](writable_copy(session, root / ("deep/er" if number % 2 else "flat") / name))
        due[name.replace("\udcff", "\\xff")] = session.name, kind
    (root / "link").symlink_to(sessions[0])
    return due
