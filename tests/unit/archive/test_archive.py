"""Archived sessions: found on any file system and looked at, a refit that anything may stop, and what would change."""

import json
import os
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest
from away_store import Away, NoAnswer
from rehearsal import writable_copy

from bench.archive.changes import change_in_u, changes_of, is_changed, is_flip
from bench.archive.index import Examination, examined
from bench.archive.journal import HEAD, JOURNAL, TrialJournal
from bench.archive.page import changes_html
from bench.archive.places import Finding, Kind, Place, StorageError, brought_here, list_places
from bench.archive.refit import rows_of
from bench.archive.work import attempted
from bench.model.errors import ExitStatus, InputError
from bench.record import SessionReader
from bench.store import ArchivedSession, StoredTrial, Trial, Unit, selection_of

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "sessions" / "0.1.0"
AF, RLG = GOLDEN / "20000101T000000Z_golden_GOLDEN", GOLDEN / "20000101T000000Z_golden_rlg_GOLDEN"


@pytest.fixture
def memory() -> Iterator[str]:
    """The golden sessions in a store that is no file system of this machine; URL of its folder."""
    storage = fsspec.filesystem("memory")
    storage.put(str(GOLDEN), "/lab/2000", recursive=True)
    yield "memory://lab"
    storage.rm("/lab", recursive=True)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return writable_copy(AF, tmp_path / "sessions" / AF.name)


def sessions_at(url: str) -> list[Place]:
    return [place for place in list_places(url) if isinstance(place, Place)]


def looked_at(place: Place) -> Finding:
    return examined(Examination(place.location))


def session_at(place: Place) -> ArchivedSession:
    session = looked_at(place).session
    assert session is not None
    return session


def name_of(place: Place) -> str:
    return Path(place.location).name


def only(folder: Path) -> Place:
    (place,) = sessions_at(str(folder))
    return place


def test_sessions_of_a_store_are_those_of_the_folder(memory: str) -> None:
    here, there = sessions_at(str(GOLDEN)), sessions_at(memory)
    assert [name_of(place) for place in here] == sorted(path.name for path in GOLDEN.iterdir())
    assert [name_of(place) for place in there] == [name_of(place) for place in here]
    assert [place.bytes for place in there] == [place.bytes for place in here]
    assert there[0].location == f"memory://lab/2000/{name_of(here[0])}".replace("memory://", "memory:///")


def test_a_session_of_a_store_is_copied_here_and_gone_afterwards(memory: str) -> None:
    place = next(place for place in sessions_at(memory) if name_of(place) == AF.name)
    with brought_here(place.location) as (folder, now):
        assert now == place
        assert SessionReader(folder, strict=True).sha256 == SessionReader(AF).sha256
        assert (folder / "results.json").read_bytes() == (AF / "results.json").read_bytes()
    assert not folder.exists()


def test_a_session_of_this_machine_is_read_where_it_is(session: Path) -> None:
    with brought_here(str(session)) as (folder, _):
        assert folder == session
    assert session.is_dir()


@pytest.mark.parametrize("url", ["/no/such/folder", "nothing://x/y", "memory://empty", __file__])
def test_what_cannot_be_listed_b_arc_002(url: str) -> None:
    with pytest.raises(InputError) as caught:
        sessions_at(url)
    assert (caught.value.code, caught.value.exit_status) == ("B-ARC-002", ExitStatus.BAD_INPUT)
    assert caught.value.where == url
    assert caught.value.next_step


