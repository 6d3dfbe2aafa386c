"""A session recorded by an earlier release is read, replayed and gives the results it gave then; a stopped one goes on.

Everything is done by commands: modules move, commands and files stay.
"""

import json
import math
import shutil
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from report_sample import code_names, intervals_of_tables_alone
from typer.testing import CliRunner

from bench.cli import app
from bench.session.fitted import Fitted

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
SESSIONS = sorted(path.parent for path in GOLDEN.glob("sessions/*/*/session.0001.mcap"))
STOPPED = sorted(path.parent for path in GOLDEN.glob("stopped/*/*/session.0001.mcap"))
ANALYSES = {
    "scale_factor", "gnc_unit_test", "fog_north", "rlg_lock_in", "time_sync", "temperature_ramp", "imu_six_position",
    "imu_multi_position", "imu_strapdown", "bias_log", "magnetometer_log", "north_log", "rlg_count_log",
    "stream_offset", "radar_image",
}  # fmt: skip
MOST_BYTES = 300_000
REL_TOL = 1e-5  # of a value its U: another processor sums in another order, and a search ends elsewhere
LEFT_OUT = {"provenance", "notes", "schema"}  # they name the software and may say more than they did


def release_and_name(folder: Path) -> str:
    return f"{folder.parent.name}/{folder.name}"


def bench(*words: str | Path) -> Any:
    """Give a command in this process; return the JSON document it prints, None if it prints none."""
    output = CliRunner().invoke(app, [str(word) for word in words])
    assert output.exit_code in (0, 1), output.output
    return json.loads(output.stdout) if output.stdout.startswith("{") else None


def stored_in(folder: Path) -> Any:
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def differences(stored: Any, now: Any, path: str = "", least: float = 0.0) -> list[str]:
    """List what was stored and is not given again, to ``least``; fields that are new are no difference."""
    if isinstance(stored, dict) and isinstance(now, dict):
        least = REL_TOL * (stored.get("expanded_uncertainty") or 0.0)
        pairs = [(f"{path}.{key}", value, now.get(key, "(absent)")) for key, value in stored.items()]
        return [text for name, *pair in pairs for text in differences(*pair, name, least * name.endswith(".value"))]
    if isinstance(stored, list) and isinstance(now, list) and len(stored) == len(now):
        pairs = enumerate(zip(stored, now, strict=True))
        return [text for index, pair in pairs for text in differences(*pair, f"{path}[{index}]")]
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (stored, now))
    rel = 0.0 if least else REL_TOL
    same = math.isclose(stored, now, rel_tol=rel, abs_tol=least or 1e-300) if numbers else stored == now
    return [] if same else [f"{path}: {stored!r} != {now!r}"]


def test_each_system_and_each_small_log_has_a_small_one() -> None:
    assert {stored_in(folder)["campaign"] for folder in SESSIONS} >= ANALYSES
    assert STOPPED
    for folder in (*SESSIONS, *STOPPED):
        assert sum(path.stat().st_size for path in folder.iterdir()) < MOST_BYTES, folder


@pytest.fixture(scope="module")
def schema(tmp_path_factory: pytest.TempPathFactory) -> Draft202012Validator:
    folder = tmp_path_factory.mktemp("schemas")
    bench("schema", "--out", folder)
    (path,) = folder.glob("results*.json")
    return Draft202012Validator(json.loads(path.read_text(encoding="utf-8")))


@pytest.mark.validates(
    "results of a recorded session, limit 1e-5 of each uncertainty",
    against="the results stored with it by release 0.1.0",
)
@pytest.mark.slow
@pytest.mark.parametrize("folder", SESSIONS, ids=release_and_name)
def test_an_earlier_release_stays_readable(
    folder: Path, tmp_path: Path, schema: Draft202012Validator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # the report is drawn of what was fitted just before
    stored = stored_in(folder)
    schema.validate(stored)
    copy = Path(shutil.copytree(folder, tmp_path / folder.name))
    again = bench("fit", copy, "--json")
    assert again["provenance"]["session_sha256"] == stored["provenance"]["session_sha256"]
    kept = {name: value for name, value in stored.items() if name not in LEFT_OUT}
    assert differences(kept, again) == []
    bench("report", copy)
    page = (copy / "report.html").read_text(encoding="utf-8")
    assert "<html" in page
    assert code_names(page) == set()  # no reader sees the name of a quantity in the code
    assert intervals_of_tables_alone(Fitted(copy).shown) == set()


@pytest.mark.parametrize("folder", STOPPED, ids=release_and_name)
def test_a_stopped_session_goes_on_to_its_end(folder: Path, tmp_path: Path) -> None:
    """Every record is there once, the splice is counted, a replay says the same, and the whole run agrees."""
    copy = Path(shutil.copytree(folder, tmp_path / folder.name))
    results = bench("resume", copy, "--json")
    assert sorted(path.name for path in copy.glob("session.*.mcap")) == ["session.0001.mcap", "session.0002.mcap"]
    assert not (copy / "journal.jsonl").exists()
    whole = stored_in(GOLDEN / "sessions" / folder.parent.name / folder.name)
    assert results["quality"]["records"] == whole["quality"]["records"]
    assert (results["quality"]["splices"], results["quality"]["frames_lost"]) == (1, 0)
    assert bench("replay", copy, "--json")["identical"] is True
    assert worst_sigma(results, whole) < 3.0


def worst_sigma(results: Any, whole: Any) -> float:
    """Return the largest difference of the scale-factor errors of two runs in their combined standard uncertainty."""
    pairs = [
        (resumed, planned)
        for resumed, planned in zip(results["estimates"], whole["estimates"], strict=True)
        if planned["quantity"] in ("dsf_n", "dsf_p")
    ]
    assert len(pairs) == 4
    for name in ("channel", "kind", "temperature_degC"):
        assert all(resumed["conditions"][name] == planned["conditions"][name] for resumed, planned in pairs)
    return max(
        abs(resumed["value"] - planned["value"]) / math.hypot(resumed["std_uncertainty"], planned["std_uncertainty"])
        for resumed, planned in pairs
    )


def test_differences_are_found() -> None:
    assert differences({"a": [1.0]}, {"a": [1.0 + 1e-12], "b": 2}) == []
    assert differences({"a": [1.0]}, {"a": [1.0 + 1e-4]}) == [".a[0]: 1.0 != 1.0001"]
    stated = {"value": 1.0, "expanded_uncertainty": 1e-3}
    assert differences(stated, stated | {"value": 1.0 + 1e-7}) == [".value: 1.0 != 1.0000001"]
    assert differences({"a": [1.0]}, {"a": []}) == [".a: [1.0] != []"]
    assert differences({"a": "x"}, {}) == [".a: 'x' != '(absent)'"]
