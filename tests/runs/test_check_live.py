"""``bench check --live`` as a process of its own, on a bench in this process and on one that another process serves."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rehearsal import bench

from bench.model.clock import WallClock
from bench.plan import load_station
from bench.run.bench.served_world import ask
from bench.run.guard.lock import BenchLock, bus_keys

pytestmark = pytest.mark.waits

Row = dict[str, str]


def looked(out: Path, sequence: str, *words: str) -> tuple[int, dict[str, Row], str]:
    """Exit status, findings by name, and what went to standard error."""
    done = bench("check", sequence, "--live", "--json", "--out", str(out / "not-there"), *words)
    document = json.loads(done.stdout)
    assert not (out / "not-there").exists(), "it only looks"
    return done.returncode, {row["name"]: row for row in document["preflight"]["findings"]}, done.stderr


def test_a_bench_inside_the_process(tmp_path: Path) -> None:
    status, found, said = looked(tmp_path, "scale_factor_short")
    assert (status, said) == (0, "")
    assert {row["status"] for row in found.values()} <= {"ok", "warn", "skipped"}
    assert found["identity of calibrator"]["value"] == "5720A SIM5720"
    assert found["line of port_a"]["status"] == "skipped"
    assert found["write speed"]["status"] == "ok"


def test_the_table_says_how_it_ends(tmp_path: Path) -> None:
    done = bench("check", "scale_factor_short", "--live", "--out", str(tmp_path))
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert "Pre-flight" in lines
    assert any(line.startswith(" ok    identity of dmm") for line in lines)
    assert lines[-1].endswith("skipped")
    assert " 0 fail," in lines[-1]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder of a ``bench sim`` that runs."""
    folder = tmp_path_factory.mktemp("bench") / "sim"
    command = [sys.executable, "-m", "bench", "sim", "af_rack_sim", "--dir", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if line.strip() == "ready":
                break
        assert said[-1:] == ["ready\n"], said
        yield folder
        process.terminate()


def fault(folder: Path, *words: str) -> None:
    reply = ask(folder / "control.sock", words)
    assert "error" not in reply, reply


def outputs(folder: Path) -> dict[str, Any]:
    """What the bench really does, without the times."""
    state = ask(folder / "control.sock", ["state"])["state"]["instruments"]
    return {role: {key: one[key] for key in one if key != "unchanged_s"} for role, one in state.items()}


def station(folder: Path) -> tuple[str, str]:
    return "--station", str(folder / "station.yaml")


def test_fourteen_instruments_and_two_lines_are_as_they_should_be(served: Path, tmp_path: Path) -> None:
    before = outputs(served)
    status, found, said = looked(tmp_path, "scale_factor_wall", *station(served))
    assert (status, said) == (0, "")
    assert sum(name.startswith("identity of ") for name in found) == 14
    for name in (
        "second controller",
        "line of port_a",
        "line of port_b",
        "10 MHz at counter",
        "laboratory air",
        "guard",
    ):
        assert found[name]["status"] == "ok", found[name]
    assert found["warm-up of calibrator"]["value"].startswith("5.")
    assert outputs(served) == before, "nothing was switched"


def test_whatever_is_wrong_is_told_at_once_and_nothing_is_switched(served: Path, tmp_path: Path) -> None:
    before = outputs(served)
    for words in (("mute", "dmm"), ("identity", "supply", "HEWLETT-PACKARD,6632A,1,1"), ("reference_lost",)):
        fault(served, *words)
    try:
        status, found, said = looked(tmp_path, "scale_factor_wall", *station(served))
    finally:
        fault(served, "clear")
    assert status == 3
    failed = {name: row["value"] for name, row in found.items() if row["status"] == "fail"}
    assert failed == {
        "identity of supply": "B-INST-002",
        "identity of dmm": "B-INST-001",
        "10 MHz at counter": "not locked",
    }
    assert "B-RUN-081" in said
    assert all(name in said for name in failed)
    assert outputs(served) == before


def test_a_bench_in_use_is_left_alone(served: Path, tmp_path: Path) -> None:
    found_station = load_station(served / "station.yaml")
    keys = bus_keys(entry.resource for entry in found_station.instruments.values())
    with BenchLock(keys, "run", WallClock()):
        status, found, said = looked(tmp_path, "scale_factor_wall", *station(served))
    assert status == 2
    assert "B-RUN-080" in said
    assert "'run' of" in found["second controller"]["text"]
    assert not any(name.startswith("identity of ") for name in found)
