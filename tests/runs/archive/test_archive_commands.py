"""``bench archive`` and ``bench history``: what they enter, find, compute again and would change; how they end."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import archive_sample
import fsspec
import pyarrow.parquet
import pytest
from archive_sample import CUT, END_CUT, alter, gone, of_results, sha256_of
from away_store import Away
from rehearsal import ROOT, Inside, main_of

from bench.archive.evidence import NO_CHECK, evidence_of
from bench.commands.history.plots import MOST_PANELS
from bench.model.errors import ExitStatus
from bench.record import SessionReader
from bench.store import Filters, Selection, list_calibrations, list_sessions, record_calibration

GOLDEN = ROOT / "tests" / "golden" / "sessions" / "0.1.0"
LABORATORY = str(ROOT / "docs" / "laboratory.yaml")
SMALL = archive_sample.small()
_COUNTS = (
    "{megabytes} MB read; {entered} entered, {unchanged} unchanged, {damaged} damaged, 0 unreadable, 0 unfinished, "
    "0 stopped, 1 no recording, 0 link"
)
Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def say(inside: Inside, archive: Path, monkeypatch: pytest.MonkeyPatch) -> Say:
    """Run ``bench archive`` on the archive of the test: exit status, standard output and error."""
    monkeypatch.setenv("BENCH_HISTORY", f"sqlite:///{archive / 'history.sqlite'}")

    def run(*words: str) -> tuple[int, str, str]:
        done = inside("archive", *words)
        return done.returncode, done.stdout, done.stderr

    return run


def digests(folder: Path) -> dict[str, str]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != "history.sqlite")
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def document(said: tuple[int, str, str]) -> Any:
    return json.loads(said[1])


def test_what_has_not_changed_is_passed_over(say: Say, archive: Path) -> None:
    status, text, _ = say("add", str(archive))
    assert (status, text.splitlines()[-1]) == (0, _COUNTS.format(megabytes="0.0", entered=0, unchanged=11, damaged=0))
    folder = archive / SMALL[0].name
    segment = folder / "session.0001.mcap"
    segment.write_bytes(segment.read_bytes()[:-3000])
    status, text, complaint = say("add", str(archive), str(GOLDEN))
    assert status == ExitStatus.SESSION_DAMAGED
    assert f"B-ARC-004    {folder}: shorter than what was archived" in text
    golden = len(list(GOLDEN.iterdir()))
    assert f"{golden} entered, 10 unchanged, 1 damaged" in text
    assert len(complaint.splitlines()) == golden + 1
    rows = document(say("list", "--json"))["sessions"]
    assert len(rows) == 11 + golden
    assert [row["session"] for row in rows if row["code"]] == [SMALL[0].name]


def test_list_and_its_files(say: Say, tmp_path: Path) -> None:
    rows = document(say("list", "--select", "standard=CAL-b", "--json"))["sessions"]
    assert [row["session"] for row in rows] == [SMALL[-1].name]
    assert "U-3" in say("list", "--select", "station=bench_b")[1]
    written = document(say("list", "--to", str(tmp_path / "x.parquet"), "--json"))
    assert written["rows"] == len(SMALL) == pyarrow.parquet.read_table(tmp_path / "x.parquet").num_rows
    assert say("list", "--to", str(tmp_path / "x.csv"))[0] == 0
    assert (tmp_path / "x.csv").read_text().count("CAL-a C-a-2001") == 3 - 1
    assert "B-STORE-012" in say("list", "--to", "x.doc")[2]
    assert "B-STORE-009" in say("list", "--select", "uut=nobody")[2]


def test_a_store_that_is_away_for_a_while_is_told_for_each_session_and_says_nothing_of_it(
    say: Say, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BENCH_HISTORY", f"sqlite:///{tmp_path / 'away.sqlite'}")
    fsspec.filesystem("memory").put(str(GOLDEN), "/lab", recursive=True)
    count = len(list(GOLDEN.iterdir()))
    assert say("add", "away://lab")[0] == 0
    refit = ("refit", "--select", "campaign=scale_factor", "--to", str(tmp_path / "trial"))
    with monkeypatch.context() as down:
        down.setattr(Away, "fails", "ls")
        status, text, _ = say("verify")
        assert status == ExitStatus.SAFE_AFTER_FAULT
        assert text.count("B-ARC-007") == count
        assert f"0 damaged, {count} unreadable" in text
        assert "NoAnswer: could not connect to the endpoint" in text
        status, _, complaint = say(*refit)
        assert status == ExitStatus.SAFE_AFTER_FAULT
        assert "error B-ARC-007" in complaint
        status, text, _ = say("add", "away://lab", str(GOLDEN))
        assert (status, "B-ARC-007    away://lab: StorageError: NoAnswer" in text) == (3, True)
        assert f"{count} entered, 0 unchanged, 0 damaged, 1 unreadable" in text  # those of the other place
    assert say(*refit)[0] == 0
    assert {row["code"] for row in document(say("list", "--json"))["sessions"]} == {""}
    fsspec.filesystem("memory").rm("/lab", recursive=True)


def test_verify_names_what_is_damaged_changed_or_gone(say: Say, archive: Path) -> None:
    assert say("verify", "--select", "since=2001-01-01")[0] == 0
    gone, changed = archive / SMALL[-1].name, archive / SMALL[-2].name
    shutil.rmtree(gone)
    for name in ("session.0001.mcap", "results.json"):
        shutil.copy(archive / SMALL[0].name / name, changed / name)
    status, text, _ = say("verify", "--select", "since=2001-01-01", "--json")
    assert status == ExitStatus.SESSION_DAMAGED
    said = {(entry["location"], entry["code"]) for entry in json.loads(text)["rows"]}
    assert said == {(str(gone), "B-ARC-003"), (str(changed), "B-ARC-004")}
    rows = document(say("list", "--select", "standard=CAL-b", "--json"))["sessions"]  # still known by its standards
    assert rows[0]["code"] == "B-ARC-003"
    assert rows[0]["session_sha256"]


def test_an_altered_number_is_found_and_stays_known(say: Say, archive: Path) -> None:
    """The recording decides: of two copies that differ it names the one whose results it does not give."""
    session = archive / SMALL[0].name
    original = (session / "results.json").read_bytes()
    of_results(lambda document: document["provenance"].update(software="inertial-bench 0.0.1"))(session)
    assert say("add", str(session))[0] == ExitStatus.PASS
    shutil.copytree(session, archive / "copy")
    assert say("add", str(archive / "copy"))[0] == ExitStatus.PASS
    assert say("verify", "--select", "uut=U-1")[0] == ExitStatus.PASS  # other software is no damage by itself
    of_results(alter)(session)
    assert say("add", str(session))[0] == ExitStatus.PASS
    status, text, _ = say("verify", "--select", "uut=U-1")
    assert (status, text.count("B-ARC-008")) == (ExitStatus.SESSION_DAMAGED, 1)
    assert f"B-ARC-008    {session}: 1 of its results" in text
    assert "inertial-bench 0.0.1" in text
    assert "B-ARC-008" in say("add", str(session))[1]
    (session / "results.json").write_bytes(original)
    assert say("add", str(session))[0] == ExitStatus.PASS


def test_what_was_archived_and_is_shorter_says_so_everywhere(say: Say, archive: Path, tmp_path: Path) -> None:
    """Where the index knows the recording, a cut of its last bytes is no damage of its summary."""
    session = archive / SMALL[0].name
    gone("results.json")(session)
    assert say("add", str(session))[0] == ExitStatus.PASS
    for cut in (END_CUT, CUT):
        cut(session)
        for command in (("add", str(session)), ("verify", "--select", "until=2000-02-02")) * 2:
            assert "B-ARC-004" in (text := say(*command)[1])
            assert "shorter than what was archived" in text or command[0] == "add"
    assert "B-ARC-004" in say("refit", "--select", "until=2000-02-02", "--to", str(tmp_path / "trial"))[1]


def test_results_without_provenance_are_an_input_error_of_replay(archive: Path, inside: Inside) -> None:
    of_results(lambda document: document.update(provenance=""))(archive / SMALL[0].name)
    done = inside("replay", str(archive / SMALL[0].name))
    assert (done.returncode, "error B-FIT-010" in done.stderr) == (ExitStatus.BAD_INPUT, True)


def test_a_wrong_certificate_is_recalled_and_no_other(say: Say, archive: Path, inside: Inside, tmp_path: Path) -> None:
    """The whole way: certificates, another register, what changes. Nothing released is touched."""
    for campaign in (SMALL[0], *SMALL[-3:]):
        done = inside("certificate", str(archive / campaign.name), "--specimen", "--laboratory", LABORATORY)
        assert (done.returncode, done.stderr) == (0, "")
    url = f"sqlite:///{archive / 'history.sqlite'}"
    before, history = digests(archive), list_calibrations(url, Filters())
    register, trial = archive_sample.corrected(tmp_path / "corrected.yaml"), tmp_path / "trial"
    status, text, progress = say("refit", "--with-standards", str(register), "--to", str(trial))
    assert status == 0, progress
    assert "11/11" in progress
    assert (digests(archive), list_calibrations(url, Filters())) == (before, history)
    report = document(say("changes", str(trial), "--json"))
    assert {entry["session"] for entry in report["certificates"]} == archive_sample.concerned(SMALL)
    assert {entry["customer"] for entry in report["certificates"]} == {"Example Navigation Systems"}
    for entry in report["certificates"]:
        assert entry["largest"] == pytest.approx(-archive_sample.WRONG_ppm / 24.8, rel=0.05)  # ppm over U of dsf_n
        assert entry["specimen"]
    dsf_n = next(entry for entry in report["quantities"] if entry["quantity"] == "dsf_n")
    assert (dsf_n["compared"], dsf_n["changed"], dsf_n["above_one"]) == (22, 4, 4)
    (evidence,) = report["standards"]
    assert (evidence["serial"], evidence["certificate"]) == (archive_sample.CALIBRATOR, archive_sample.WRONG)
    assert evidence["session"] == SMALL[7].name  # the last before, with its check standard in control
    status, text, _ = say("changes", report["trial"][:6], "--html", str(tmp_path / "c.html"))
    assert (tmp_path / "c.html").read_text(encoding="utf-8").count("SPECIMEN-EX") >= 2
    assert "B-TXT-001" in say("changes", str(trial), "--lang", "xx")[2]
    assert "2 certificates are concerned" in text
    assert "last good evidence" in text
    assert "decided by people" in text
    assert say("where", archive_sample.WRONG)[1].count("SPECIMEN-EX") == 2


def test_a_failure_is_a_row_with_its_code(say: Say, tmp_path: Path) -> None:
    """A method that one campaign has and four have not; a certificate that nobody used; nothing selected."""
    say("add", str(GOLDEN))
    status, text, _ = say("refit", "--method", "paper", "--select", "station=af_bench_sim", "--to", str(tmp_path / "a"))
    assert status == 0, text
    status, text, _ = say("refit", "--method", "paper", "--select", "uut=GNC-01", "--to", str(tmp_path / "b"))
    assert status == ExitStatus.VERDICT_FAIL
    (row,) = pyarrow.parquet.read_table(tmp_path / "b" / "refit.parquet").to_pylist()
    assert row["code"].startswith("B-")
    assert row["code"] in text
    assert row["quantity"] == ""
    register = tmp_path / "other.yaml"
    register.write_text(archive_sample.corrected(tmp_path / "c.yaml").read_text().replace("  C-a-2001:", "  C-x:"))
    refused = say("refit", "--with-standards", str(register), "--to", str(tmp_path / "d"))
    assert refused[0] == 2
    assert "B-ARC-005" in refused[2]
    nothing = say("refit", "--select", "uut=U-1", "--select", "station=bench_b", "--to", str(tmp_path / "e"))
    assert "B-ARC-001" in nothing[2]
    assert not (tmp_path / "e").exists()


def test_a_history_that_cannot_be_written_costs_no_certificate(archive: Path, inside: Inside, tmp_path: Path) -> None:
    (tmp_path / "bad.sqlite").write_bytes(b"no database" * 1000)
    session = archive / SMALL[0].name
    done = inside("certificate", str(session), "--specimen", "--history", f"sqlite:///{tmp_path / 'bad.sqlite'}")
    assert done.returncode == 0
    assert (session / "certificate.specimen.xml").is_file()
    assert "B-STORE-004" in done.stderr
    assert "the same command enters it later" in done.stderr


def test_where_there_is_no_good_evidence_it_says_why(archive: Path) -> None:
    """A standard that nobody used before, and one that nobody used at all."""
    url = f"sqlite:///{archive / 'history.sqlite'}"
    register = {number: {"model": "5720A", "serial": "CAL-b"} for number in ("C-b-2001", "C-b-1999")}
    never, first = evidence_of(url, list_sessions(url, Selection()), register)
    assert (never.since_utc, never.session, never.why) == ("", "", NO_CHECK)
    assert (first.since_utc, first.session, first.why) == ("2001-02-21T00:00:00Z", "", NO_CHECK)


@pytest.mark.parametrize("command", ["add", "list", "verify", "where", "refit", "changes"])
def test_every_archive_help_shows_an_example(command: str, inside: Inside) -> None:
    done = inside("archive", command, "--help")
    assert done.returncode == 0
    assert f"bench archive {command}" in done.stdout.split("Example")[1]


RECORDED = ROOT / "tests" / "golden" / "sessions" / "0.1.0" / "20000101T000000Z_golden_GOLDEN"


@pytest.fixture
def ask(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Say:
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
    folder = tmp_path / "sessions" / RECORDED.name
    shutil.copytree(RECORDED, folder)
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


def test_import_show_and_list(ask: Say, session: Path) -> None:
    assert ask("import", session) == (0, f"new        {RECORDED.name}, revision 1\n", "")
    assert ask("import", session)[1].startswith("unchanged")
    out = session.parent
    status, text, _ = ask("list", "--out", out)
    assert status == 0
    words = ("(SIMULATED)", "NGU GOLDEN", sha256_of(session)[:8], "campaign", "verdict", "revision", "approved by")
    assert all(word in text for word in words), text
    status, text, _ = ask("show", session)
    assert "first results" in text
    assert "5720A" in text
    document = json.loads(ask("show", session, "--json")[1])
    assert document["estimates"] == json.loads((session / "results.json").read_text())["estimates"]
    assert json.loads(ask("list", "--out", out, "--uut", "GOLDEN", "--json")[1])["calibrations"][0]["revision"] == 1


def test_a_changed_report_is_a_revision_and_needs_its_own_approval(ask: Say, session: Path) -> None:
    ask("import", session)
    approve = ("approve", session, "--by", "A. Meyer", "--statement", "released")
    assert ask(*approve)[1].endswith("revision 1 approved by A. Meyer\n")
    (session / "report.html").write_text("<html>second</html>")
    assert "bench history import" in refused(ask(*approve), "B-STORE-010")
    assert "revision 2" in ask("import", session, "--reason", "figure corrected")[1]
    assert json.loads(ask(*approve, "--json")[1])["revision"] == 2
    text = ask("show", session)[1]
    assert text.count("approved by A. Meyer") == 2
    assert "figure corrected" in text


def test_a_lost_results_file_is_computed_again(ask: Say, session: Path) -> None:
    stored = json.loads((session / "results.json").read_text())["estimates"]
    (session / "results.json").unlink()
    assert ask("import", session)[0] == 0
    found = json.loads(ask("show", RECORDED.name, "--out", session.parent, "--json")[1])["estimates"]
    assert [one["value"] for one in found] == pytest.approx([one["value"] for one in stored])


def test_import_of_everything_in_the_folder(ask: Say, session: Path) -> None:
    """What the shell makes of sessions/*: the history, truth beside a session, a recording without an analysis."""
    (session.parent / "history.sqlite").write_bytes(b"")
    (session.parent / f"{session.name}.truth.json").write_text("{}")
    status, text, complaint = ask("import", *sorted(session.parent.iterdir()))
    assert (status, text) == (0, f"new        {RECORDED.name}, revision 1\n")
    assert complaint.count("skipped") == 2
    refused(ask("import", session.parent / "history.sqlite"), "B-REC-010")


def test_import_refuses_what_does_not_belong_together(ask: Say, session: Path, tmp_path: Path) -> None:
    results = session / "results.json"
    good = results.read_text()
    results.write_text(good.replace(sha256_of(session), "0" * 64))
    refused(ask("import", session), "B-STORE-013")
    results.write_text("{")
    refused(ask("import", session), "B-FIT-010")
    results.write_text(good)
    empty = tmp_path / "empty"
    empty.mkdir()
    status, text, complaint = ask("import", empty, session)  # the good one is added all the same
    assert (status, text.startswith("new"), "B-REC-010" in complaint) == (2, True, True)
    segment = session / "session.0001.mcap"
    whole = segment.read_bytes()
    results.unlink()
    segment.write_bytes(whole[: len(whole) // 2])  # as after a loss of power
    assert "did not finish" in refused(ask("import", session), "B-STORE-013")
    segment.write_bytes(whole[:-5000])
    refused(ask("import", session), "B-REC-011", 5)


def test_compare_draws_and_says_when_the_next_is_due(ask: Say, session: Path, tmp_path: Path) -> None:
    url = with_drift(session, 12)
    for name in ("drift.svg", "drift.png", "again.svg"):
        status, text, _ = ask("compare", "--history", url, "--plot", tmp_path / "plots" / name)
        assert (status, "next due" in text) == (0, True)
    plots = {path.name: path.read_bytes() for path in (tmp_path / "plots").iterdir()}
    assert b"SIMULATED" in plots["drift.svg"]
    rows = json.loads(ask("compare", "--history", url, "--json")[1])["parameters"]
    assert plots["drift.svg"].count(b"Year") == min(MOST_PANELS, len(rows))
    assert plots["again.svg"] == plots["drift.svg"]
    assert plots["drift.png"].startswith(b"\x89PNG")
    refused(ask("compare", "--history", url, "--plot", tmp_path / "drift.doc"), "B-CLI-007")
    one = {row["quantity"]: row for row in rows if row["conditions"].get("channel") == 1}["dsf_n"]
    assert (one["calibrations"], one["change_limit"]) == (12, 100.0)
    assert one["rate_per_year"] > 0.0
    assert one["control_limits_3_sigma"][1] > one["control_limits_2_sigma"][1] > 0.0
    names = [row["session"] for row in list_calibrations(url, Filters())]
    pair = json.loads(ask("compare", names[0], names[5], "--history", url, "--json")[1])
    assert pair["sessions"] == [names[0], names[5]]
    assert "|E_n| > 1" in ask("compare", names[0], names[5], "--history", url)[1]
    refused(ask("compare", names[0], "--history", url), "B-CLI-011")


def test_due_is_exit_status_1_when_overdue(ask: Say, session: Path) -> None:
    url = with_drift(session, 4, simulated=False)  # the last in 2010
    status, text, _ = ask("due", "--history", url)
    assert (status, "OVERDUE" in text) == (ExitStatus.VERDICT_FAIL, True)
    assert [one["overdue"] for one in json.loads(ask("due", "--history", url, "--json")[1])["due"]] == [True]
    later = json.loads((session / "results.json").read_text()) | {"session": "21990101T000000Z_x_GOLDEN"}
    later["provenance"] |= {"session_sha256": "f" * 64, "simulated": False}
    record_calibration(url, later, SessionReader(session).manifest | {"simulated": False}, None)
    assert ask("due", "--history", url)[0] == 0


def test_a_simulated_calibration_is_never_overdue(ask: Say, session: Path) -> None:
    status, text, _ = ask("due", "--history", with_drift(session, 2))
    assert (status, "OVERDUE" in text, "(SIMULATED)" in text) == (0, False, True)


def test_export_and_words_that_name_nothing(
    ask: Say, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = with_drift(session, 2)
    assert "estimates written to" in ask("export", tmp_path / "x.csv", "--history", url)[1]
    rows = json.loads(ask("export", tmp_path / "y.csv", "--history", url, "--json")[1])["rows"]
    assert len((tmp_path / "y.csv").read_text().splitlines()) == rows + 1
    refused(ask("export", "/proc/none/x.csv", "--history", url), "B-CLI-007")
    refused(ask("list", "--out", tmp_path / "nowhere"), "B-STORE-007")
    assert "GOLDEN" in refused(ask("list", "--uut", "GOLDEM", "--history", url), "B-STORE-009")
    refused(ask("list", "--nonsense"), "B-CLI-011")
    monkeypatch.setenv("BENCH_HISTORY", url)
    assert ask("list")[0] == 0
