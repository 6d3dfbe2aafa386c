"""``bench history`` from the command line: what it says, its exit statuses, its one JSON document."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bench import cli
from bench.model.errors import ExitStatus
from bench.record import SessionReader
from bench.report.plots.history import MOST_PANELS
from bench.store import Filters, list_calibrations, record_calibration

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden" / "sessions" / "0.1.0" / "20000101T000000Z_golden_GOLDEN"
Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Say:
    """Run ``bench history`` in this process: exit status, standard output, standard error."""
    monkeypatch.delenv("BENCH_HISTORY", raising=False)

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["bench", "history", *words])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return int(caught.value.code or 0), said.out, said.err

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
        text = json.dumps(
            document | {"session": f"20{10 + number // 4}{1 + number % 4 * 3:02d}01T000000Z_golden_GOLDEN"}
        )
        copy: dict[str, Any] = json.loads(text)
        copy["provenance"] |= {"session_sha256": f"{number:064x}", "simulated": simulated}
        for estimate in copy["estimates"]:
            estimate["value"] += estimate["std_uncertainty"] * (0.1 * number + 0.3 * (-1) ** number)
        record_calibration(url, copy, manifest | {"simulated": simulated}, None)
    return url


def test_import_show_and_list(say: Say, session: Path) -> None:
    assert say("import", str(session)) == (0, f"new        {GOLDEN.name}, revision 1\n", "")
    assert say("import", str(session))[1].startswith("unchanged")
    out = str(session.parent)
    status, text, _ = say("list", "--out", out)
    assert status == 0
    assert "(SIMULATED)" in text
    assert "NGU GOLDEN" in text
    status, text, _ = say("show", str(session))
    assert "first results" in text
    assert "5720A" in text
    document = json.loads(say("show", str(session), "--json")[1])
    assert document["estimates"] == json.loads((session / "results.json").read_text())["estimates"]
    assert json.loads(say("list", "--out", out, "--uut", "GOLDEN", "--json")[1])["calibrations"][0]["revision"] == 1


def test_a_changed_report_is_a_revision_and_needs_its_own_approval(say: Say, session: Path) -> None:
    say("import", str(session))
    approve = ("approve", str(session), "--by", "A. Meyer", "--statement", "released")
    assert say(*approve)[1].endswith("revision 1 approved by A. Meyer\n")
    (session / "report.html").write_text("<html>second</html>")
    assert "bench history import" in refused(say(*approve), "B-STORE-010")
    assert "revision 2" in say("import", str(session), "--reason", "figure corrected")[1]
    assert json.loads(say(*approve, "--json")[1])["revision"] == 2
    text = say("show", str(session))[1]
    assert text.count("approved by A. Meyer") == 2
    assert "figure corrected" in text


def test_a_lost_results_file_is_computed_again(say: Say, session: Path) -> None:
    stored = json.loads((session / "results.json").read_text())
    (session / "results.json").unlink()
    assert say("import", str(session))[0] == 0
    document = json.loads(say("show", GOLDEN.name, "--out", str(session.parent), "--json")[1])
    assert [one["value"] for one in document["estimates"]] == pytest.approx(
        [one["value"] for one in stored["estimates"]]
    )


def test_import_of_everything_in_the_folder(say: Say, session: Path) -> None:
    """What the shell makes of sessions/*: the history, truth beside a session, a recording without an analysis."""
    (session.parent / "history.sqlite").write_bytes(b"")
    (session.parent / f"{session.name}.truth.json").write_text("{}")
    status, text, complaint = say("import", *sorted(str(path) for path in session.parent.iterdir()))
    assert (status, text) == (0, f"new        {GOLDEN.name}, revision 1\n")
    assert complaint.count("skipped") == 2
    refused(say("import", str(session.parent / "history.sqlite")), "B-REC-010")


def test_list_tells_calibrations_of_one_name_apart(say: Say, session: Path) -> None:
    say("import", str(session))
    text = say("list", "--out", str(session.parent))[1]
    sha256 = json.loads((session / "results.json").read_text())["provenance"]["session_sha256"]
    assert sha256[:8] in text
    assert all(head in text for head in ("campaign", "verdict", "revision", "approved by"))


def test_import_refuses_what_does_not_belong_together(say: Say, session: Path, tmp_path: Path) -> None:
    results = session / "results.json"
    good = results.read_text()
    results.write_text(good.replace(json.loads(good)["provenance"]["session_sha256"], "0" * 64))
    refused(say("import", str(session)), "B-STORE-013", 2)
    results.write_text("{")
    refused(say("import", str(session)), "B-FIT-010", 2)
    results.write_text(good)
    empty = tmp_path / "empty"
    empty.mkdir()
    status, text, complaint = say("import", str(empty), str(session))  # the good one is added all the same
    assert (status, text.startswith("new")) == (2, True)
    assert "B-REC-010" in complaint
    segment = session / "session.0001.mcap"
    whole = segment.read_bytes()
    results.unlink()
    segment.write_bytes(whole[: len(whole) // 2])  # as after a loss of power
    assert "did not finish" in refused(say("import", str(session)), "B-STORE-013", 2)
    segment.write_bytes(whole[:-5000])
    refused(say("import", str(session)), "B-REC-011", 5)


def test_compare_draws_and_says_when_the_next_is_due(say: Say, session: Path, tmp_path: Path) -> None:
    url = with_drift(session, 12)
    for name in ("drift.svg", "drift.png"):
        status, text, _ = say("compare", "--history", url, "--plot", str(tmp_path / "plots" / name))
        assert status == 0
        assert "next due" in text
    drawn = (tmp_path / "plots" / "drift.svg").read_text(encoding="utf-8")
    assert "SIMULATED" in drawn
    assert drawn.count("Year") == min(MOST_PANELS, len(list_panels(say, url)))
    say("compare", "--history", url, "--plot", str(tmp_path / "again.svg"))
    assert (tmp_path / "again.svg").read_text(encoding="utf-8") == drawn
    assert (tmp_path / "plots" / "drift.png").read_bytes().startswith(b"\x89PNG")
    refused(say("compare", "--history", url, "--plot", str(tmp_path / "drift.doc")), "B-CLI-007")


def list_panels(say: Say, url: str) -> list[Any]:
    found: list[Any] = json.loads(say("compare", "--history", url, "--json")[1])["parameters"]
    return found


def test_compare_as_json(say: Say, session: Path) -> None:
    url = with_drift(session, 12)
    rows = {one["quantity"]: one for one in list_panels(say, url) if one["conditions"].get("channel") == 1}
    one = rows["dsf_n"]
    assert one["calibrations"] == 12
    assert one["rate_per_year"] > 0.0
    assert one["change_limit"] == 100.0
    assert one["control_limits_3_sigma"][1] > one["control_limits_2_sigma"][1] > 0.0
    names = [row["session"] for row in list_calibrations(url, Filters())]
    pair = json.loads(say("compare", names[0], names[5], "--history", url, "--json")[1])
    assert pair["sessions"] == [names[0], names[5]]
    assert "|E_n| > 1" in say("compare", names[0], names[5], "--history", url)[1]
    refused(say("compare", names[0], "--history", url), "B-CLI-011")


def test_due_is_exit_status_1_when_overdue(say: Say, session: Path) -> None:
    url = with_drift(session, 4, simulated=False)  # the last in 2010
    status, text, _ = say("due", "--history", url)
    assert status == ExitStatus.VERDICT_FAIL
    assert "OVERDUE" in text
    found = json.loads(say("due", "--history", url, "--json")[1])["due"]
    assert [one["overdue"] for one in found] == [True]
    later = json.loads((session / "results.json").read_text()) | {"session": "21990101T000000Z_x_GOLDEN"}
    later["provenance"] |= {"session_sha256": "f" * 64, "simulated": False}
    record_calibration(url, later, SessionReader(session).manifest | {"simulated": False}, None)
    assert say("due", "--history", url)[0] == 0


def test_a_simulated_calibration_is_never_overdue(say: Say, session: Path) -> None:
    status, text, _ = say("due", "--history", with_drift(session, 2))
    assert status == 0
    assert "OVERDUE" not in text
    assert "(SIMULATED)" in text


def test_export(say: Say, session: Path, tmp_path: Path) -> None:
    url = with_drift(session, 2)
    assert "estimates written to" in say("export", str(tmp_path / "x.csv"), "--history", url)[1]
    rows = json.loads(say("export", str(tmp_path / "y.csv"), "--history", url, "--json")[1])["rows"]
    assert len((tmp_path / "y.csv").read_text().splitlines()) == rows + 1
    refused(say("export", "/proc/none/x.csv", "--history", url), "B-CLI-007")


def test_words_that_name_nothing(say: Say, session: Path, tmp_path: Path) -> None:
    refused(say("list", "--out", str(tmp_path / "nowhere")), "B-STORE-007")
    url = with_drift(session, 1)
    assert "GOLDEN" in refused(say("list", "--uut", "GOLDEM", "--history", url), "B-STORE-009")
    refused(say("list", "--nonsense"), "B-CLI-011")


def test_the_environment_names_the_history(say: Say, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BENCH_HISTORY", with_drift(session, 1))
    assert say("list")[0] == 0


@pytest.mark.parametrize("command", ["list", "show", "compare", "due", "export", "import", "approve"])
def test_every_help_shows_an_example(command: str, say: Say) -> None:
    status, text, _ = say(command, "--help")
    assert status == 0
    assert f"bench history {command}" in text.split("Example")[1]
