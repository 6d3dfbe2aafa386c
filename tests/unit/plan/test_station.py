"""Station files: the register of standards and the ranges an instrument has, the safe order, options, certificates."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import pytest
from plan_sample import FLAT, TRACED, changed, make_bench, mistakes

from bench.model.errors import InputErrors
from bench.model.shipped import find_shipped
from bench.model.yamlio import parse_yaml
from bench.plan import Station, load_station
from bench.plan.check.stations import canonical_address
from bench.plan.served import served_station
from bench.plan.station import StationFile
from sim_instruments.fluke_5720a import CURRENT_RANGES

LINKS = "links:                          # frame"
PROBE = """standards:
  reference_probe: {{model: PT100, serial: R-1, certificate: C-1, calibrated: "1999-11-01", due: "{due}",
    stated: {{r0: {r0}, a: 3908.1 ppm/degC, b: -0.5774 ppm/degC2}}}}

"""
MISTAKES = [
    ("- {range: 22 mA, gain", "- {range: 23 mA, gain", ["B-PLAN-064", "B-PLAN-065"]),
    ("- {range: 22 mA, gain", "- {range: 2.2 mA, gain", ["B-PLAN-064", "B-PLAN-064"]),
    ("- {range: 22 mA, rel", "- {range: 23 mA, rel", ["B-PLAN-065", "B-PLAN-064"]),
    (f"        - {{range: 22 mA, relative: 20 ppm, floor: 40 nA{TRACED}\n", "", ["B-PLAN-064"]),
    ("resource: GPIB0::7::INSTR", "resource: GPIB::4", ["B-PLAN-013"]),
    ("resource: GPIB0::7::INSTR", "resource: GPIB0:7:INSTR", ["B-PLAN-012"]),
    ("resource: GPIB0::7::INSTR", "resource: seven", ["B-PLAN-012"]),
    ("name: af_converter", "name: af_convertor", ["B-PLAN-014"]),
    ('    noise: "on"', '    nois: "on"', ["B-PLAN-004"]),
    ('    noise: "on"', "    noise: maybe", ["B-PLAN-015"]),
    ('    noise: "on"', "    noise: 1", ["B-PLAN-015"]),
    ("master_error_ppm: null", "master_error_ppm: large", ["B-PLAN-015"]),
    ("driver: hp_3458a", "driver: hp_3459a", ["B-PLAN-011"]),  # no shipped sequence uses it
    ("options: {slot: 1}", "options: {slit: 1}", ["B-INST-020"]),
    ("options: {slot: 1}", "options: {slot: 11}", ["B-INST-020"]),
    ("options: {slot: 1}", "options: {slot: one}", ["B-INST-020"]),
    ('options: {dialect: "3800"}', "options: {dialect: 3800}", ["B-INST-020"]),
    ('options: {dialect: "3800"}', "options: {safe_state: [hold]}", ["B-INST-020"]),
    ("  port_b: {frame", "  port_b: {frame: ngu_b, baud: 115200}\n  supply: {frame", ["B-PLAN-013"]),
]  # fmt: skip


@pytest.fixture(scope="module")
def station() -> Station:
    return load_station(find_shipped("stations", "af_bench_sim"))


def test_ten_instruments_at_ten_addresses(station: Station) -> None:
    resources = [entry["resource"] for entry in station.wiring()["instruments"].values()]
    assert len(resources) == len(set(resources)) == 10
    assert set(station.wiring()["links"]) == {"port_a", "port_b"}
    assert station.simulated


def test_the_current_goes_off_before_a_relay_moves_and_power_goes_last(station: Station) -> None:
    order = station.safe_order
    assert order[:3] == ("calibrator", "switch", "chamber")
    assert order.index("supply") > order.index("aux_supply") > order.index("function_generator")


def test_the_register_of_standards_is_in_si_units(station: Station) -> None:
    standards = station.standards()
    assert set(standards) == set(station.instruments)
    calibrator = standards["calibrator"]
    assert calibrator["due"] == "2000-11-01"
    table_2 = [
        (2.2e-4, 2e-5, 6e-9),
        (2.2e-3, 2e-5, 7e-9),
        (2.2e-2, 2e-5, 4e-8),
        (0.22, 2e-5, 7e-7),
        (2.2, 3.2e-5, 1.2e-5),
    ]
    assert [(u["range_A"], u["relative"], u["floor_A"]) for u in calibrator["uncertainty"]] == table_2
    assert all(c["gain"] == c["offset_A"] == 0.0 for c in calibrator["corrections"])


def test_ranges_of_a_standard_come_lowest_first(station: Station) -> None:
    assert station.ranges_A("calibrator") == (2.2e-4, 2.2e-3, 2.2e-2, 0.22, 2.2)


def test_a_role_without_a_standard_has_no_ranges(station: Station) -> None:
    assert station.ranges_A("nobody") == ()


def test_options_left_to_the_world_are_absent_until_they_are_set(station: Station) -> None:
    assert "master_error_ppm" not in station.world_options
    assert station.with_options({"master_error_ppm": "-50"}).world_options["master_error_ppm"] == "-50"
    assert "master_error_ppm" not in station.world_options


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"2000-11-01"', '"1.11.2000"', "'1.11.2000' is not a date; write YYYY-MM-DD"),
        ("links:", "guard: {limits: {chamber_air: 50 degC}}\nlinks:", "hard limit chamber_air of 50 degC is not above"),
    ],
)
def test_a_mistake_in_a_station_file_says_what_is_due(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "mine.yaml"
    text = find_shipped("stations", "af_bench_sim").read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputErrors) as caught:
        load_station(path)
    assert words in str(caught.value)


def probe(due: str = "2000-11-01", r0: str = "100.0123 ohm") -> tuple[str, str]:
    return LINKS, PROBE.format(due=due, r0=r0) + LINKS


def test_degrees_of_freedom_of_a_certificate_are_stated_or_absent(tmp_path: Path) -> None:
    make_bench(tmp_path, station=("certificate: SIM-0001", "certificate: SIM-0001\n      degrees_of_freedom: 12"))
    register = load_station(tmp_path / "stations" / "af_bench_sim.yaml").standards()
    assert register["calibrator"]["dof"] == 12.0
    assert "dof" not in register["switch"]
    make_bench(tmp_path / "b", station=("certificate: SIM-0001", "certificate: SIM-0001\n      degrees_of_freedom: 0"))
    with pytest.raises(InputErrors):
        load_station(tmp_path / "b" / "stations" / "af_bench_sim.yaml")


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


@pytest.mark.parametrize(("old", "new", "codes"), MISTAKES)
def test_what_only_the_run_would_have_met(tmp_path: Path, old: str, new: str, codes: list[str]) -> None:
    found = mistakes(make_bench(tmp_path, station=(old, new)))
    assert [error.code for error in found] == codes
    assert all("stations" in error.where for error in found)


def test_a_correction_without_uncertainty_names_the_ranges_b_plan_064(tmp_path: Path) -> None:
    found = mistakes(make_bench(tmp_path, station=("- {range: 22 mA, gain", "- {range: 23 mA, gain")))
    assert "the correction of 23 mA belongs to no range with an uncertainty (220 uA, 2.2 mA, 22 mA" in found[0].message
    assert "fluke_5720a has 220 uA, 2.2 mA, 22 mA, 220 mA, 2.2 A" in found[1].message


@pytest.mark.parametrize("line", ["relative: -20 ppm, floor: 7 nA", "relative: 20 ppm, floor: -7 nA"])
def test_an_uncertainty_is_never_negative(tmp_path: Path, line: str) -> None:
    found = mistakes(make_bench(tmp_path, station=("relative: 20 ppm, floor: 7 nA", line)))
    assert [error.code for error in found] == ["B-YAML-012"]
    assert "is below the limit 0" in found[0].message


def test_a_range_that_is_used_needs_an_uncertainty_b_plan_066(tmp_path: Path) -> None:
    lines = f"        - {{range: 2.2 mA, relative: 20 ppm, floor: 7 nA{TRACED}\n"
    text = changed('range: "{calibrator.range}", ', "")  # the condition would have been the first to notice
    found = mistakes(make_bench(tmp_path, text, station=(lines, "")))
    assert [error.code for error in found] == ["B-PLAN-066", "B-PLAN-064"]
    assert "the plan uses 2.2 mA; the register has 220 uA, 22 mA, 220 mA, 2.2 A" in found[0].message


def test_a_range_wrongly_named_in_the_register_does_not_pass_as_the_range_of_a_record(tmp_path: Path) -> None:
    found = mistakes(make_bench(tmp_path, station=("- {range: 2.2 mA, rel", "- {range: 2 mA, rel")))
    assert [error.code for error in found] == ["B-PLAN-066", "B-PLAN-065", "B-PLAN-064", "B-PLAN-076"]
    assert "range 0.002 A, but calibrator is on 0.0022 A" in found[3].message


def test_the_driver_and_the_simulator_have_the_same_ladder() -> None:
    from bench.plan.drivers import driver_ladder_A

    assert driver_ladder_A("fluke_5720a") == tuple(one.full_scale_A for one in CURRENT_RANGES)
    assert driver_ladder_A("keithley_7002") == ()


@pytest.mark.parametrize(
    ("written", "full"),
    [
        ("GPIB::4", "GPIB0::4::INSTR"),
        ("gpib0::04::0::instr", "GPIB0::4::INSTR"),
        ("GPIB1::4::2::INSTR", "GPIB1::4::2::INSTR"),
        ("TCPIP::10.0.0.2::INSTR", "TCPIP0::10.0.0.2::INSTR"),
        ("TCPIP0::host::5025::SOCKET", "TCPIP0::HOST::5025::SOCKET"),
        ("ASRL/dev/ttyUSB0::INSTR", "ASRL/dev/ttyUSB0::INSTR"),
        ("asrl3", "ASRL3::INSTR"),
        ("GPIB0::INSTR", None),
        ("GPIB0::four::INSTR", None),
        ("GPIB0::4::::INSTR", None),
        ("GPIB0", None),
    ],
)
def test_one_address_in_several_spellings(written: str, full: str | None) -> None:
    assert canonical_address(written) == full


@pytest.mark.parametrize(
    ("overrides", "code"),
    [
        ({"world.noise": "maybe"}, "B-PLAN-015"),
        ({"world.noise": "1"}, "B-PLAN-015"),
        ({"world.master_error_ppm": "off"}, "B-PLAN-015"),
        ({"world.master_error_ppm": "nan"}, "B-PLAN-015"),
        ({"world.master_error_ppm": "-50"}, ""),
        ({"world.calibrator_gain": "off"}, ""),
    ],
)
def test_values_of_world_options(tmp_path: Path, overrides: dict[str, str], code: str) -> None:
    found = mistakes(make_bench(tmp_path), overrides)
    assert [error.code for error in found] == ([code] if code else [])
    assert all(error.where == f"--set {next(iter(overrides))}" for error in found)


def test_a_driver_without_a_simulator_b_plan_016(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.plan.check.stations.simulator_module", lambda name: None if "3458" in name else name)
    found = mistakes(make_bench(tmp_path, FLAT))
    assert [error.code for error in found] == ["B-PLAN-016"]


def test_two_real_links_on_one_port_b_plan_013(tmp_path: Path) -> None:
    path = make_bench(tmp_path, FLAT)
    file = tmp_path / "stations" / "af_bench_sim.yaml"
    text = file.read_text().replace("simulated: true", "simulated: false").replace('"2000-11-01"', '"2999-11-01"')
    text = text.replace("age: 2160 h, ", "").replace("age: 8760 h, ", "")
    text = text[: text.index("world:")] + text[text.index("instruments:") :]
    file.write_text(text.replace("921600", "921600, url: /dev/ttyS0").replace("115200", "115200, url: /dev/ttyS0"))
    assert [error.code for error in mistakes(path)] == ["B-PLAN-013"]
