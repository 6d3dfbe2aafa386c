"""Every exit status of the contract, and how the command line speaks: one line per error, one JSON document."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest
from rehearsal import GOLDEN_SEQUENCE, ROOT, Inside, main_of, shortened, writable_copy
from waiting import until

import bench.commands.run as run_command
import bench.session.finish as finish_command
from bench.commands.control import ask
from bench.commands.tables import verdict_status
from bench.model.errors import BenchError, ExitStatus
from bench.record import SessionReader
from bench.session.service import read_view
from bench.session.view import analyse_view, model_of


def refused(done: CompletedProcess[str], status: int, code: str) -> str:
    """The error line; asserts exit status, one line per error, nothing on standard output, no traceback."""
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("error B-")]
    assert [line for line in lines if line.startswith(f"error {code}: ")], done.stderr
    return next(line for line in lines if code in line)


def sequence(folder: Path, *changes: tuple[str, str]) -> str:
    return str(shortened(ROOT / "sequences" / "timeline_example.yaml", folder, "changed", *changes))


def only_session(out: Path) -> Path:
    (session,) = (path for path in out.iterdir() if path.is_dir())
    return session


def test_0_a_sequence_without_analysis_and_2_whoever_asks_for_one(tmp_path: Path, inside: Inside) -> None:
    done = inside("run", "timeline_example", "--out", str(tmp_path))
    assert done.returncode == 0
    assert "its records are in" in done.stdout
    for command in ("fit", "replay", "report"):
        refused(inside(command, str(only_session(tmp_path))), 2, "B-CLI-008")


def test_1_a_verdict_fails(golden: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    view = read_view(golden)
    results, analysis = analyse_view(view)
    assert verdict_status(results, analysis.missing) == ExitStatus.PASS
    assert verdict_status(results, ["channel 2 at 25 degC"]) == ExitStatus.VERDICT_FAIL
    results["estimates"][3]["verdict"] = "fail"
    monkeypatch.setattr(finish_command, "analyse_view", lambda view: (results, analysis))
    model = model_of(view, results, analysis)
    monkeypatch.setattr(finish_command, "model_of", lambda *_: model)
    monkeypatch.setattr(finish_command, "write_coefficients", lambda *_: [])
    monkeypatch.setattr(run_command.SessionView, "has_analysis", True)
    assert main_of(monkeypatch, "run", "timeline_example", "--out", str(tmp_path)) == ExitStatus.VERDICT_FAIL
    for verdict, status in (("conditional_fail", ExitStatus.VERDICT_FAIL), ("conditional_pass", ExitStatus.PASS)):
        conditional = {"estimates": [results["estimates"][0] | {"verdict": one} for one in ("pass", verdict, "none")]}
        assert verdict_status(conditional, ()) == status


@pytest.mark.parametrize(
    ("words", "code"),
    [("nosuch", "B-CLI-011"), ("run", "B-CLI-011"), ("run timeline_example --set dwell", "B-CLI-001"),
     ("run timeline_example --seed many", "B-CLI-011: Invalid value for '--seed': it should be a valid integer. Next"),
     ("run timeline_example --clock lunar", "B-CLI-004"), ("run no_such_sequence", "B-SHIP-001"),
     ("check timeline_example --plot /proc/none/x.svg", "B-CLI-007"),
     ("run timeline_example --out /dev/null", "B-CLI-007"), ("talk theremin *IDN?", "B-CLI-003"),
     ("drill --station af_bench_sim --out /dev/null/x", "B-CLI-007"), ("fit /nonexistent", "B-REC-010"),
     ("schema --out /proc/none", "B-CLI-007"), ("run timeline_example --history nonsense", "B-STORE-001"),
     ("run timeline_example --history mysql://user@host/calibrations", "B-STORE-001")],
)  # fmt: skip
def test_2_bad_input(words: str, code: str, tmp_path: Path, inside: Inside) -> None:
    done = inside(*words.split(), cwd=tmp_path)
    refused(done, 2, code)
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_2_all_mistakes_of_a_file_one_line_each(tmp_path: Path, inside: Inside) -> None:
    path = sequence(
        tmp_path, ("voltage: 18 V", "voltage: 18 A"), ("channel: 3, polarity: +}}}", "channel: 33, polarity: +}}}")
    )
    done = inside("check", path)
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    assert len(lines) >= 2
    assert all(line.startswith("error B-PLAN-") and "changed.yaml:" in line for line in lines)


def test_2_settings_of_an_editor_are_not_spoiled(tmp_path: Path, inside: Inside) -> None:
    for text in ("{ // mine\n}", "[]", '{"yaml.schemas": []}'):
        (tmp_path / ".vscode").mkdir(exist_ok=True)
        (tmp_path / ".vscode" / "settings.json").write_text(text)
        refused(inside("schema", "--vscode", cwd=tmp_path), 2, "B-CLI-002")
        assert (tmp_path / ".vscode" / "settings.json").read_text() == text
    (tmp_path / ".vscode" / "settings.json").write_text('{"editor.tabSize": 2}')
    assert inside("schema", "--vscode", cwd=tmp_path).returncode == 0
    settings = json.loads((tmp_path / ".vscode" / "settings.json").read_text())
    assert settings["editor.tabSize"] == 2
    assert len(settings["yaml.schemas"]) >= 3


@pytest.mark.parametrize("form", ["text", "json"])
def test_3_the_unit_refuses_a_command(tmp_path: Path, inside: Inside, form: str) -> None:
    path = sequence(tmp_path, ("code: 2,", "code: 99,"))
    done = inside("run", path, "--out", str(tmp_path / "out"), *(["--json"] if form == "json" else []))
    assert "status 1" in refused(done, 3, "B-RUN-023")
    if form == "json":
        assert done.stdout == ""
    else:
        assert "The bench is safe; 0 of 1 records" in done.stdout


@pytest.mark.parametrize("when", ["at once", "at the end"])
def test_3_not_confirmed_safe_is_never_exit_status_0(
    when: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At the end it is the last line."""
    from instruments.hp_6632b import DRIVER

    begins = DRIVER.make_safe

    def fails_later(self: Any) -> None:
        begins(self)
        monkeypatch.setattr(DRIVER, "make_safe", fails)

    def fails(self: Any) -> None:
        raise self.error("B-INST-009", "the output is still on")

    monkeypatch.setattr(DRIVER, "make_safe", fails if when == "at once" else fails_later)
    assert main_of(monkeypatch, "run", "timeline_example", "--out", str(tmp_path)) == ExitStatus.SAFE_AFTER_FAULT
    said = capsys.readouterr()
    if when == "at once":
        (error,) = [line for line in said.err.splitlines() if "B-RUN-060" in line]
        assert "supply: not confirmed safe" in error
        assert "B-INST-009" in error
    else:
        assert said.out.endswith("The bench is NOT confirmed safe: supply, switch off at the front panel\n")


