"""Sessions are found on any file system, looked at byte by byte, and told apart from what is not theirs."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest
from away_store import Away, NoAnswer
from rehearsal import writable_copy

from bench.archive.examination import Examination, examined
from bench.archive.places import Finding, Kind, Place, StorageError, brought_here, list_places
from bench.archive.work import attempted
from bench.model.errors import ExitStatus, InputError
from bench.record import SessionReader
from bench.store import ArchivedSession, Unit

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