@pytest.fixture
def away(memory: str, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """The golden sessions in a store, and what makes it fail; URL away://lab."""
    return lambda call: monkeypatch.setattr(Away, "fails", call)


def test_a_store_that_raises_errors_of_its_own_is_one_that_cannot_be_read_now(away: Callable[[str], None]) -> None:
    place = next(place for place in sessions_at("away://lab") if name_of(place) == AF.name)
    for call in ("ls", "get_file"):
        away(call)
        with pytest.raises(StorageError, match="NoAnswer: could not connect to the endpoint"):
            looked_at(place)
        task, seen, wrong = attempted(looked_at, place)
        assert (task, seen) == (place, None)
        assert "NoAnswer: could not connect to the endpoint" in wrong
    away("ls")
    (finding,) = list_places("away://lab")
    assert isinstance(finding, Finding)
    assert (finding.location, finding.kind, finding.code) == ("away://lab", Kind.UNREADABLE, "B-ARC-007")
    away("")
    assert looked_at(place).code == ""


def test_a_store_that_cannot_be_reached_at_all_is_not_an_archived_session_that_is_damaged(
    away: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    place = next(place for place in sessions_at("away://lab") if name_of(place) == AF.name)
    for error in (NoAnswer("no route"), OSError("no route")):

        def unreachable(url: str, error: Exception = error) -> Any:
            raise error

        monkeypatch.setattr(fsspec.core, "url_to_fs", unreachable)
        with pytest.raises(OSError, match="no route"):
            looked_at(place)
        (finding,) = list_places("away://lab")
        assert isinstance(finding, Finding)
        assert "no route" in finding.reason


def test_an_error_of_whoever_reads_a_session_is_no_error_of_the_storage(memory: str) -> None:
    place = next(place for place in sessions_at(memory) if name_of(place) == AF.name)
    with pytest.raises(NoAnswer), brought_here(place.location):
        raise NoAnswer


def test_the_fingerprint_is_that_of_what_is_read(session: Path) -> None:
    before = only(session).fingerprint
    (session / "report.html").write_text("no number comes from it")
    assert only(session).fingerprint == before
    os.utime(session / "results.json", (1, 1))
    assert only(session).fingerprint != before


def test_what_a_session_says_of_itself(session: Path) -> None:
    seen = session_at(only(session))
    assert (seen.code, seen.fault) == ("", "")
    assert seen.session_sha256 == SessionReader(AF).sha256
    assert (seen.campaign, seen.station, seen.method) == ("scale_factor", "af_bench_sim", "gls")
    assert (seen.simulated, seen.quality, seen.verdict) == (True, "sound", "none")
    assert seen.units == (Unit("NGU", "GOLDEN"),)
    assert seen.started_utc_ns == 946_684_800 * 10**9
    assert ("calibrator", "5720A", "SIM5720", "SIM-0001") in [tuple(vars(used).values()) for used in seen.standards]


@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (lambda folder: _cut(folder / "session.0001.mcap", -4000), "B-REC-011"),
        (lambda folder: _cut(folder / "session.0001.mcap", 60_000), "B-ARC-004"),  # as after a loss of power
        (lambda folder: (folder / "results.json").write_text("{"), "B-FIT-010"),
        (lambda folder: shutil.copy(RLG / "results.json", folder), "B-STORE-013"),
    ],
)  # fmt: skip
def test_damage_is_a_code(session: Path, spoil: object, code: str) -> None:
    spoil(session)  # type: ignore[operator]
    seen = session_at(only(session))
    is_whole = code in ("B-FIT-010", "B-STORE-013")  # only what was released of it is not
    assert (seen.code, seen.session_sha256 is not None) == (code, is_whole)
    assert seen.fault
    assert (seen.session, seen.campaign) == (AF.name, "scale_factor")  # what could be read


def _cut(path: Path, length: int) -> None:
    raw = path.read_bytes()
    path.write_bytes(raw[:length])


def test_one_without_results_is_whole(session: Path) -> None:
    (session / "results.json").unlink()
    seen = session_at(only(session))
    assert (seen.code, seen.quality, seen.software) == ("", "", "")


def test_gone_or_another_recording(session: Path, tmp_path: Path) -> None:
    place = only(session)
    known = session_at(place)
    again = Examination(known.location, known.session_sha256, known.bytes, verifies=True)
    for name in ("session.0001.mcap", "results.json"):
        shutil.copy(RLG / name, session / name)
    finding = examined(again)
    assert (finding.code, finding.session and finding.session.session_sha256) == ("B-ARC-004", None)
    assert str(known.session_sha256)[:12] in finding.reason
    shutil.rmtree(session)
    assert examined(again).code == looked_at(place).code == "B-ARC-003"


NAME = {"name": "0123456789abcdef"}


def filled(folder: Path, *keys: str) -> TrialJournal:
    journal = TrialJournal(folder, NAME)
    for key in keys:
        journal.add(key, [{"session_sha256": key, "value": 1.5}])
    return journal


