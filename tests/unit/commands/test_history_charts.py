"""Commands on recorded sessions: charts of a history, coefficients merged and written, an imported log, a batch."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import store_sample
from imported_logs import LOG, SHORT
from rehearsal import Inside
from report_sample import LIMIT, coupling, results
from store_sample import Documents, new_history

from bench.commands import batch as batch_command
from bench.commands import import_log
from bench.commands import session as command
from bench.commands.import_log import import_log as import_file
from bench.model.errors import BenchError, ExitStatus, FitError, InputError, SessionDamaged
from bench.record import SessionReader, SessionWriter
from bench.replay.series import replay_series, survey

SEED = 23
Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch, inside: Inside) -> Say:
    """Run ``bench history`` in this process: exit status, standard output, standard error."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words: str) -> tuple[int, str, str]:
        done = inside("history", *words)
        assert "Traceback" not in done.stderr
        return done.returncode, done.stdout, done.stderr

    return run


@pytest.fixture
def url(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    found = new_history("sqlite", tmp_path)
    monkeypatch.setenv("BENCH_HISTORY", found)
    return found


def unit(step_ppm: float, simulated: bool = False) -> Documents:
    steps = np.where(np.arange(18) >= 15, step_ppm, 0.0)
    return store_sample.unit("A1", 30.0 * np.arange(18), SEED, np.zeros(2), steps, simulated=simulated)


def test_a_signal_is_exit_status_1_and_says_when_since_and_how_much(say: Say, url: str, tmp_path: Path) -> None:
    ordered = store_sample.written(url, unit(90.0))
    status, text, _ = say("charts", "--uut", "A1", "--plot", str(tmp_path / "charts.svg"))
    assert status == ExitStatus.VERDICT_FAIL
    assert "NGU A1: 9 charts, one false signal in 200 points of all together" in text
    assert ordered[15][0]["session"] in text
    assert "shewhart" in text
    assert (tmp_path / "charts.svg").read_text(encoding="utf-8").count("Statistic / limit") == 3
    document = json.loads(say("charts", "--json", "--quantity", "dsf_n", "--run-length", "400")[1])
    assert (document["run_length"], document["charts_together"]) == (400.0, 9)
    (series,) = document["series"]
    assert series["points"][5]["ewma"] is None
    assert series["signals"][0]["since"] == ordered[15][0]["session"]


def test_no_signal_and_simulated_ones_are_exit_status_0(say: Say, url: str) -> None:
    store_sample.written(url, unit(90.0, simulated=True))
    status, text, _ = say("charts")
    assert status == 0
    assert "(SIMULATED)" in text
    assert "signals" in text


def test_freeze_and_adjusted(say: Say, url: str) -> None:
    ordered = store_sample.written(url, unit(90.0))
    status, text, _ = say("freeze", "--until", "2015-01-31", "--by", "A. Meyer", "--reason", "first months")
    assert (status, text) == (0, "NGU A1: 9 calibrations until 2015-01-31, by A. Meyer\n")
    status, text, _ = say("charts")
    assert status == ExitStatus.VERDICT_FAIL
    assert "stated by A. Meyer: first months" in text
    session = ordered[15][0]["session"]
    words = ("adjusted", session, "as_left", "--what", "gain", "--by", "A. Meyer")
    assert say(*words)[:2] == (0, f"{session}: as left, gain\n")
    assert say("charts")[0] == 0
    assert "(as left)" in say("list")[1]
    assert "as left: gain (A. Meyer)" in say("show", session)[1]
    assert "adjusted 1 times" in say("compare", "--uut", "A1")[1]
    assert json.loads(say(*words, "--json")[1])["state"] == "as_left"
    assert (
        json.loads(say("freeze", "--until", "2015-01-31", "--by", "B", "--reason", "r", "--json")[1])["calibrations"]
        == 9
    )


def test_what_is_refused(say: Say, url: str, tmp_path: Path) -> None:
    store_sample.written(url, unit(0.0))
    refused = (
        (("charts", "--certificates", "--uut", "A1"), "B-CLI-011"),
        (("charts", "--bench", "bench_9"), "B-STORE-009"),
        (("charts", "--plot", str(tmp_path / "charts.doc")), "B-CLI-007"),
        (("freeze", "--until", "yesterday", "--by", "A", "--reason", "r"), "B-CLI-011"),
        (("freeze", "--until", "2014-06-01", "--by", "A", "--reason", "r"), "B-STORE-041"),
        (("adjusted", "nothing", "as_left", "--what", "x", "--by", "A"), "B-STORE-009"),
        (("adjusted", "nothing", "as_sold", "--what", "x", "--by", "A"), "B-STORE-040"),
    )
    for words, code in refused:
        status, text, complaint = say(*words)
        assert (status, text) == (2, ""), words
        assert f"error {code}: " in complaint


def test_coefficients_are_of_sessions_that_give_some_and_of_each_once(
    short: tuple[Path, Any], session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One temperature only, or no analysis at all, gives none; nothing is written."""
    with pytest.raises(InputError, match="B-COEF-002: "):
        command.coefficients([short[0]] * 2, tmp_path / "out")
    with pytest.raises(InputError, match=f"B-COEF-005: {session}: "):
        command.coefficients([short[0], session], tmp_path / "out")
    monkeypatch.setattr(command, "read_view", lambda *_, **__: SimpleNamespace(has_analysis=False))
    with pytest.raises(InputError, match="B-COEF-005: other: "):
        command.coefficients([Path("other")], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def imported(tmp_path: Path, mapping: str, log: bytes) -> Path:
    (tmp_path / "m.yaml").write_text(mapping)
    (tmp_path / "log.csv").write_bytes(log)
    assert import_file(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    return next((tmp_path / "out").iterdir())


def test_the_bytes_are_those_of_the_file_at_the_times_of_its_rows(tmp_path: Path) -> None:
    content = (LOG + "\n2024-01-01T00:00:30,20,\r\n2024-01-01T00:01:00,21,2").encode()
    folder = imported(tmp_path, SHORT.replace("uut:", "bad_rows: 50 %\nuut:"), content)
    assert folder.name == "20240101T000000Z_any_log_S-1"
    reader = SessionReader(folder)
    lines = [message for message in reader.messages() if message.topic == "/link/log/rx"]
    assert b"".join(one.payload for one in lines) == content
    assert [one.t_ns // 10**9 for one in lines] == [0, 0, 10, 10, 10, 60]
    clocks = [message.document() for message in reader.messages() if message.topic == "/clock"]
    assert [(one["t_mono_ns"] // 10**9, one["t_utc_ns"] // 10**9) for one in clocks] == [
        (0, 1704067200),
        (60, 1704067260),
    ]
    assert (reader.damage, reader.unfinished) == ([], [])
    assert reader.manifest["simulated"] is False
    assert reader.manifest["kind"] == "import"
    assert reader.manifest["log"]["sha256"] == hashlib.sha256(content).hexdigest()
    assert reader.manifest["log"] | {"rows": 3, "bad_rows": 1, "overload_rows": 0} == reader.manifest["log"]


def test_an_unknown_analysis_is_refused_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"B-FIT-011: .*m.yaml:2:1: unknown analysis 'temperature_rampe'"):
        imported(tmp_path, SHORT.replace("uut:", "analysis: temperature_rampe\nuut:", 1), LOG.encode())
    assert not (tmp_path / "out").exists()


def test_a_log_that_grows_meanwhile_is_taken_as_it_was_surveyed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def surveyed_then_grown(lines: object, mapping: object, name: str) -> object:
        found = survey(lines, mapping, name)  # type: ignore[arg-type]
        with Path(name).open("ab") as stream:
            stream.write(b"2024-01-01T00:00:05,goes,back\n")
        return found

    monkeypatch.setattr(import_log, "survey", surveyed_then_grown)
    folder = imported(tmp_path, SHORT, LOG.encode())
    lines = SessionReader(folder).messages(frozenset({"/link/log/rx"}))
    assert b"".join(one.payload for one in lines) == LOG.encode()


def test_a_second_import_gets_a_folder_of_its_own_with_the_same_bytes(tmp_path: Path) -> None:
    first = imported(tmp_path, SHORT, LOG.encode())
    assert import_file(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    second = first.with_name(first.name + "-2")
    assert SessionReader(first).sha256 == SessionReader(second).sha256


def test_a_long_log_is_cut_into_segments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(import_log, "ROTATE_BYTES", 20_000)
    rows = [f"2024-01-{1 + at // 24:02d}T{at % 24:02d}:00:00,20,{'1' * 200}\n" for at in range(240)]
    folder = imported(tmp_path, SHORT, ("time,T,U\n" + "".join(rows)).encode())
    assert len(list(folder.glob("*.mcap"))) > 1
    assert SessionReader(folder).damage == []
    assert replay_series(folder).columns["t_s"].size == 240


def test_a_session_without_its_mapping(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path / "s", {"kind": "import", "schema": 1}, {}, t_mono_ns=0)
    writer.raw("log", "rx", 0, LOG.encode())
    writer.close("done")
    with pytest.raises(SessionDamaged, match="B-IMP-007"):
        replay_series(tmp_path / "s")


def test_bytes_cut_anywhere_by_another_writer_and_a_changed_log_is_told(tmp_path: Path) -> None:
    manifest = {"kind": "import", "schema": 1, "log": {"file": "x.csv", "sha256": "0" * 64}}
    mapping = SHORT.replace("uut:", "overload: {values: [OL]}\nuut:")
    log = (LOG + "2024-01-01T00:00:20,20.7,OL\n").encode()
    writer = SessionWriter.create(tmp_path / "s", manifest, {"mapping.yaml": mapping}, t_mono_ns=0)
    for at in range(0, len(log), 7):
        writer.raw("log", "rx", at, log[at : at + 7])
    writer.close("done")
    found = replay_series(tmp_path / "s")
    assert found.columns["t_s"].tolist() == [0.0, 10.0, 20.0]
    assert found.columns["sensor"].tolist() == [20.5, 20.6, 20.7]
    np.testing.assert_allclose(found.columns["voltage"], [1.0, 1.001, np.nan], rtol=1e-15)
    said = "1 of 3 rows of the log have a cell that is empty or that the mapping calls an overload (voltage 1)."
    assert found.notes[0] == said
    assert "is not the file that was imported" in found.notes[1]


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
    assert [one.name for one in batch_command.session_folders(tmp_path)] == ["a", "b", "c2"]
    assert batch_command.session_folders(tmp_path / "b") == [tmp_path / "b"]
    assert [one.name for one in batch_command.session_folders(tmp_path / "[ab]")] == ["a", "b"]


@pytest.mark.parametrize("name", ["nowhere", "empty", "*.none"])
def test_what_holds_no_session_is_a_mistake(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="B-CLI-013: "):
        batch_command.batch([tmp_path / name], tmp_path / "out", as_json=False)
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

    monkeypatch.setattr(batch_command, "read_view", read_view)
    monkeypatch.setattr(batch_command, "analyse_view", analyse_view)
    status = batch_command.batch([made(folder / "in", *sessions)], folder / "out", as_json=False)
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


def test_sessions_as_they_are_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three of one name: one whole, one with a false byte, one that ends in the middle of a run."""
    sessions = [
        copied(tmp_path / "first" / "session"),
        copied(tmp_path / "second" / "session", lambda raw: raw.__setitem__(len(raw) // 2, raw[len(raw) // 2] ^ 0xFF)),
        copied(tmp_path / "third" / "session", lambda raw: raw.__delitem__(slice(-20_000, None))),
    ]
    status = batch_command.batch(sessions, tmp_path / "out", as_json=True)
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
