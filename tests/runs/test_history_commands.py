"""``bench history`` from the command line: what it says, its exit statuses, its one JSON document."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from archive_sample import sha256_of
from rehearsal import ROOT, main_of

from bench.commands.history.plots import MOST_PANELS
from bench.model.errors import ExitStatus
from bench.record import SessionReader
from bench.store import Filters, list_calibrations, record_calibration

GOLDEN = ROOT / "tests" / "golden" / "sessions" / "0.1.0" / "20000101T000000Z_golden_GOLDEN"
Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Say:
    """Run ``bench history`` in this process: exit status, standard output, standard error."""
    monkeypatch.delenv("BENCH_HISTORY", raising=False)

    def run(*words: object) -> tuple[int, str, str]:
        status = main_of(monkeypatch, "history", *map(str, words))
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return status, said.out, said.err

    return run


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session as ``bench run`` leaves it."""
    folder = tmp_path / "sessions" / GOLDEN.name
    shutil.copytree(GOLDEN, folder)
    (folder / "report.html").write_text("<html>first</html>")
    return folder


def refused(done: tuple[int, str, str], code: str, status: int = 2) -> str:
    assert done[0] == status, done[2]
    assert done[1] == ""
    assert f"error {code}: " in done[2]
    return done[2]


def with_drift(session: Path, count: int, simulated: bool = True) -> str:
    """A history of a unit that was calibrated each quarter, its results moving a little."""
    url = f"sqlite:///{session.parent / 'history.sqlite'}"
    document = json.loads((session / "results.json").read_text())
    manifest = SessionReader(session).manifest
    for number in range(count):
        name = f"20{10 + number // 4}{1 + number % 4 * 3:02d}01T000000Z_golden_GOLDEN"
        copy: dict[str, Any] = json.loads(json.dumps(document | {"session": name}))
        copy["provenance"] |= {"session_sha256": f"{number:064x}", "simulated": simulated}
        for estimate in copy["estimates"]:
            estimate["value"] += estimate["std_uncertainty"] * (0.1 * number + 0.3 * (-1) ** number)
        record_calibration(url, copy, manifest | {"simulated": simulated}, None)
    return url


def test_import_show_and_list(say: Say, session: Path) -> None:
    assert say("import", session) == (0, f"new        {GOLDEN.name}, revision 1\n", "")
    assert say("import", session)[1].startswith("unchanged")
    out = session.parent
    status, text, _ = say("list", "--out", out)
    assert status == 0
    for word in ("(SIMULATED)", "NGU GOLDEN", sha256_of(session)[:8], "campaign", "verdict", "revision", "approved by"):
        assert word in text
    status, text, _ = say("show", session)
    assert "first results" in text
    assert "5720A" in text
    document = json.loads(say("show", session, "--json")[1])
    assert document["estimates"] == json.loads((session / "results.json").read_text())["estimates"]
    assert json.loads(say("list", "--out", out, "--uut", "GOLDEN", "--json")[1])["calibrations"][0]["revision"] == 1


def test_a_changed_report_is_a_revision_and_needs_its_own_approval(say: Say, session: Path) -> None:
    say("import", session)
    approve = ("approve", session, "--by", "A. Meyer", "--statement", "released")
    assert say(*approve)[1].endswith("revision 1 approved by A. Meyer\n")
    (session / "report.html").write_text("<html>second</html>")
    assert "bench history import" in refused(say(*approve), "B-STORE-010")
    assert "revision 2" in say("import", session, "--reason", "figure corrected")[1]
    assert json.loads(say(*approve, "--json")[1])["revision"] == 2
    text = say("show", session)[1]
    assert text.count("approved by A. Meyer") == 2
    assert "figure corrected" in text


def test_a_lost_results_file_is_computed_again(say: Say, session: Path) -> None:
    stored = json.loads((session / "results.json").read_text())["estimates"]
    (session / "results.json").unlink()
    assert say("import", session)[0] == 0
    found = json.loads(say("show", GOLDEN.name, "--out", session.parent, "--json")[1])["estimates"]
    assert [one["value"] for one in found] == pytest.approx([one["value"] for one in stored])


def test_import_of_everything_in_the_folder(say: Say, session: Path) -> None:
    """What the shell makes of sessions/*: the history, truth beside a session, a recording without an analysis."""
    (session.parent / "history.sqlite").write_bytes(b"")
    (session.parent / f"{session.name}.truth.json").write_text("{}")
    status, text, complaint = say("import", *sorted(session.parent.iterdir()))
    assert (status, text) == (0, f"new        {GOLDEN.name}, revision 1\n")
    assert complaint.count("skipped") == 2
    refused(say("import", session.parent / "history.sqlite"), "B-REC-010")