def test_it_goes_on_and_gives_the_sessions_in_their_order(tmp_path: Path) -> None:
    filled(tmp_path, "b", "a")
    journal = filled(tmp_path, "c")
    assert journal.done == {"a", "b", "c"}
    assert [rows[0]["session_sha256"] for rows in journal.sessions()] == ["a", "b", "c"]


@pytest.mark.parametrize("cut", range(1, 47))
def test_a_line_that_was_being_written_is_written_again(tmp_path: Path, cut: int) -> None:
    """Stopped at every byte of the last line."""
    filled(tmp_path, "b", "a")
    path = tmp_path / JOURNAL
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    journal = TrialJournal(tmp_path, NAME)
    assert journal.done == {"b"}
    journal.add("a", [{"session_sha256": "a", "value": 1.5}])
    assert path.read_bytes() == whole


def test_a_folder_of_another_refit_b_arc_006(tmp_path: Path) -> None:
    filled(tmp_path, "a")
    with pytest.raises(InputError, match=r"B-ARC-006: .*is of another refit"):
        TrialJournal(tmp_path, {"name": "f" * 16})
    (tmp_path / HEAD).write_text("{")
    with pytest.raises(InputError, match="is no head of a refit"):
        TrialJournal(tmp_path, NAME)
    assert (tmp_path / JOURNAL).read_text().count("\n") == 1


@pytest.fixture
def no_signal() -> Iterator[None]:
    """Have a write beyond the limit fail, as on a full disk, and not end the process."""
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGXFSZ, before)


def test_a_full_disk_leaves_whole_lines(tmp_path: Path, no_signal: None) -> None:
    journal = filled(tmp_path, "a")
    path = tmp_path / JOURNAL
    size = path.stat().st_size
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, before[1]))
    try:
        with pytest.raises(InputError) as caught:
            journal.add("b", [{"session_sha256": "b", "fault": "x" * 10_000}])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.code == "B-CLI-007"
    assert path.stat().st_size == size
    journal.add("b", [{"session_sha256": "b"}])
    assert [json.loads(line)["session_sha256"] for line in path.read_text().splitlines()] == ["a", "b"]


NS = 10**9


def row(sha256: str, value: float | None, verdict: str = "pass", **changes: Any) -> dict[str, Any]:
    """An estimate released as 10 +- 2."""
    made = {
        "session_sha256": sha256, "uut_model": "NGU", "uut_serial": "1", "quantity": "dsf_n", "unit": "ppm",
        "conditions": {"channel": 1}, "value": value, "expanded_uncertainty": None if value is None else 2.0,
        "verdict": verdict, "quality": "sound", "method": "gls", "released_value": 10.0,
        "released_expanded_uncertainty": 2.0, "released_verdict": "pass", "released_quality": "sound",
        "released_method": "gls", "released_software": "bench 1", "code": "", "fault": "",
    }  # fmt: skip
    return made | changes


def certificate(number: str, sha256: str) -> dict[str, Any]:
    return {
        "number": number, "specimen": False, "customer": "A", "session": f"s-{sha256}", "issued": "2026-01-01",
        "uut_model": "NGU", "uut_serial": "1", "software": "bench 1", "method": "gls", "session_sha256": sha256,
        "replaced_by": [],
    }  # fmt: skip


def test_a_change_is_in_units_of_the_released_uncertainty() -> None:
    assert change_in_u(row("a", 13.0)) == 1.5
    assert change_in_u(row("a", None)) is None
    assert change_in_u(row("a", 13.0, released_expanded_uncertainty=None)) is None
    assert change_in_u(row("a", 13.0, released_expanded_uncertainty=0.0)) is None


def test_what_is_a_change_and_what_is_a_flip() -> None:
    assert not is_changed(row("a", 10.0 * (1 + 1e-12)))
    assert is_changed(row("a", 10.0 + 1e-7))
    assert is_changed(row("a", 10.0, expanded_uncertainty=2.1))
    assert is_changed(row("a", None))
    assert not is_changed(row("a", 0.0, released_value=0.0))
    assert not is_changed(row("a", 1e-12, released_value=0.0))  # far below its uncertainty
    assert is_flip(row("a", 10.0, "fail"))
    assert is_flip(row("a", 10.0, quality="doubtful"))
    assert is_flip(row("a", None, "", quality=""))  # gone
    assert not is_flip(row("a", 10.0, "fail", released_quality="", released_verdict=""))  # new
    assert not is_flip(row("a", None, "", quality="", code="B-FIT-009"))


