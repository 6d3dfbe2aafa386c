"""Results that are kept, runs without any, certificates held against their source; documents of an unknown form."""

import json
import os
import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from dcc_sample import calibration, estimate
from rehearsal import Inside, record_golden

from bench.analysis import results_json
from bench.commands import conducting
from bench.commands.verify import check_certificates
from bench.model.errors import ExitStatus, FitError, InputError
from bench.model.events import Resume
from bench.model.lab import cache_folder
from bench.record import SessionReader, SessionWriter, resume_session
from bench.report import certificate_text
from bench.run.guard.last_words import guard_lines
from bench.session import shelf
from bench.session.acceptances import known_acceptances
from bench.session.fitted import FROM_CACHE, Fitted
from bench.session.shelf import Shelf, key_of
from bench.session.verification import Verification

Words = tuple[str, ...]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for each test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return cache_folder() / "results"


def kept(session: Path, method: str | None = None) -> bool:
    """Return whether the results of a session are there."""
    return Fitted(session, method).from_cache


def flip_a_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_the_same_session_is_computed_once(session: Path, inside: Inside, monkeypatch: pytest.MonkeyPatch) -> None:
    first, first_json = inside("fit", str(session)), inside("fit", str(session), "--json", "--fresh")
    monkeypatch.setattr("bench.session.service.analysed", None)
    again, again_json = inside("fit", str(session)), inside("fit", str(session), "--json")
    assert FROM_CACHE not in first.stdout
    assert again.stdout == f"{first.stdout}{FROM_CACHE}\n"
    assert again_json.stdout == first_json.stdout == (session / "results.json").read_text()
    assert again_json.stderr == f"{FROM_CACHE}\n"
    assert first.returncode == again.returncode == again_json.returncode == 0


def test_the_end_of_a_run_keeps_what_it_computed(tmp_path: Path, inside: Inside, cache: Path) -> None:
    record_golden(tmp_path / "out")
    session = next(path.parent for path in (tmp_path / "out").glob("*/results.json"))
    page, results = (session / "report.html").read_bytes(), (session / "results.json").read_text()
    assert FROM_CACHE in inside("report", str(session)).stdout
    assert (session / "report.html").read_bytes() == page
    again = Fitted(session, fresh=True)
    shown = Fitted(session).shown
    assert results_json(shown.results) == results_json(again.shown.results) == results
    assert shown.remarks == again.shown.remarks
    assert again.report.html().encode() == page


def test_another_method_is_another_result(session: Path) -> None:
    assert Fitted(session, "ols").shown.analysis.method == "ols"
    assert not kept(session)
    assert kept(session, "ols")


def test_a_session_that_was_gone_on_with_is_another_one(session: Path) -> None:
    assert Fitted(session).shown
    writer = resume_session(session, Resume(start=0, reason="power"), t_mono_ns=10**15)
    assert key_of([session], {}) is None  # being recorded
    writer.close("done")
    assert not kept(session)


def test_a_segment_without_an_end_is_not_kept(session: Path) -> None:
    path = session / "session.0001.mcap"
    path.write_bytes(path.read_bytes()[:-100])
    assert key_of([session], {}) is None
    assert Fitted(session).shown.remarks
    assert not kept(session)


def test_a_flipped_byte_is_noticed_although_the_time_of_the_file_was_put_back(session: Path) -> None:
    assert Fitted(session).shown
    path = session / "session.0001.mcap"
    before = path.stat()
    flip_a_byte(path)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (path.stat().st_mtime_ns, path.stat().st_size) == (before.st_mtime_ns, before.st_size)
    fitted = Fitted(session)
    assert not fitted.from_cache  # the system notes the change of a file by itself
    assert fitted.shown.damaged
    assert not kept(session)  # what is damaged is told each time


def test_a_damaged_or_foreign_file_counts_as_not_there(session: Path, cache: Path) -> None:
    fitted = Fitted(session)
    assert fitted.report
    key = key_of([session], {"method": None})
    for path in cache.iterdir():
        flip_a_byte(path)
    assert not kept(session)
    assert Fitted(session).report
    other = Shelf("0" * 64)
    other.put("shown", [1])
    assert other.get("shown") == [1]
    (cache / f"{'0' * 64}.shown").replace(cache / f"{key}.shown")
    assert not kept(session)


