"""A folder of every kind of damage: each folder stands in exactly one count, in words and in JSON, time after time."""

from __future__ import annotations

import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest
from fsspec.implementations.local import LocalFileSystem
from recorded import writable_copy
from rehearsal import Inside

from bench.model.errors import ExitStatus
from bench.record import SessionReader, SessionWriter

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "sessions" / "0.1.0"
AF, RLG = GOLDEN / "20000101T000000Z_golden_GOLDEN", GOLDEN / "20000101T000000Z_golden_rlg_GOLDEN"
SEGMENT, RESULTS, OPEN = "session.0001.mcap", "results.json", "session.open"
Spoil = Callable[[Path], object]


def _bytes(change: Callable[[bytes], bytes], name: str = SEGMENT) -> Spoil:
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def _results(change: Callable[[dict[str, Any]], object]) -> Spoil:
    def spoil(folder: Path) -> None:
        document = json.loads((folder / RESULTS).read_text())
        change(document)
        (folder / RESULTS).write_text(json.dumps(document))

    return spoil


def _both(*spoils: Spoil) -> Spoil:
    return lambda folder: [spoil(folder) for spoil in spoils]


def _flip(at: int) -> Spoil:
    return _bytes(lambda raw: raw[:at] + bytes([raw[at] ^ 0xFF]) + raw[at + 1 :])


def _alter(document: dict[str, Any]) -> None:
    estimate = document["estimates"][0]
    estimate["value"] *= 1.0 + 1e-7


def _gone(name: str) -> Spoil:
    return lambda folder: (folder / name).unlink()


def _instead(name: str, make: Callable[[Path], object]) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        make(folder / name)

    return spoil


def _linked(name: str) -> Spoil:
    return _instead(name, lambda path: path.symlink_to(AF / name))


def _only(*names: str) -> Spoil:
    return lambda folder: [path.unlink() for path in folder.iterdir() if path.name not in names]


def _recorded(error: str | None, *, closed: bool = True) -> Spoil:
    """A session of a few events, whose run ended or was stopped."""

    def spoil(folder: Path) -> None:
        source = SessionReader(AF)
        end = next(fields for _, _, fields in source.events("end"))
        shutil.rmtree(folder)
        writer = SessionWriter.create(folder, source.manifest, source.texts, t_mono_ns=0)
        writer.event("end", 1, {**end, "error": error})
        writer.close("done" if error is None else error)
        if not closed:
            (folder / OPEN).touch()
            _bytes(lambda raw: raw[:-3000])(folder)

    return spoil


