"""Standards without an interface, and what else a certificate states: checked, in the manifest, and served again."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import pytest
from plan_sample import make_bench, mistakes

from bench.model.yamlio import parse_yaml
from bench.plan.served import served_station
from bench.plan.station import StationFile, load_station

LINKS = "links:                          # frame"
PROBE = """standards:
  reference_probe: {{model: PT100, serial: R-1, certificate: C-1, calibrated: "1999-11-01", due: "{due}",
    stated: {{r0: {r0}, a: 3908.1 ppm/degC, b: -0.5774 ppm/degC2}}}}

"""


def probe(due: str = "2000-11-01", r0: str = "100.0123 ohm") -> tuple[str, str]:
    return LINKS, PROBE.format(due=due, r0=r0) + LINKS


def test_the_manifest_has_what_the_certificate_states(tmp_path: Path) -> None:
    make_bench(tmp_path, station=probe())
    entry = load_station(tmp_path / "stations" / "af_bench_sim.yaml").standards()["reference_probe"]
    assert entry["stated"]["r0"] == {"value": 100.0123, "unit": "ohm"}
    assert entry["stated"]["a"] == {"value": pytest.approx(3.9081e-3, rel=1e-15), "unit": "1/degC"}
    assert entry["stated"]["b"] == {"value": pytest.approx(-5.774e-7, rel=1e-15), "unit": "1/degC2"}
    assert (entry["driver"], entry["certificate"], entry["due"]) == ("", "C-1", "2000-11-01")


def test_a_served_station_has_the_same_register(tmp_path: Path) -> None:
    make_bench(tmp_path, station=probe())
    station = load_station(tmp_path / "stations" / "af_bench_sim.yaml")
    places = dict.fromkeys(station.instruments, "TCPIP0::h::hislip0::INSTR")
    urls = dict.fromkeys(station.links, "/dev/null")
    text = served_station(station, places, urls, Path("/control.sock"), date(2026, 1, 1))
    again = parse_yaml(text, "served.yaml", StationFile).model.standards["reference_probe"]
    assert again.stated == station.file.standards["reference_probe"].stated
    assert again.due == date(2026, 12, 2)


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (probe(due="1999-12-31"), "B-PLAN-063", "reference_probe: calibrated 1999-11-01, due 1999-12-31"),
        (probe(r0="100.0123"), "B-YAML-012", "is not a quantity with its unit"),
        ((LINKS, PROBE.replace("reference_probe", "supply").format(due="2000-11-01", r0="1 ohm") + LINKS),
         "B-YAML-012", "'supply' is an instrument"),
    ],
)  # fmt: skip
def test_a_wrong_standard_is_one_clear_mistake(tmp_path: Path, change: tuple[str, str], code: str, said: str) -> None:
    found = mistakes(make_bench(tmp_path, station=change))
    assert [error.code for error in found] == [code]
    assert said in found[0].message
