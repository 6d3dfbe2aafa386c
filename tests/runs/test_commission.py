"""``bench commission`` against a served bench: transcript, record, and what the pre-flight makes of it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from older_firmware import OlderFirmware
from rehearsal import Inside, bench, main_of
from served import Served, serving

from sim_instruments import acutrol_3000

pytestmark = pytest.mark.waits
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
        "as documented  :lim:rate pos,1,5"
    ) < lines.index("as documented  :int:close 1")  # fmt: skip
    assert "24 as documented, 1 not tried" in done.stdout
    (record,) = (tmp_path / "commissioning").glob("turntable_*.json")
    assert json.loads(record.read_text())["by"] == "A. Technician"
    assert record.with_suffix(".md").is_file()
    (found,) = first_contact(inside, station)
    assert found["status"] == "ok"
    state = table.state()["instruments"]["turntable"]
    assert state["interlocks"] == ["Open"] * 3


def test_a_gateway_that_is_not_there(table: Served, tmp_path: Path, inside: Inside) -> None:
    station = as_a_real_one(table, tmp_path)
    station.write_text(re.sub(r"(hislip\d),\d+", r"\1,9", station.read_text()))
    done = inside("check", "gnc_bias", "--station", str(station), "--live", "--json")
    assert done.returncode == 3
    findings = json.loads(done.stdout)["preflight"]["findings"]
    absent = [one for one in findings if one["name"].startswith("identity of ")]
    assert {one["status"] for one in absent} == {"fail"}
    assert {one["value"] for one in absent} == {"B-RUN-002"}
    (found,) = first_contact(inside, station)
    assert (found["status"], found["text"]) == ("skipped", "no instrument whose commands are known answers")


@pytest.mark.parametrize(("role", "code"), [("calibrator", "B-COM-002"), ("teapot", "B-CLI-003")])
def test_a_bench_inside_the_process_and_a_role_that_is_not_there(inside: Inside, role: str, code: str) -> None:
    done = inside("commission", role, "--station", "af_bench_sim", *BY)
    assert (done.returncode, code in done.stderr) == (2, True)


def test_a_driver_without_a_table(table: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from bench.commands.hand import commission
    from bench.model.errors import InputError

    monkeypatch.setattr(commission, "manual_of", lambda driver: None)
    with pytest.raises(InputError) as caught:
        commission.commission("turntable", str(as_a_real_one(table, tmp_path)), "somebody", yes=False)
    assert caught.value.code == "B-COM-001"


def calibrated(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Any:
    """Return the estimates of a short calibration on the turntable, in virtual time."""
    words = [f"--set={name}={value}" for name, value in (("position", "10 s"), ("check_position", "10 s"))]
    line = ("run", "gnc_imu_calibration", "--clock", "virtual", "--seed", "3", "--out", str(folder), *words)
    assert main_of(monkeypatch, *line, "--set=warm_up=1 min") == 0
    (results,) = folder.glob("*/results.json")
    return json.loads(results.read_text())["estimates"]


@pytest.mark.slow
def test_a_campaign_with_the_differing_firmware_has_the_same_estimates(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usual = calibrated(monkeypatch, tmp_path / "usual")
    monkeypatch.setattr(acutrol_3000, "SIMULATOR", OlderFirmware)
    older = calibrated(monkeypatch, tmp_path / "older")
    assert len(usual) > 20
    assert older == usual
    (report,) = (tmp_path / "older").glob("*/report.html")
    assert re.search(r"ACUTROL3000.{,200}\b0\.9\b", report.read_text(), re.DOTALL)