CUT = _bytes(lambda raw: raw[:60_000])
SHORT, WRONG = "damaged B-ARC-004", "damaged B-REC-011"
# What a folder is, by what was done to a whole session: the kind, and the code of a damaged one.
FOLDERS: Mapping[str, tuple[Spoil, str]] = {
    "whole": (lambda _: None, "entered"),
    "no_results": (_gone(RESULTS), "entered"),
    "linked": (_both(_linked(SEGMENT), _linked(RESULTS)), "entered"),
    "open_by_a_copy": (lambda folder: (folder / OPEN).touch(), "entered"),
    "with_a_trend": (lambda folder: (folder / "trend").mkdir(), "entered"),
    "strange ünicode ' name": (lambda _: None, "entered"),
    "done_without_results": (_recorded(None), "entered"),
    "cut": (CUT, SHORT),
    "cut_early": (_bytes(lambda raw: raw[:1000]), SHORT),
    "empty": (_bytes(lambda _: b""), SHORT),
    "cut_with_broken_results": (_both(CUT, _bytes(lambda _: b"{", RESULTS)), SHORT),
    "cut_and_nothing_says_more": (_both(CUT, _gone(RESULTS)), "damaged B-STORE-013"),
    "end_cut": (_bytes(lambda raw: raw[:-3000]), WRONG),
    "flipped": (_flip(50_000), WRONG),
    "flipped_manifest": (_flip(400), WRONG),
    "flipped_summary": (_flip(-100), WRONG),
    "appended": (_bytes(lambda raw: raw + b"more"), WRONG),
    "zeroed": (_bytes(lambda raw: raw[:50_000] + bytes(500) + raw[50_500:]), WRONG),
    "second_gone": (lambda folder: (folder / SEGMENT).rename(folder / "session.0002.mcap"), WRONG),
    "broken_results": (_bytes(lambda _: b"{", RESULTS), "damaged B-FIT-010"),
    "provenance": (_results(lambda document: document.update(provenance="")), "damaged B-FIT-010"),
    "foreign_results": (lambda folder: shutil.copy(RLG / RESULTS, folder), "damaged B-STORE-013"),
    "altered": (_results(_alter), "damaged B-ARC-009"),
    "pipe": (_instead(SEGMENT, os.mkfifo), "unreadable B-ARC-007"),
    "results_pipe": (_instead(RESULTS, os.mkfifo), "unreadable B-ARC-007"),
    "dead_link": (_instead(SEGMENT, lambda path: path.symlink_to("/no/such/file")), "unreadable B-ARC-007"),
    "bad\udcffname": (lambda _: None, "unreadable B-ARC-007"),
    "locked": (lambda _: None, "unreadable B-ARC-007"),
    "running": (_recorded(None, closed=False), "unfinished B-STORE-013"),
    "killed": (_both(CUT, _gone(RESULTS), lambda folder: (folder / OPEN).touch()), "unfinished B-STORE-013"),
    "stopped": (_recorded("B-RUN-010"), "stopped B-STORE-013"),
    "results_only": (_only(RESULTS), "no_recording"),
    "marker_only": (_both(_only(), lambda folder: (folder / OPEN).touch()), "no_recording"),
    "nothing": (_only(), "no_recording"),
}


