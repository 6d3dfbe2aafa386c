"""``bench check --live`` as a process of its own, on a bench in this process and on one that another process serves."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rehearsal import bench
from served import Served, serving

from bench.model.clock import WallClock
from bench.plan import load_station
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
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("bench") / "sim") as bench:
        yield bench


def outputs(served: Served) -> dict[str, Any]:
    """What the bench really does, without the times."""
    state = served.state()["instruments"]
    return {role: {key: one[key] for key in one if key != "unchanged_s"} for role, one in state.items()}


def looked_at(served: Served, out: Path) -> tuple[int, dict[str, Row], str]:
    return looked(out, "scale_factor_wall", "--station", str(served.station))


def test_fourteen_instruments_and_two_lines_are_as_they_should_be(served: Served, tmp_path: Path) -> None:
    before = outputs(served)
    status, found, said = looked_at(served, tmp_path)
    assert (status, said) == (0, "")
    assert sum(name.startswith("identity of ") for name in found) == 14
    right = ("second controller", "line of port_a", "line of port_b", "10 MHz at counter", "laboratory air", "guard")
    assert {name: found[name]["status"] for name in right} == dict.fromkeys(right, "ok")
    assert found["warm-up of calibrator"]["value"].startswith("5.")
    assert outputs(served) == before, "nothing was switched"


def test_whatever_is_wrong_is_told_at_once_and_nothing_is_switched(served: Served, tmp_path: Path) -> None:
    before = outputs(served)
    for words in (("mute", "dmm"), ("identity", "supply", "HEWLETT-PACKARD,6632A,1,1"), ("reference_lost",)):
        served.fault(*words)
    try:
        status, found, said = looked_at(served, tmp_path)
    finally:
        served.fault("clear")
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


def test_a_bench_in_use_is_left_alone(served: Served, tmp_path: Path) -> None:
    found_station = load_station(served.station)
    keys = bus_keys(entry.resource for entry in found_station.instruments.values())
    with BenchLock(keys, "run", WallClock()):
        status, found, said = looked_at(served, tmp_path)
    assert status == 2
    assert "B-RUN-080" in said
    assert "'run' of" in found["second controller"]["text"]
    assert not any(name.startswith("identity of ") for name in found)