def test_import_refuses_what_does_not_belong_together(say: Say, session: Path, tmp_path: Path) -> None:
    results = session / "results.json"
    good = results.read_text()
    results.write_text(good.replace(sha256_of(session), "0" * 64))
    refused(say("import", session), "B-STORE-013")
    results.write_text("{")
    refused(say("import", session), "B-FIT-010")
    results.write_text(good)
    empty = tmp_path / "empty"
    empty.mkdir()
    status, text, complaint = say("import", empty, session)  # the good one is added all the same
    assert (status, text.startswith("new"), "B-REC-010" in complaint) == (2, True, True)
    segment = session / "session.0001.mcap"
    whole = segment.read_bytes()
    results.unlink()
    segment.write_bytes(whole[: len(whole) // 2])  # as after a loss of power
    assert "did not finish" in refused(say("import", session), "B-STORE-013")
    segment.write_bytes(whole[:-5000])
    refused(say("import", session), "B-REC-011", 5)


def test_compare_draws_and_says_when_the_next_is_due(say: Say, session: Path, tmp_path: Path) -> None:
    url = with_drift(session, 12)
    for name in ("drift.svg", "drift.png", "again.svg"):
        status, text, _ = say("compare", "--history", url, "--plot", tmp_path / "plots" / name)
        assert (status, "next due" in text) == (0, True)
    plots = {path.name: path.read_bytes() for path in (tmp_path / "plots").iterdir()}
    assert b"SIMULATED" in plots["drift.svg"]
    rows = json.loads(say("compare", "--history", url, "--json")[1])["parameters"]
    assert plots["drift.svg"].count(b"Year") == min(MOST_PANELS, len(rows))
    assert plots["again.svg"] == plots["drift.svg"]
    assert plots["drift.png"].startswith(b"\x89PNG")
    refused(say("compare", "--history", url, "--plot", tmp_path / "drift.doc"), "B-CLI-007")
    one = {row["quantity"]: row for row in rows if row["conditions"].get("channel") == 1}["dsf_n"]
    assert (one["calibrations"], one["change_limit"]) == (12, 100.0)
    assert one["rate_per_year"] > 0.0
    assert one["control_limits_3_sigma"][1] > one["control_limits_2_sigma"][1] > 0.0
    names = [row["session"] for row in list_calibrations(url, Filters())]
    pair = json.loads(say("compare", names[0], names[5], "--history", url, "--json")[1])
    assert pair["sessions"] == [names[0], names[5]]
    assert "|E_n| > 1" in say("compare", names[0], names[5], "--history", url)[1]
    refused(say("compare", names[0], "--history", url), "B-CLI-011")


def test_due_is_exit_status_1_when_overdue(say: Say, session: Path) -> None:
    url = with_drift(session, 4, simulated=False)  # the last in 2010
    status, text, _ = say("due", "--history", url)
    assert (status, "OVERDUE" in text) == (ExitStatus.VERDICT_FAIL, True)
    assert [one["overdue"] for one in json.loads(say("due", "--history", url, "--json")[1])["due"]] == [True]
    later = json.loads((session / "results.json").read_text()) | {"session": "21990101T000000Z_x_GOLDEN"}
    later["provenance"] |= {"session_sha256": "f" * 64, "simulated": False}
    record_calibration(url, later, SessionReader(session).manifest | {"simulated": False}, None)
    assert say("due", "--history", url)[0] == 0


def test_a_simulated_calibration_is_never_overdue(say: Say, session: Path) -> None:
    status, text, _ = say("due", "--history", with_drift(session, 2))
    assert (status, "OVERDUE" in text, "(SIMULATED)" in text) == (0, False, True)


def test_export_and_words_that_name_nothing(
    say: Say, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = with_drift(session, 2)
    assert "estimates written to" in say("export", tmp_path / "x.csv", "--history", url)[1]
    rows = json.loads(say("export", tmp_path / "y.csv", "--history", url, "--json")[1])["rows"]
    assert len((tmp_path / "y.csv").read_text().splitlines()) == rows + 1
    refused(say("export", "/proc/none/x.csv", "--history", url), "B-CLI-007")
    refused(say("list", "--out", tmp_path / "nowhere"), "B-STORE-007")
    assert "GOLDEN" in refused(say("list", "--uut", "GOLDEM", "--history", url), "B-STORE-009")
    refused(say("list", "--nonsense"), "B-CLI-011")
    monkeypatch.setenv("BENCH_HISTORY", url)
    assert say("list")[0] == 0
