"""``import bench`` and ``bench doctor``, and the revision that a session names: light, and as on the command line."""

import inspect
import json
import os
import shutil
import subprocess
import sys
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from mcap.stream_reader import StreamReader
from rehearsal import GOLDEN_SEQUENCE, ROOT, Inside, bench, contents

import bench as product
from bench import __version__, api
from bench.model.errors import BenchError, FitError, InputError, InputErrors, RunError
from bench.run.session import Conducted
from bench.tables import Session

LIGHT = """
import sys, bench
print(bench.__version__, bench.__bench__, sorted({"numpy", "pandas", "yaml", "rich", "bench.api"} & set(sys.modules)))
from bench.run.steps import dispatch
print(callable(bench.run), bench.load.__module__, bench.BenchError.__name__, "pandas" in sys.modules)
"""


def test_the_import_is_light_and_run_is_there_in_any_order() -> None:
    done = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.splitlines() == ["0.1.0 inertial-bench []", "True bench.api BenchError False"]


def test_what_is_handed_on_is_what_the_stub_says() -> None:
    stub = (ROOT / "bench" / "__init__.pyi").read_text(encoding="utf-8")
    for name in api.__all__:
        assert f"from bench.api import {name} as {name}\n" in stub
        assert name == "run" or getattr(product, name) is getattr(api, name)
    assert set(product.__api__) == set(api.__all__) <= set(dir(product))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        product.nonsense  # type: ignore[attr-defined]  # noqa: B018


def test_signatures_stay() -> None:
    """What programs of others rest on; a change here is a change for them."""
    assert {name: list(inspect.signature(getattr(api, name)).parameters) for name in api.__all__[4:]} == {
        "load": ["path"],
        "check": ["sequence", "station", "settings"],
        "fit": ["path", "method", "make_up", "fresh"],
        "run": ["sequence", "station", "settings", "clock", "seed", "out", "truth", "history", "ask", "uncommissioned"],
        "to_xarray": ["table"],
        "watch": ["path", "signal"],
    }
    assert list(inspect.signature(Session.frames).parameters)[1:] == ["link", "message", "start", "stop", "columns"]


def test_check_says_what_the_command_says(inside: Inside) -> None:
    checked = product.check("timeline_example")
    said = json.loads(inside("check", "timeline_example", "--json").stdout)
    assert (checked.sequence, checked.station, checked.plan_sha256) == (
        said["sequence"], said["station"], said["plan_sha256"],
    )  # fmt: skip
    figures = asdict(checked.summary)
    assert {name: list(value) if isinstance(value, tuple) else value for name, value in figures.items()}.items() <= (
        said.items()
    )
    assert checked.simulated
    longer = product.check(GOLDEN_SEQUENCE, settings={"settle": "9 s"}).summary
    assert longer.duration_s > product.check(Path(GOLDEN_SEQUENCE)).summary.duration_s