def test_other_software_computes_anew(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert Fitted(session).shown
    monkeypatch.setattr(shelf, "_software", lambda: ("0.1.0", "a changed source"))
    assert not kept(session)


class Trap:
    """A pickle that does something when it is read."""

    def __reduce__(self) -> tuple[object, Words]:
        return os.mkdir, ("trap",)


def test_reading_a_file_does_nothing(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mine = Shelf("1" * 64)
    mine.put("shown", Trap())
    assert list(cache.iterdir())
    assert mine.get("shown") is None
    assert not (tmp_path / "trap").exists()
    mine.put("shown", {"plain": pickle.dumps(1)})
    assert mine.get("shown") is not None
    cache.chmod(0o777)
    assert mine.get("shown") is None  # anybody may have written it


def test_no_room_for_a_cache_is_no_trouble(session: Path, tmp_path: Path, inside: Inside) -> None:
    (tmp_path / "cache").write_text("a file where the folder should be")
    for _ in range(2):
        done = inside("fit", str(session))
        assert done.returncode == 0
        assert FROM_CACHE not in done.stdout


def test_the_oldest_make_room(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shelf, "MOST_BYTES", 2500)
    for number in range(4):
        Shelf(f"{number}").put("shown", bytes(1000))
        os.utime(cache / f"{number}.shown", (number, number))
    assert sorted(path.name for path in cache.iterdir()) == ["2.shown", "3.shown"]


FOLDER = Path("sessions/S")


def no_result(*_: object) -> None:
    raise FitError("B-FIT-005", "K_N is not determined", where="channel 1 at 23 degC", next_step="take them again")


def test_a_run_without_a_result_names_the_session_and_what_is_left_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(conducting, "finish", no_result)
    view: Any = SimpleNamespace(events=[], events_of=lambda model: [], has_analysis=True, manifest={})
    status = conducting.tell_results(view, FOLDER, "", as_json=False)
    said = capsys.readouterr()
    assert status == ExitStatus.VERDICT_FAIL
    assert "B-FIT-005" in said.err
    assert "'bench recover sessions/S'" in said.out


NAME = "certificate.specimen.xml"


@pytest.mark.parametrize("value", [3.5, 3.6])
def test_conditions_of_an_analysis_in_an_order_that_is_not_that_of_the_file(tmp_path: Path, value: float) -> None:
    conditions = {"temperature_degC": 50.0, "channel": 1, "repeat": 1, "kind": "gyro"}
    made = calibration(estimates=[estimate("dsf_n_drift", "ppm", 3.5, 0.9, conditions=conditions)], specimen=True)
    stored = json.loads(results_json(made.results))
    made = calibration(estimates=stored["estimates"], specimen=True)
    (tmp_path / NAME).write_text(certificate_text(made))
    today = calibration(estimates=[estimate("dsf_n_drift", "ppm", value, 0.9, conditions=conditions)], specimen=True)
    results = {**today.results, "provenance": {**today.results["provenance"], "session_sha256": "5" * 64}}
    found = Verification()
    check_certificates(found, tmp_path, today.manifest, results)
    assert found.compared == [NAME]
    assert bool(found.changes) == (value != 3.5)


OTHER = "of form 2, and this software knows form 1"
NEXT = "go on with the version of the bench that wrote it; nothing was changed"


def test_a_manifest_and_acceptances(tmp_path: Path) -> None:
    for schema in (1, 2):
        SessionWriter.create(tmp_path / str(schema), {"schema": schema}, {}, t_mono_ns=0).close("done")
        (tmp_path / str(schema) / "acceptances.json").write_text(json.dumps({"schema": schema, "more": []}))
    assert SessionReader(tmp_path / "1").manifest == {"schema": 1}
    with pytest.raises(InputError, match=f"B-REC-007: .*0001.mcap: the manifest is {OTHER}. Next: {NEXT}"):
        _ = SessionReader(tmp_path / "2").manifest
    with pytest.raises(InputError, match=f"B-ACC-004: .*acceptances.json: is {OTHER}. Next: {NEXT}"):
        known_acceptances(tmp_path / "2", "")
    with pytest.raises(InputError, match="Next: remove the file"):
        known_acceptances(tmp_path / "1", "")


@pytest.mark.parametrize("before", [[], [{"what": "act", "text": "too hot"}]])
def test_a_log_of_the_guard_confirms_nothing(tmp_path: Path, before: list[dict[str, object]]) -> None:
    entries = [*before, {"v": 2, "what": "safe", "utc": "2026-03-01T01:00:02+00:00"}]
    (tmp_path / "guard.jsonl").write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    (line,) = guard_lines(tmp_path)
    assert line.startswith(f"The guard of {tmp_path} has acted (its log is {OTHER}: {NEXT}), last heard of at 2026-03-")
    assert line.endswith(
        "NOT confirmed: any instrument; it is at it. Next: look again in a minute, until then hands off."
    )
