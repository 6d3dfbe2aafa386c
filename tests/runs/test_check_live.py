"""``bench check --live`` and ``bench commission`` on benches in this process and on served ones."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rehearsal import Inside, bench
from served import Served, serving

from bench.commands import hand
from bench.model.clock import WallClock
from bench.model.errors import InputError
from bench.plan import load_station
from bench.run.guard.lock import BenchLock, bus_keys

pytestmark = pytest.mark.waits

Row = dict[str, str]


def looked(inside: Inside, out: Path, sequence: str, *words: str) -> tuple[int, dict[str, Row], str]:
    """Exit status, findings by name, and what went to standard error."""
    done = inside("check", sequence, "--live", "--json", "--out", str(out / "not-there"), *words)
    document = json.loads(done.stdout)
    assert not (out / "not-there").exists(), "it only looks"
    return done.returncode, {row["name"]: row for row in document["preflight"]["findings"]}, done.stderr


def test_a_bench_inside_the_process(tmp_path: Path, inside: Inside) -> None:
    status, found, said = looked(inside, tmp_path, "scale_factor_short")
    assert (status, said) == (0, "")
    assert {row["status"] for row in found.values()} <= {"ok", "warn", "skipped"}
    assert found["identity of calibrator"]["value"] == "5720A SIM5720"
    assert found["line of port_a"]["status"] == "skipped"
    assert found["write speed"]["status"] == "ok"


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("bench") / "sim") as bench:
        yield bench


def outputs(served: Served) -> dict[str, Any]:
    """What the bench really does, without the times."""
    state = served.state()["instruments"]
    return {role: {key: one[key] for key in one if key != "unchanged_s"} for role, one in state.items()}


def looked_at(inside: Inside, served: Served, out: Path) -> tuple[int, dict[str, Row], str]:
    return looked(inside, out, "scale_factor_wall", "--station", str(served.station))


def test_fourteen_instruments_and_two_lines_are_as_they_should_be(
    served: Served, tmp_path: Path, inside: Inside
) -> None:
    before = outputs(served)
    status, found, said = looked_at(inside, served, tmp_path)
    assert (status, said) == (0, "")
    assert sum(name.startswith("identity of ") for name in found) == 14
    right = ("second controller", "line of port_a", "line of port_b", "settings of rail_dmm", "guard")
    assert {name: found[name]["status"] for name in right} == dict.fromkeys(right, "ok")
    assert "a run sets unseen: running scan" in found["settings of logger"]["value"]
    assert (found["10 MHz at counter"]["status"], found["laboratory air"]["status"]) == ("warn", "skipped")
    assert found["warm-up of calibrator"]["value"].startswith("5.")
    assert outputs(served) == before, "nothing was switched"


def test_whatever_is_wrong_is_told_at_once_and_nothing_is_switched(
    served: Served, tmp_path: Path, inside: Inside
) -> None:
    before = outputs(served)
    for words in (("mute", "dmm"), ("identity", "supply", "HEWLETT-PACKARD,6632A,1,1"), ("reference_lost",)):
        served.fault(*words)
    try:
        status, found, said = looked_at(inside, served, tmp_path)
    finally:
        served.fault("clear")
    assert status == 3
    failed = {name: row["value"] for name, row in found.items() if row["status"] == "fail"}
    assert failed == {
        "identity of supply": "B-INST-002",
        "identity of dmm": "B-INST-001",
    }
    assert "B-RUN-081" in said
    assert all(name in said for name in failed)
    assert outputs(served) == before


def test_a_bench_in_use_is_left_alone(served: Served, tmp_path: Path, inside: Inside) -> None:
    found_station = load_station(served.station)
    keys = bus_keys(entry.resource for entry in found_station.instruments.values())
    with BenchLock(keys, "run", WallClock()):
        status, found, said = looked_at(inside, served, tmp_path)
    assert status == 2
    assert "B-RUN-080" in said
    assert "'run' of" in found["second controller"]["text"]
    assert not any(name.startswith("identity of ") for name in found)


BY = ("--by", "A. Technician")


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("bench"), of="gnc_bench_sim") as served:
        yield served


def as_a_real_one(served: Served, folder: Path) -> Path:
    """The served station as a file that says it is real."""
    lines = served.station.read_text().replace("simulated: true", "simulated: false").splitlines()
    path = folder / "station.yaml"
    path.write_text("\n".join(line for line in lines if not line.startswith("control:")))
    return path


def first_contact(inside: Inside, station: Path, *words: str) -> list[dict[str, str]]:
    done = inside("check", "gnc_bias", "--station", str(station), "--live", "--json", *words)
    findings = json.loads(done.stdout)["preflight"]["findings"]
    return [one for one in findings if one["name"].startswith("first contact")]


def test_a_record_lets_a_real_bench_use_the_driver(table: Served, tmp_path: Path, inside: Inside) -> None:
    station = as_a_real_one(table, tmp_path)
    (found,) = first_contact(inside, station)
    assert (found["name"], found["status"]) == ("first contact of turntable", "fail")
    assert ":stat:msg? qerror" in found["text"]
    (found,) = first_contact(inside, station, "--uncommissioned", "the first day of it")
    assert found["status"] == "warn"
    assert "the first day of it" in found["text"]
    done = bench("commission", "turntable", "--station", str(station), *BY, "--yes")
    assert done.returncode == 0, done.stdout
    lines = done.stdout.splitlines()
    assert lines.index("as documented  *IDN? -> ACUTRONIC,ACUTROL3000,SIMTBL,1.0") < lines.index(
        "as documented  :lim:rate pos,1,5 -> :lim:rate? pos,1 5.0000"
    ) < lines.index("as documented  :int:close 1")  # fmt: skip
    assert "26 as documented, 1 not tried" in done.stdout
    (record,) = (tmp_path / "commissioning").glob("turntable_*.json")
    assert json.loads(record.read_text())["by"] == "A. Technician"
    assert record.with_suffix(".md").is_file()
    (found,) = first_contact(inside, station)
    assert found["status"] == "ok"
    assert table.state()["instruments"]["turntable"]["interlocks"] == ["Open"] * 3


@pytest.mark.parametrize(("role", "code"), [("calibrator", "B-COM-002"), ("teapot", "B-CLI-003")])
def test_a_bench_inside_the_process_and_a_role_that_is_not_there(inside: Inside, role: str, code: str) -> None:
    done = inside("commission", role, "--station", "af_bench_sim", *BY)
    assert (done.returncode, code in done.stderr) == (2, True)


def test_a_driver_without_a_table(table: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hand, "manual_of", lambda driver: None)
    with pytest.raises(InputError, match="B-COM-001: "):
        hand.commission("turntable", str(as_a_real_one(table, tmp_path)), "somebody", yes=False)