def test_the_report_counts_what_it_should() -> None:
    rows = [
        row("a", 10.0),
        row("b", 13.0),
        row("b", 9.0, "fail", quantity="bias"),
        row("c", None, "", quality="", quantity="", code="B-PKG-005", fault="not installed", released_quality=""),
        row("d", 10.0),
    ]
    trial = Trial("t" * 16, "bench 2", "", {}, {}, 4)
    certificates = [certificate(f"N-{name}", name) for name in "abcd"]
    sessions = {name: {"session": f"s-{name}", "campaign": "scale_factor", "simulated": False} for name in "abcd"}
    report = changes_of(StoredTrial(trial, "done", "2026", rows, certificates), sessions, [])
    bias, dsf_n = report.quantities
    assert (dsf_n.compared, dsf_n.changed, dsf_n.above_one) == (3, 1, 1)
    assert dsf_n.percentiles == pytest.approx((0.0, 0.0, 0.0, 1.35, 1.5))  # linear between the ranks
    assert (bias.compared, bias.percentiles[2]) == (1, -0.5)
    assert [(flip.session, flip.quantity, flip.verdict) for flip in report.flips] == [("s-b", "bias", "fail")]
    assert [(entry.number, entry.code, entry.largest) for entry in report.certificates] == [
        ("N-c", "B-PKG-005", None),
        ("N-b", "", 1.5),
    ]
    assert report.failed == {"B-PKG-005": 1}
    page = changes_html(report, "en")
    assert page == changes_html(report, "en")
    assert page.index("N-c") < page.index("N-b")
    assert all(text in page for text in ("not installed", "decided by people", "+1.500", "bench 1 → bench 2"))
    assert "사람이 결정합니다" in changes_html(report, "ko")
    assert report.certificates[1].released_software == "bench 1"


def results(*estimates: tuple[str, int, float], method: str = "gls") -> dict[str, Any]:
    entries = [
        {
            "quantity": quantity, "unit": "ppm", "value": value, "std_uncertainty": 1.0, "coverage_factor": 2.0,
            "expanded_uncertainty": 2.0, "n": 3, "dropped": 0, "limit": None, "verdict": "none", "quality": "sound",
            "conditions": {"channel": channel, "unit_temperature_degC": 23.0 + value},
        }
        for quantity, channel, value in estimates
    ]  # fmt: skip
    return {
        "session": "s", "method": method, "uut": {"model": "NGU", "serial": "1"}, "estimates": entries,
        "provenance": {"software": "bench 1", "session_sha256": "a"},
    }  # fmt: skip


def test_rows_meet_by_quantity_and_conditions_without_what_was_measured() -> None:
    released, now = results(("dsf_n", 1, 1.0), ("dsf_p", 1, 2.0)), results(("dsf_n", 2, 5.0), ("dsf_n", 1, 1.5))
    rows = list(rows_of(released, now, {"campaign": {}}))
    said = [(entry["quantity"], entry["conditions"], entry.get("released_value"), entry.get("value")) for entry in rows]
    assert said == [
        ("dsf_n", '{"channel": 1}', 1.0, 1.5),
        ("dsf_p", '{"channel": 1}', 2.0, None),
        ("dsf_n", '{"channel": 2}', None, 5.0),
    ]
    assert rows[1]["quality"] == rows[2]["released_quality"] == ""


def test_two_estimates_of_one_name_stay_two() -> None:
    twice = results(("dsf_n", 1, 1.0), ("dsf_n", 1, 2.0))
    assert [entry["value"] for entry in rows_of(twice, twice, {"campaign": {}})] == [1.0, 2.0]


def test_selections() -> None:
    selection = selection_of(["uut=U-1", "since=2001-01-01", "until=2001-01-31"])
    assert selection.uut == "U-1"
    assert selection.since_utc_ns == 978_307_200 * NS
    assert selection.until_utc_ns == (978_307_200 + 31 * 86_400) * NS  # that day is among them


@pytest.mark.parametrize("words", [["bench=1"], ["uut"], ["uut="], ["uut=1", "uut=2"], ["since=yesterday"]])
def test_what_selects_nothing_b_arc_001(words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        selection_of(words)
    assert caught.value.code == "B-ARC-001"
    assert caught.value.next_step