@pytest.fixture
def mess(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of all these, some of them deep below it, and of a link; a history of its own."""
    root = tmp_path / "mess"
    for number, (name, (spoil, _)) in enumerate(FOLDERS.items()):
        folder = writable_copy(AF, root / ("deep/er" if number % 2 else "flat") / name)
        spoil(folder)
    (root / "link").symlink_to(AF)
    monkeypatch.setenv("BENCH_HISTORY", f"sqlite:///{tmp_path / 'history.sqlite'}")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(LocalFileSystem, "ls", _locked)
    return root


_LS = LocalFileSystem.ls


def _locked(self: Any, path: str, **options: Any) -> Any:
    if path.endswith("/locked"):
        raise PermissionError(13, "Permission denied")
    return _LS(self, path, **options)


def _document(said: str) -> tuple[Counter[str], dict[str, str]]:
    """Return the counts of a document, and kind with code by the name of the folder."""
    document = json.loads(said)
    counts = Counter({name: count for name, count in document.items() if name not in ("bytes", "rows")})
    assert all(row["reason"] and row["next_step"] for row in document["rows"])
    return counts, {Path(row["location"]).name: f"{row['kind']} {row['code']}".strip() for row in document["rows"]}


def _due(first: str = "entered") -> dict[str, str]:
    return {name.replace("\udcff", "\\xff"): due.replace("entered", first) for name, (_, due) in FOLDERS.items()}


def test_each_folder_stands_in_exactly_one_count(mess: Path, inside: Inside, tmp_path: Path) -> None:
    # copies of one recording are all in question while one of them has other results
    copies = {name for name, due in _due().items() if due == "entered"} - {"no_results", "done_without_results"}
    due = _due() | dict.fromkeys(copies, "damaged B-ARC-009") | {"link": "link"}
    expected = Counter(kind.partition(" ")[0] for kind in due.values())
    done = inside("archive", "add", str(mess), "--json")
    assert done.returncode == ExitStatus.SESSION_DAMAGED, done.stderr
    counts, rows = _document(done.stdout)
    assert rows == {name: kind for name, kind in due.items() if kind != "entered"}
    assert +counts == expected
    again = inside("archive", "add", str(mess), "--json")
    second, rows_again = _document(again.stdout)
    assert rows_again == rows
    assert (again.returncode, second["entered"]) == (ExitStatus.SESSION_DAMAGED, 0)
    assert second["unchanged"] == counts["entered"]
    assert second.total() == counts.total() == len(FOLDERS) + 1
    words = inside("archive", "add", str(mess)).stdout
    assert words.splitlines()[-1].split("read; ")[1] == ", ".join(
        f"{count} {name.replace('_', ' ')}" for name, count in second.items()
    )
    assert len(words.splitlines()) == len(rows) + 1
    _verify_and_refit(inside, rows, counts, tmp_path)


def _verify_and_refit(inside: Inside, rows: Mapping[str, str], counts: Counter[str], tmp_path: Path) -> None:
    """Both say of the sessions in the archive what ``add`` said; only computing them finds which copy was altered."""
    done = inside("archive", "verify", "--json")
    verified, named = _document(done.stdout)
    assert done.returncode == ExitStatus.SESSION_DAMAGED
    assert named == {**{name: kind for name, kind in rows.items() if "damaged" in kind}, "altered": "damaged B-ARC-008"}
    assert verified.total() == counts["entered"] + counts["damaged"]
    assert verified["verified"] == counts["entered"]
    done = inside("archive", "refit", "--to", str(tmp_path / "trial"))
    assert done.returncode == ExitStatus.VERDICT_FAIL, done.stderr
    refit = pyarrow.parquet.read_table(tmp_path / "trial" / "refit.parquet").to_pylist()
    failed = Counter(row["code"] for row in refit if row["code"])
    lost = Counter(kind.split()[1] for name, kind in named.items() if kind in (SHORT, WRONG) or "nothing_says" in name)
    assert failed - Counter({"B-FIT-007": 1}) == lost  # one is whole, and has no records
    whole = {row["session_sha256"] for row in refit if not row["code"]}
    assert whole == {SessionReader(AF).sha256}


def test_an_altered_number_is_found_without_a_copy_and_stays_known(
    inside: Inside, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BENCH_HISTORY", f"sqlite:///{tmp_path / 'history.sqlite'}")
    session = writable_copy(AF, tmp_path / "sessions" / "one")
    software = _results(lambda document: document["provenance"].update(software="inertial-bench 0.0.1"))
    software(session)
    assert inside("archive", "add", str(session)).returncode == ExitStatus.PASS
    assert inside("archive", "verify").returncode == ExitStatus.PASS  # other software is no damage by itself
    _results(_alter)(session)
    assert inside("archive", "add", str(session)).returncode == ExitStatus.PASS
    done = inside("archive", "verify")
    assert done.returncode == ExitStatus.SESSION_DAMAGED
    assert "B-ARC-008" in done.stdout
    assert "inertial-bench 0.0.1" in done.stdout
    assert "B-ARC-008" in inside("archive", "add", str(session)).stdout
    shutil.copy(AF / RESULTS, session)
    assert inside("archive", "add", str(session)).returncode == ExitStatus.PASS


def test_what_was_archived_and_is_shorter_says_so_everywhere(
    inside: Inside, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the index knows the recording, a cut of its last bytes is no damage of its summary."""
    monkeypatch.setenv("BENCH_HISTORY", f"sqlite:///{tmp_path / 'history.sqlite'}")
    session = writable_copy(AF, tmp_path / "sessions" / "one")
    (session / RESULTS).unlink()
    assert inside("archive", "add", str(session)).returncode == ExitStatus.PASS
    for cut in (_bytes(lambda raw: raw[:-3000]), CUT):
        cut(session)
        for _ in range(2):
            for command in (("add", str(session)), ("verify",)):
                said = inside("archive", *command).stdout
                assert "B-ARC-004" in said
                assert "shorter than what was archived" in said
    done = inside("archive", "refit", "--to", str(tmp_path / "trial"))
    assert "B-ARC-004" in done.stdout


def test_results_without_provenance_are_an_input_error_of_replay(inside: Inside, tmp_path: Path) -> None:
    session = writable_copy(AF, tmp_path / "one")
    _results(lambda document: document.update(provenance=""))(session)
    done = inside("replay", str(session))
    assert (done.returncode, "error B-CLI-010" in done.stderr) == (ExitStatus.BAD_INPUT, True)
    assert "no document of results" in done.stderr
