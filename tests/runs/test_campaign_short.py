"""The short campaign end to end: same seed same bytes, replay, copies, schema, truth."""

from __future__ import annotations

import json
from pathlib import Path
from subprocess import CompletedProcess

import jsonschema
import pytest
from rehearsal import NAME, SEED, Inside, contents, record_golden, writable_copy

from bench.analysis import results_schema

Short = tuple[Path, CompletedProcess[str]]
LIMIT_ppm = {"gyro": 8.0, "accelerometer": 5.0}


def results_of(folder: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((folder / "results.json").read_text())
    return found


def test_a_campaign_ends_with_its_files_and_exit_status_0(short: Short) -> None:
    folder, done = short
    assert done.returncode == 0, done.stderr
    assert sorted(contents(folder)) == [
        "bench.001s", "bench.010s", "bench.100s", "coefficients.h", "coefficients.json", "port_a.001s", "port_a.010s",
        "port_a.100s", "port_b.001s", "port_b.010s", "port_b.100s", "report.html", "results.json", "session.0001.mcap",
        "session.0002.mcap", "session.0003.mcap", "trend.json",
    ]  # fmt: skip
    assert (folder.parent / "history.sqlite").is_file()
    assert "SIMULATED" in done.stdout
    assert str(folder / "report.html") in done.stdout
    assert "Traceback" not in done.stdout + done.stderr


def test_a_folder_of_that_name_gives_a_suffix_which_is_in_no_file(golden: Path, tmp_path: Path) -> None:
    """Else the same seed gives the same bytes; the whole short campaign is held against another in test_page_killed."""
    taken = tmp_path / golden.name
    taken.mkdir()
    record_golden(tmp_path)
    first, second = contents(golden), contents(taken.with_name(f"{golden.name}-2"))
    assert {name for name in first if first[name] != second[name]} == set()
    assert first.keys() == second.keys()
    assert not list(taken.iterdir())


def test_results_match_their_schema(short: Short) -> None:
    jsonschema.validate(results_of(short[0]), results_schema())


def test_scale_factors_agree_with_the_simulated_truth(short: Short) -> None:
    folder, _ = short
    true = json.loads(folder.with_name(NAME + ".truth.json").read_text())["estimates"]
    keys = ("channel", "temperature_degC")
    expected = {
        (one["quantity"], *(one["conditions"].get(key) for key in keys)): one["value"]
        for one in true
        if one["quantity"] in ("dsf_n", "dsf_p")
    }
    worst = {"gyro": 0.0, "accelerometer": 0.0}
    judged = 0
    for one in results_of(folder)["estimates"]:  # type: ignore[attr-defined]
        conditions = one["conditions"]
        where = (one["quantity"], *(conditions.get(key) for key in keys))
        if where in expected:
            judged += 1
            worst[conditions["kind"]] = max(worst[conditions["kind"]], abs(one["value"] - expected[where]))
    print(f"seed {SEED}: worst errors {worst} ppm over {judged} estimates")
    assert judged >= 2 * 3 * 2
    for kind, limit_ppm in LIMIT_ppm.items():
        assert worst[kind] < limit_ppm


@pytest.mark.validates(
    "replay of a session from its raw bytes",
    against="every number the run itself wrote, in a copy without the simulated truth",
)
def test_a_copy_elsewhere_replays_fits_and_reports_without_the_truth(
    short: Short, tmp_path: Path, inside: Inside
) -> None:
    folder, _ = short
    copy = writable_copy(folder, tmp_path / "somewhere" / "else")
    (copy / "report.html").unlink()
    replayed = inside("replay", str(copy), cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr
    assert "every number is identical" in replayed.stdout
    fitted = inside("fit", str(copy), "--json", cwd=tmp_path)
    assert fitted.returncode == 0
    assert json.loads(fitted.stdout) == results_of(folder)
    reported = inside("report", str(copy), cwd=tmp_path)
    assert reported.returncode == 0
    assert (copy / "report.html").read_bytes() == (folder / "report.html").read_bytes()


@pytest.mark.parametrize("method", ["paper", "ols"])
def test_other_methods_read_the_same_session(short: Short, method: str, inside: Inside) -> None:
    done = inside("fit", str(short[0]), "--method", method)
    assert done.returncode == 0, done.stderr
    assert f"method {method}" in done.stdout