def test_137_stands_wherever_the_statuses_do(inside: Inside) -> None:
    assert "137, said by the shell" in " ".join(inside("--help").stdout.split())
    assert "\n| 137 |" in (ROOT / "docs" / "user-guide.md").read_text()


def test_5_numbers_that_differ_and_a_damaged_session(golden: Path, tmp_path: Path, inside: Inside) -> None:
    copy = writable_copy(golden, tmp_path / "copy")
    stored = json.loads((copy / "results.json").read_text())
    stored["estimates"][0]["value"] += 1e-9
    (copy / "results.json").write_text(json.dumps(stored))
    done = inside("replay", str(copy))
    assert "results.json was changed" in refused(done, 5, "B-CLI-009")
    stored["provenance"]["session_sha256"] = "0" * 64
    (copy / "results.json").write_text(json.dumps(stored))
    line = refused(inside("replay", str(copy)), 5, "B-CLI-009")
    assert "2 values differ" in line
    assert "of another recording" in line
    assert "estimates[0].value" in done.stderr
    (copy / "results.json").unlink()
    refused(inside("replay", str(copy)), 2, "B-CLI-010")
    refused(inside("replay", str(copy), "--json"), 2, "B-CLI-010")
    segment = copy / "session.0001.mcap"
    raw = bytearray(segment.read_bytes())
    raw[len(raw) // 2] ^= 1
    segment.write_bytes(raw)
    refused(inside("replay", str(copy)), 5, "B-REC-011")


def test_70_an_error_nobody_foresaw(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fails(*_: object) -> None:
        raise RuntimeError("two\nlines [/red]")

    monkeypatch.setattr("bench.commands.check.check", fails)
    assert main_of(monkeypatch, "check", "timeline_example") == ExitStatus.INTERNAL
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("error B-INT-001: test_cli_status:")
    assert ": RuntimeError: two lines [/red]. Next: " in line


def test_json_is_one_document_and_nothing_else(golden: Path, tmp_path: Path, inside: Inside) -> None:
    session = str(golden)
    raw = tmp_path / "capture"
    raw.write_bytes(bytes.fromhex((ROOT / "tests" / "golden" / "ngu_a.hex").read_text(encoding="ascii")))
    for words in (
        ["check", "scale_factor_short"], ["fit", session], ["replay", session], ["recover", session],
        ["decode", "ngu_a", str(raw)], ["run", GOLDEN_SEQUENCE, "--out", str(tmp_path / "out")],
    ):  # fmt: skip
        done = inside(*words, "--json")
        assert done.returncode == 0, done.stderr
        assert isinstance(json.loads(done.stdout), dict), words
        assert "Traceback" not in done.stderr


def test_a_full_standard_output_is_told_once_and_changes_no_status(golden: Path) -> None:
    command = f"{sys.executable} -m bench fit {golden} --fresh > /dev/full"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    told = "standard output is lost: No space left on device; the exit status is that of the command\n"
    assert (done.stderr, done.returncode) == (told, ExitStatus.PASS)


IN_THE_SWEEP = [pytest.param(closing, marks=pytest.mark.sweep) for closing in (">&- 2>&-", ">/dev/full 2>&1")]


@pytest.mark.parametrize("closing", ["|& true", "<&- >&- 2>&-", *IN_THE_SWEEP])
def test_results_are_written_when_nobody_listens(closing: str, tmp_path: Path) -> None:
    """Standard output and error are closed pipes, full, or closed altogether: the campaign is done all the same."""
    command = [sys.executable, "-m", "bench", "run", GOLDEN_SEQUENCE, "--out", str(tmp_path)]
    done = subprocess.run(["bash", "-c", f"set -o pipefail; {shlex.join(command)} {closing}"], check=False)
    assert done.returncode == ExitStatus.PASS
    session = only_session(tmp_path)
    assert (session / "results.json").exists()
    assert (session / "report.html").exists()


WAIT_S = 120.0


def status(folder: Path) -> dict[str, Any]:
    try:
        return ask(folder, "status")
    except BenchError:
        return {}


def arranged(folder: Path) -> tuple[Path, Path]:
    """The half-minute campaign with an early verdict, a user who wants to be told, and where he is told."""
    text = (ROOT / "sequences" / "scale_factor_wall_30s.yaml").read_text()
    head, _, rest = text.partition("\nuut:")
    sequence = folder / "sequences" / "scale_factor_wall_30s.yaml"
    sequence.parent.mkdir()
    sequence.write_text(f"{head}\nearly: {{after: 2 s, every: 1 h, max_lost: 50 %, max_bad: 50 %}}\nuut:{rest}")
    caught = folder / "caught"
    config = folder / "config" / "inertial-bench"
    config.mkdir(parents=True)
    program = f"import sys; open({str(caught)!r}, 'a').write(sys.stdin.read() + chr(10))"
    (config / "notify.yaml").write_text(f"command: {json.dumps([sys.executable, '-c', program])}\n")
    return sequence, caught


@pytest.mark.waits
@pytest.mark.slow
def test_another_terminal_pauses_resumes_and_aborts_a_run(tmp_path: Path, inside: Inside) -> None:
    out = tmp_path / "out"
    sequence, caught = arranged(tmp_path)
    command = [sys.executable, "-m", "bench", "run", str(sequence), "--clock", "wall", "--out", str(out)]
    environment = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path / "config")}
    log = (tmp_path / "log").open("w+")
    with log, subprocess.Popen(command, stdout=log, stderr=log, env=environment) as run:
        try:
            folder = until(lambda: next(iter(out.glob("*_SIM-1*")), None), "a session", WAIT_S)
            until(lambda: status(folder).get("records", 0) >= 1, "a record", WAIT_S)
            assert inside("pause", str(folder), "--reason", "door open").returncode == 0
            held = until(lambda: (now := status(folder)).get("reasons") and now, "a hold", WAIT_S)
            assert any("door open" in reason for reason in held["reasons"].values())
            until(lambda: caught.exists() and '"hold"' in caught.read_text(), "the news of it", WAIT_S)
            verdict = until(lambda: "early verdict" in (tmp_path / "log").read_text(), "a verdict", WAIT_S)
            assert verdict
            assert inside("resume", str(folder)).returncode == 0
            until(lambda: status(folder).get("records", 0) > held["records"], "another record", WAIT_S)
            assert inside("abort", str(folder), "--reason", "enough").returncode == 0
            assert run.wait(WAIT_S) == 4
        finally:
            run.kill()
    gone = inside("pause", str(folder))
    assert gone.returncode == 2
    assert "B-CTRL-001" in gone.stderr
    reader = SessionReader(folder, strict=True)
    controls = [(fields["what"], fields["reason"]) for _, _, fields in reader.events("control")]
    assert controls == [("pause", "door open"), ("resume", ""), ("abort", "enough")]
    assert [kind for kind, _, _ in reader.events() if kind in ("hold", "release")] == ["hold", "release"]
    (given,) = [fields for _, _, fields in reader.events("verdict")]
    assert given["ok"] is not False, given
    assert [one["name"] for one in given["checks"]][:2] == ["frames lost", "frames damaged"]
    told = [json.loads(line)["event"] for line in caught.read_text().splitlines()]
    assert told == ["hold", "release", "error", "end"]
