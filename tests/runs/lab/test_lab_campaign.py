"""A lab folder's driver, simulator, analysis: the whole line, moved, changed, without the folder, killed on the way."""

import hashlib
import json
import os
import shutil
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from imported_logs import LOG, SHORT
from kill_drill import LONGEST_S, Process, killed, resumable, safe_after_s, session_in
from own_lab import ANALYSIS, DRIVER, NAME, SIMULATOR, copied
from rehearsal import ROOT, Inside, bench, contents
from served import SAFE_S, serving
from waiting import until

import bench as bench_module
from bench.maths.verdict import coverage_factor
from bench.model.clock import WallClock
from bench.model.errors import ExitStatus, RunError
from bench.model.posix import GUARD
from bench.record import SessionReader
from bench.run.guard.decision import Address, Brief
from bench.run.guard.diary import read_diary
from bench.run.guard.start import GuardProcess
from bench.run.stop import Health, StopSwitch

SESSION = f"sessions/{NAME}"
READINGS = 10  # of each record


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a lab folder with a session that used its code; for reading only."""
    lab = copied(tmp_path_factory.mktemp("lab") / "lab").resolve()
    done = bench("run", "air_mean", "--clock", "virtual", cwd=lab)
    assert (done.returncode, done.stderr.count("\n")) == (0, 1), done.stderr
    assert "no interlock is declared" in done.stderr  # of its station
    return lab


@pytest.fixture
def lab(recorded: Path, tmp_path: Path) -> Path:
    """Return a copy of it at another path, to be changed."""
    return Path(shutil.copytree(recorded, tmp_path / "moved"))


def sha256_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def one_line(done: subprocess.CompletedProcess[str], code: str) -> str:
    """Return what a refusal says: one line on standard error, exit status 2."""
    assert (done.returncode, done.stderr.count("\n")) == (ExitStatus.BAD_INPUT, 1), done.stderr
    assert done.stderr.startswith(f"error {code}: ")
    return done.stderr


def test_the_results_are_the_means_of_the_readings(recorded: Path) -> None:
    """Held against the statistics module of the standard library and tabulated quantiles."""
    results = json.loads((recorded / SESSION / "results.json").read_text())
    readings = bench_module.load(recorded / SESSION).readings
    assert len(results["estimates"]) == 2
    for entry in results["estimates"]:
        values = [float(value) for value in readings.loc[readings["place"] == entry["conditions"]["place"], "value"]]
        assert len(values) == entry["n"] == READINGS
        assert entry["value"] == pytest.approx(statistics.mean(values), abs=1e-9)
        assert entry["std_uncertainty"] == pytest.approx(statistics.stdev(values) / READINGS**0.5, rel=1e-9)
        assert entry["coverage_factor"] == pytest.approx(2.262, abs=5e-4)  # Student, 9 degrees of freedom
        assert abs(entry["value"] - 23.0) < 0.6
    assert coverage_factor(9.0) == pytest.approx(2.262, abs=5e-4)


def test_the_session_says_which_code_it_is_of(recorded: Path) -> None:
    session = bench_module.load(recorded / SESSION)
    hashes = {place: sha256_of(recorded / place) for place in (ANALYSIS, DRIVER, SIMULATOR)}
    assert session.manifest["lab"] == {"name": "Example laboratory", "files": hashes}
    for place in hashes:
        assert session.texts[place] == (recorded / place).read_text()
    results = json.loads((recorded / SESSION / "results.json").read_text())
    assert results["provenance"]["analysis_sha256"] == hashes[ANALYSIS]
    assert hashes[DRIVER] in (recorded / SESSION / "report.html").read_text()
    assert str(recorded).encode() not in (recorded / SESSION / "session.0001.mcap").read_bytes()


def test_the_same_seed_gives_the_same_bytes_wherever_the_folder_is(lab: Path, recorded: Path, inside: Inside) -> None:
    shutil.rmtree(lab / "sessions")
    assert inside("run", "air_mean", "--clock", "virtual", cwd=lab / "stations").returncode == 0
    assert contents(lab / "stations" / SESSION) == contents(recorded / SESSION)


def test_moved_it_is_verified_fitted_replayed_and_reported(lab: Path, inside: Inside) -> None:
    done = inside("report", "--verify", SESSION, cwd=lab)
    assert (done.returncode, done.stdout.startswith("identical: ")) == (0, True), done.stdout
    assert "every number is identical" in inside("replay", SESSION, cwd=lab).stdout
    fitted = inside("fit", SESSION, cwd=lab)
    assert fitted.returncode == 0
    assert "as it is today" not in fitted.stdout
    before = (lab / SESSION / "report.html").read_bytes()
    assert inside("report", SESSION, cwd=lab).returncode == 0
    assert (lab / SESSION / "report.html").read_bytes() == before


def test_without_the_folder_the_recording_is_read_and_results_are_refused(
    recorded: Path, tmp_path: Path, inside: Inside
) -> None:
    session = str(recorded / SESSION)
    for command in ("fit", "replay", "report"):
        said = one_line(inside(command, session, cwd=tmp_path), "B-LAB-007")
        assert "there is no lab folder here" in said
        assert ANALYSIS in said
    done = inside("export", session, "--to", "csv", "--out", str(tmp_path / "tables"), cwd=tmp_path)
    assert (done.returncode, "20 rows" in done.stdout) == (0, True), done.stderr
    done = inside("recover", session, cwd=tmp_path)
    assert (done.returncode, "B-LAB-007" in done.stdout) == (0, True)
    assert "nothing is damaged" in done.stdout


def test_another_analysis_is_said_with_both_hashes(lab: Path, inside: Inside) -> None:
    before = sha256_of(lab / ANALYSIS)
    (lab / ANALYSIS).write_text((lab / ANALYSIS).read_text() + "\n# changed\n")
    now = sha256_of(lab / ANALYSIS)
    says = f"Computed by {ANALYSIS} as it is today, SHA-256 {now[:12]}; the session was recorded with {before[:12]}."
    for _ in range(2):  # computed, then kept from before
        fitted = inside("fit", SESSION, cwd=lab)
        assert (fitted.returncode, says in " ".join(fitted.stdout.split())) == (0, True), fitted.stdout
    done = inside("report", "--verify", SESSION, cwd=lab)
    assert done.returncode == ExitStatus.SESSION_DAMAGED
    assert f"provenance.analysis_sha256 {before} -> {now}" in " ".join(done.stdout.split())
    done = inside("replay", SESSION, cwd=lab)
    assert done.returncode == ExitStatus.SESSION_DAMAGED
    assert (says in " ".join(done.stdout.split()), "1 values differ" in done.stderr) == (True, True)
    assert "the analysis of the lab folder is another file today" in done.stderr


def test_code_in_a_session_is_never_executed(lab: Path, inside: Inside) -> None:
    """The file is gone, its text is in the session: nothing takes it from there."""
    (lab / ANALYSIS).unlink()
    assert f"{lab} has no such file" in one_line(inside("fit", SESSION, cwd=lab), "B-LAB-007")


@pytest.mark.parametrize(("words", "place"), [(("list",), "stations"), (("check", "air_mean"), "")])
def test_nothing_is_imported_from_the_folder(lab: Path, words: tuple[str, ...], place: str) -> None:
    for name in ("yaml.py", "numpy.py", "stations/yaml.py"):
        (lab / name).write_text("raise SystemExit('this was executed')\n")
    done = bench(*words, cwd=lab / place)
    assert (done.returncode, "this was executed" in done.stderr) == (0, False), done.stderr


def test_what_is_refused_is_listed_and_not_executed(lab: Path, inside: Inside) -> None:
    for name in ("instruments/hp_3458a.py", "analyses/scale_factor.py"):
        (lab / name).write_text("raise SystemExit('this was executed')\n")
    (lab / DRIVER).chmod(0o666)
    entries = json.loads(inside("list", "--json", cwd=lab).stdout)
    titles = {entry["origin"]: entry["title"] for entry in entries if "Example laboratory" in entry["origin"]}
    assert titles[f"Example laboratory, {DRIVER}"] == "refused: can be written to by others"
    assert titles[f"Example laboratory, {ANALYSIS}"] == ""
    for name in ("instruments/hp_3458a.py", "analyses/scale_factor.py"):
        assert titles[f"Example laboratory, {name}"].startswith("refused: ")
    one_line(inside("check", "air_mean", cwd=lab), "B-LAB-004")
    one_line(inside("check", "scale_factor_short", cwd=lab), "B-LAB-005")


def test_an_instrument_by_hand_leaves_a_session_that_names_its_code(lab: Path, inside: Inside) -> None:
    done = inside("talk", "thermometer", "*IDN?", "--station", "t100_bench", "--out", "talks", cwd=lab)
    assert (done.returncode, done.stdout.splitlines()[0]) == (0, "EXAMPLE,T100,SIM100,1.0"), done.stderr
    (session,) = (lab / "talks").iterdir()
    assert sorted(bench_module.load(session).manifest["lab"]["files"]) == [DRIVER, SIMULATOR]


def test_a_slip_of_the_pen_and_a_log_are_told(lab: Path, inside: Inside) -> None:
    sequence = lab / "sequences" / "air_mean.yaml"
    sequence.write_text(sequence.read_text().replace("analysis: air_mean", "analysis: air_maen"))
    assert "did you mean 'air_mean'" in inside("check", "air_mean", cwd=lab).stderr
    (lab / "log.csv").write_text(LOG)
    (lab / "log.yaml").write_text(SHORT + "analysis: air_mean\n")
    assert "made of a bench's records, not of a log" in inside("import", "log.yaml", "log.csv", cwd=lab).stderr


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("    return 1 / 0\n", f"{ANALYSIS}:99: {ANALYSIS} failed: ZeroDivisionError: division by zero"),
        ("    return 3\n", f"{ANALYSIS} gives int for its 'analyse', and an Analysis is due"),
    ],
)
def test_an_analysis_that_fails_costs_no_recording(lab: Path, inside: Inside, body: str, says: str) -> None:
    text = (lab / ANALYSIS).read_text()
    head, _, tail = text.partition("    check_method(")
    (lab / ANALYSIS).write_text(f"{head}{body}    check_method({tail}")
    says = says.replace(":99:", f":{head.count(chr(10)) + 1}:")
    done = inside("run", "air_mean", "--out", "again", cwd=lab)
    code = "B-LAB-008" if "failed" in says else "B-LAB-006"
    assert (done.returncode, f"error {code}: " in done.stderr, says in done.stderr) == (1, True, True), done.stderr
    (lab / ANALYSIS).write_text(text)
    done = bench("fit", f"again/{NAME}", cwd=lab)
    assert (done.returncode, "temperature" in done.stdout, "as it is today" in done.stdout) == (0, True, True)


def test_without_owners_it_is_loaded_by_trust(lab: Path) -> None:
    """On a system without owners of files, as Windows is (tests/support/off_posix.py)."""
    program = ROOT / "tests" / "support" / "off_posix.py"
    commands = [["check", "air_mean"], ["--trust-lab", "check", "air_mean"]]
    command_line = [sys.executable, str(program), "--all", json.dumps(commands)]
    done = subprocess.run(command_line, capture_output=True, text=True, check=True, cwd=lab)
    (refused, _, said), (status, found, _) = json.loads(done.stdout)
    assert (refused, said.count("\n"), "bench --trust-lab" in said) == (ExitStatus.BAD_INPUT, 1, True)
    assert (status, "no mistake found" in found) == (0, True)


def test_the_option_of_windows_trusts_nothing_here(lab: Path) -> None:
    (lab / DRIVER).chmod(0o666)
    one_line(bench("--trust-lab", "check", "air_mean", cwd=lab), "B-LAB-004")


NOBODY = 1 << 22  # a number that no process has


def told(lab: Path, code: dict[str, str]) -> tuple[int, str, str]:
    """Start a guard as a run does, with the hashes of ``code``; its controller is nobody. Status, output and errors."""
    address = {"role": "thermometer", "driver": "example_t100", "resource": "GPIB0::11::INSTR", "options": {}}
    brief = {
        "pid": NOBODY, "visa": "@bench", "instruments": [address], "limits": {}, "silence_s": 60.0,
        "diary": str(lab / "diary"), "notify": [], "code": code,
    }  # fmt: skip
    said = json.dumps(brief) + "\n" + json.dumps({"goodbye": "done"}) + "\n"
    done = subprocess.run(
        [sys.executable, "-P", "-m", GUARD], input=said, capture_output=True, text=True, check=False, cwd=lab
    )
    return done.returncode, done.stdout, done.stderr


def test_the_guard_demands_the_hash(tmp_path: Path) -> None:
    lab = copied(tmp_path / "lab")
    (lab / DRIVER).write_text("print('this was executed')\n" + (lab / DRIVER).read_text())
    status, said, errors = told(lab, {DRIVER: "0" * 64})
    assert (status, said, errors.count("\n")) == (2, "", 1)
    assert errors.startswith(f"error B-LAB-007: {DRIVER}: SHA-256 000000000000 of the run is asked for, and ")


def test_no_run_begins_under_a_guard_that_found_other_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(copied(tmp_path / "lab"))
    address = Address("thermometer", "example_t100", "GPIB0::11::INSTR")
    brief = Brief(os.getpid(), "@bench", (address,), {}, 2.0, str(tmp_path / "diary"), code={DRIVER: "0" * 64})
    clock = WallClock()
    with StopSwitch() as stop, pytest.raises(RunError, match="B-LAB-007") as caught:
        GuardProcess(brief, Health(clock), stop, clock, lambda event: None).__enter__()
    assert caught.value.code == "B-RUN-090"


@pytest.mark.waits
@pytest.mark.slow
@pytest.mark.limit(SAFE_S)
def test_killed_moved_and_resumed(tmp_path: Path, inside: Inside, monkeypatch: pytest.MonkeyPatch) -> None:
    lab, out = copied(tmp_path / "lab"), tmp_path / "out"
    out.mkdir()
    monkeypatch.chdir(lab)
    with serving(tmp_path / "served", of="t100_bench") as served:
        words = ("--station", str(served.station), "--clock", "wall", "--out", str(out))
        short = ("--set", "dwell=4 s", "--set", "between=1 s")
        process = Process(out / "said.txt", "run", "air_mean", *words, *short)
        try:
            _first_record(out, process)
            moment_s = killed(process, out)
            safe_s, on = safe_after_s(served, moment_s)
        finally:
            process.end()
        folder = session_in(out)
        assert folder is not None, process.said()
        assert (on, safe_s <= SAFE_S) == ([], True), (on, safe_s)
        assert _safe_by_its_guard(folder) == ["thermometer"]

        text = (lab / DRIVER).read_text()
        (lab / DRIVER).write_text(text + "\n# changed\n")
        refused = inside("resume", str(folder), cwd=lab)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1), refused.stderr
        assert f"error B-LAB-007: {DRIVER}: " in refused.stderr
        (lab / DRIVER).write_text(text)
        moved = lab.rename(tmp_path / "moved")
        nowhere = inside("resume", str(folder), cwd=tmp_path)
        assert (nowhere.returncode, "there is no lab folder here" in nowhere.stderr) == (2, True)
        resumed = bench("resume", str(folder), cwd=moved)
        assert resumed.returncode in (0, 1), resumed.stderr
        results = json.loads((folder / "results.json").read_text())
        assert {entry["conditions"]["place"] for entry in results["estimates"]} == {1, 2}
        assert results["quality"]["splices"] == 1
        verified = inside("report", "--verify", str(folder), cwd=moved)
        assert (verified.returncode, "identical: " in verified.stdout) == (0, True), verified.stdout


def _first_record(out: Path, process: Process) -> None:
    """Wait until the first record is in the session: the run is in its second one, or on its way to it."""

    def there() -> bool:
        assert process.ended_by(0.0) is None, process.said()
        folder = session_in(out)
        return folder is not None and resumable(folder) and any(SessionReader(folder).events("record"))

    until(there, process.said, LONGEST_S)


def _safe_by_its_guard(folder: Path) -> list[str]:
    """Return the roles that the guard has confirmed safe, when its diary says that it is done."""

    def diary() -> list[dict[str, Any]]:
        return read_diary(folder / "guard.jsonl")

    until(lambda: {"safe", "unsafe"} & {entry["what"] for entry in diary()}, "the end of the guard", LONGEST_S)
    return [entry["role"] for entry in diary() if entry["what"] == "instrument" and entry["safe"]]