def test_run_gives_the_session_of_the_command(golden: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Called by its package, which is a module and can be called too."""
    capfd.readouterr()  # what the recording of the golden session said
    session = product.run(GOLDEN_SEQUENCE, clock="virtual", seed=3, out=tmp_path, truth=True)
    assert capfd.readouterr().out == ""
    mine, theirs = contents(session.folder), contents(golden)
    assert {name for name in theirs if mine.get(name) != theirs[name]} == set()
    assert (tmp_path / f"{session.folder.name}.truth.json").exists()
    assert (tmp_path / "history.sqlite").exists()
    assert len(session.records) == 10


def test_fit_gives_the_estimates_of_the_command(golden: Path, inside: Inside) -> None:
    fitted = product.fit(golden, "ols", fresh=True)
    said = json.loads(inside("fit", str(golden), "--method", "ols", "--json", "--fresh").stdout)
    assert json.loads(json.dumps(fitted.results)) == said
    assert fitted.estimates["value"].tolist() == [estimate["value"] for estimate in said["estimates"]]
    before = product.load(golden).estimates
    pd.testing.assert_frame_equal(product.fit(str(golden)).estimates, before, check_like=True)


def test_errors_are_those_of_the_command(golden: Path, tmp_path: Path, inside: Inside) -> None:
    cases: list[tuple[Any, tuple[str, ...]]] = [
        (lambda: product.load(tmp_path / "none"), ("fit", str(tmp_path / "none"))),
        (lambda: product.fit(golden, "nonsense"), ("fit", str(golden), "--method", "nonsense")),
        (lambda: product.check("nonsense"), ("check", "nonsense")),
        (lambda: product.check(GOLDEN_SEQUENCE, settings={"x": 1}), ("check", GOLDEN_SEQUENCE, "--set", "x=1")),
        (lambda: api.run("nonsense", out=tmp_path), ("run", "nonsense")),
        (lambda: api.run(GOLDEN_SEQUENCE, clock="sun", out=tmp_path), ("run", GOLDEN_SEQUENCE, "--clock", "sun")),
    ]
    for call, words in cases:
        with pytest.raises((InputError, InputErrors, FitError)) as caught:
            call()
        done = inside(*words)
        assert done.stderr.strip() == str(caught.value)
        assert done.returncode == caught.value.exit_status == 2
        assert caught.value.code


def test_a_run_that_ended_early_raises_what_ended_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    stopped = RunError("B-RUN-031", "not reached", where="chamber TC-1", next_step="resume")
    unsafe = RunError("B-RUN-033", "no answer", where="calibrator")

    def conducted(request: object, errors: object) -> tuple[None, Conducted]:
        outcome = type("Outcome", (), {"error": stopped, "unsafe": (unsafe,)})()
        return None, Conducted(tmp_path / "session", {}, outcome, "", {}, [], [])

    monkeypatch.setattr("bench.commands.run.conducted", conducted)
    with pytest.raises(BenchError) as caught:
        api.run(GOLDEN_SEQUENCE)
    assert caught.value is stopped
    assert caught.value.__notes__ == [str(unsafe), f"The session is {tmp_path / 'session'}."]


def test_the_example_of_the_page_is_executed(short: tuple[Path, Any]) -> None:
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    source = page.partition("```python\n")[2].partition("```")[0]
    shown = page.partition("prints\n\n```\n")[2].partition("```")[0]
    done = subprocess.run(
        [sys.executable, "-c", source.replace("sessions/20000101T000000Z_scale_factor_short_SIM-1", str(short[0]))],
        capture_output=True, text=True, check=True, cwd=ROOT,
    )  # fmt: skip
    assert done.stdout == shown


STATION = (ROOT / "stations" / "af_bench_sim.yaml").read_text(encoding="utf-8")


def test_the_machine_and_a_station(tmp_path: Path) -> None:
    done = bench("doctor", "--station", "af_bench_sim", "--bundle", str(tmp_path / "bundle.zip"), "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    found = {row["name"]: row for row in document["findings"]["findings"]}
    installed = [f"{kind} of inertial-bench {__version__}" for kind in ("systems", "worlds", "instruments")]
    assert list(found) == [*installed, "station file", "clock", "suspend", "mains", "memory, files", "versions"]
    named = [(offer["kind"], offer["name"], offer["package"]) for offer in document["installed"]]
    assert ("systems", "north", "bench.systems.north") in named
    assert ("worlds", "fog_north", "sim_instruments.worlds.north") in named
    assert named[-1] == ("instruments", "inertial-bench", "instruments")
    assert found["station file"]["value"] == "10 instruments, 2 links"
    assert document["software"]["packages"]["numpy"]
    with zipfile.ZipFile(tmp_path / "bundle.zip") as archive:
        assert archive.namelist() == ["doctor.json", "af_bench_sim.yaml"]
        assert json.loads(archive.read("doctor.json")) == document
        assert archive.read("af_bench_sim.yaml").startswith(b"#")


def real_station() -> str:
    """Return the simulated bench as if it were real, with a VISA library that is not there."""
    text = STATION
    changes = {
        "simulated: true": "simulated: false",
        '"@bench"': '"@ivi"',
        text[text.index("world:") : text.index("instruments:")]: "",
        "1999-": "2026-",
        "2000-": "2030-",
    }
    changes |= {f"baud: {baud}": f"baud: {baud}, url: /dev/{baud}" for baud in (921600, 115200)}
    for old, new in changes.items():
        text = text.replace(old, new)
    return text


@pytest.mark.parametrize(
    ("text", "out", "err"),
    [
        (STATION.replace("GPIB0::4::INSTR", "nonsense"), "B-PLAN-012", "B-RUN-080"),
        (real_station(), "", "B-RUN-002"),
    ],
    ids=["mistakes", "no VISA library"],
)
def test_a_station_that_cannot_be_used(text: str, out: str, err: str, tmp_path: Path, inside: Inside) -> None:
    path = tmp_path / "station.yaml"
    path.write_text(text, encoding="utf-8")
    done = inside("doctor", "--station", str(path))
    assert (done.returncode, out in done.stdout, done.stderr.count(err)) == (2, True, 1)
    assert err != "B-RUN-002" or "@ivi" in done.stderr


def test_a_bundle_that_cannot_be_written(tmp_path: Path, inside: Inside) -> None:
    done = inside("doctor", "--bundle", str(tmp_path / "none" / "bundle.zip"))
    assert done.returncode == 2
    assert "B-CLI-007" in done.stderr


SEALED = 20  # bytes in front of the payload: CRC, running number, time
MAPPING = """
mapping: bath
uut: {model: DMM, serial: A-12}
columns: {time: {role: time, format: unix, unit: s}, U: {role: reading, quantity: voltage, unit: V}}
"""


def git(root: Path, *words: str) -> str:
    command = ["git", "-C", str(root), "-c", "user.name=nobody", "-c", "user.email=nobody@example.org", *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def revision_in_session(root: Path, place: Path) -> str:
    """Import a log with the bench that lies below ``root``; return the revision its session names."""
    (place / "bath.yaml").write_text(MAPPING)
    (place / "log.csv").write_text("time,U\n0,1.0\n1,1.1\n")
    command = [sys.executable, "-m", "bench", "import", "bath.yaml", "log.csv", "--out", "out"]
    environment = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (segment,) = place.glob("out/*/session.0001.mcap")
    with segment.open("rb") as stream:
        manifest = next(record for record in StreamReader(stream).records if type(record).__name__ == "Message")
    return str(json.loads(manifest.data[SEALED:])["software"]["git"])


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a checkout")
def test_a_session_names_the_revision_of_the_checkout(tmp_path: Path) -> None:
    revision = git(ROOT, "rev-parse", "HEAD")
    assert revision_in_session(ROOT, tmp_path) in (revision, f"{revision} with local modifications")


@pytest.mark.parametrize("pyproject", [None, '[project]\nname = "theirs"\n'])
def test_the_repository_of_somebody_else_is_not_named(tmp_path: Path, pyproject: str | None) -> None:
    root = tmp_path / "theirs"
    shutil.copytree(ROOT / "bench", root / "bench")
    if pyproject is not None:
        (root / "pyproject.toml").write_text(pyproject)
    git(tmp_path, "init", "-q", str(root))
    git(root, "commit", "-q", "--allow-empty", "-m", "theirs")
    assert revision_in_session(root, tmp_path) == "not a checkout"
