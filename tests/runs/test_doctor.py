"""``bench doctor`` from the command line, as a process of its own and in this one."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest
from rehearsal import ROOT, Inside, bench

from bench import __version__

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
