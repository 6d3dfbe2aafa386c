"""``bench batch``: which sessions are found, what is left out and why, and the exit status."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from report_sample import LIMIT, coupling, results

from bench.commands import batch as command
from bench.model.errors import BenchError, ExitStatus, FitError, InputError

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "sessions" / "0.1.0" / "20000101T000000Z_golden_GOLDEN"


def made(folder: Path, *names: str) -> Path:
    """Folders that look like sessions."""
    for name in names:
        (folder / name).mkdir(parents=True)
        (folder / name / "session.0001.mcap").write_bytes(b"")
    return folder


def test_a_folder_of_sessions_a_session_and_a_pattern(tmp_path: Path) -> None:
    made(tmp_path, "b", "a", "c2")
    (tmp_path / "history.sqlite").write_bytes(b"")
    (tmp_path / "batch").mkdir()
    assert [one.name for one in command.session_folders(tmp_path)] == ["a", "b", "c2"]
    assert command.session_folders(tmp_path / "b") == [tmp_path / "b"]
    assert [one.name for one in command.session_folders(tmp_path / "[ab]")] == ["a", "b"]


@pytest.mark.parametrize("name", ["nowhere", "empty", "*.none"])
def test_what_holds_no_session_is_a_mistake(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="B-CLI-013: "):
        command.batch([tmp_path / name], tmp_path / "out", as_json=False)
    assert not (tmp_path / "out").exists()


Session = dict[str, Any] | BenchError | None


def run(
    monkeypatch: pytest.MonkeyPatch, folder: Path, sessions: dict[str, Session], broken: tuple[str, ...] = ()
) -> tuple[int, dict[str, Any]]:
    """Exit status and document; a session is its results, the error of its analysis, or None for no analysis."""

    def read_view(one: Path) -> Any:
        if one.name in broken:
            raise BenchError("B-REC-012", "no manifest", where=str(one))
        manifest = {"simulated": True, "campaign": {"uut": {"model": "GNC", "serial": one.name}, "analysis": "x"}}
        analysed = sessions[one.name] is not None
        return SimpleNamespace(name=one.name, manifest=manifest, damaged=False, has_analysis=analysed, notes=[])

    def analyse_view(view: Any) -> tuple[Any, SimpleNamespace]:
        found = sessions[view.name]
        if isinstance(found, BenchError):
            raise found
        return found, SimpleNamespace(missing=[])

    monkeypatch.setattr(command, "read_view", read_view)
    monkeypatch.setattr(command, "analyse_view", analyse_view)
    status = command.batch([made(folder / "in", *sessions)], folder / "out", as_json=False)
    return status, json.loads((folder / "out" / "batch.json").read_text())


def good(name: str) -> dict[str, Any]:
    return results(name, name, [coupling(0.1 * LIMIT)])


BAD = results("b", "b", [coupling(3 * LIMIT), coupling(0.0, "y")])
NONE = FitError("B-FIT-005", "one polarity")
CASES: list[tuple[dict[str, Session], tuple[str, ...], int, list[str], tuple[int, int, int]]] = [
    ({name: good(name) for name in "abc"}, (), ExitStatus.PASS, [], (3, 0, 0)),
    ({"a": good("a"), "b": BAD}, (), ExitStatus.VERDICT_FAIL, [], (1, 1, 0)),
    ({"a": good("a"), "b": NONE}, (), ExitStatus.VERDICT_FAIL, ["B-FIT-005"], (1, 0, 1)),
    ({"a": good("a"), "b": BAD, "c": good("c")}, ("c",), ExitStatus.SESSION_DAMAGED, ["B-REC-012"], (1, 1, 0)),
    ({"a": good("a"), "b": None}, (), ExitStatus.PASS, ["B-CLI-008"], (1, 0, 0)),
]


@pytest.mark.parametrize(("sessions", "broken", "status", "left_out", "counts"), CASES)
def test_each_session_counts_or_is_listed_with_its_reason(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    sessions: dict[str, Session],
    broken: tuple[str, ...],
    status: int,
    left_out: list[str],
    counts: tuple[int, int, int],
) -> None:
    """All pass; one fails; one determines nothing; one cannot be read; one has no analysis, which costs nothing."""
    found, document = run(monkeypatch, tmp_path, sessions, broken)
    assert found == status
    assert [one["code"] for one in document["left_out"]] == left_out
    units = document["yield"]["units"]
    assert (units["pass"], units["fail"], units["without_verdict"]) == counts
    said = capsys.readouterr().out
    assert ("b: 1 of 2 judged failed" in said) is (counts[1] == 1)
    if counts[0] == 3:
        assert units["interval_95"] == [pytest.approx(0.2924, abs=1e-4), 1.0]
        assert "3 units in 3 sessions: 3 pass" in said


def copied(folder: Path, damage: Callable[[bytearray], object] = lambda content: None) -> Path:
    shutil.copytree(GOLDEN, folder)
    content = bytearray((folder / "session.0001.mcap").read_bytes())
    damage(content)
    (folder / "session.0001.mcap").write_bytes(content)
    return folder


def flip(content: bytearray) -> None:
    content[len(content) // 2] ^= 0xFF


def cut(content: bytearray) -> None:
    del content[-20_000:]


def test_sessions_as_they_are_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three of one name: one whole, one with a false byte, one that ends in the middle of a run."""
    sessions = [
        copied(tmp_path / "first" / "session"),
        copied(tmp_path / "second" / "session", flip),
        copied(tmp_path / "third" / "session", cut),
    ]
    status = command.batch(sessions, tmp_path / "out", as_json=True)
    document = json.loads(capsys.readouterr().out)
    assert status == ExitStatus.SESSION_DAMAGED
    assert document == json.loads((tmp_path / "out" / "batch.json").read_text())
    assert {one["session"] for one in document["left_out"]} >= {"second/session"}
    assert [one["verdict"] for one in document["parts"] if one["session"] == "third/session"] == ["no_result"]
    stored = json.loads((GOLDEN / "results.json").read_text())
    due = [one["value"] for one in stored["estimates"] if one["quantity"] == "dsf_n"]
    spreads = [one for one in document["quantities"] if one["quantity"] == "dsf_n"]
    found = {one[end]["value"] for one in spreads for end in ("min", "max") if one[end]["session"] == "first/session"}
    assert found
    assert all(any(value == pytest.approx(other, rel=1e-9) for other in due) for value in found)
