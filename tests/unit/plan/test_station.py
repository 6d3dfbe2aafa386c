"""Station files: standards, ranges, safe order, options, certificates, interlocks, and each mistake with its place."""

from datetime import date
from operator import attrgetter
from pathlib import Path

import pytest
from plan_sample import FLAT, ROOT, SEQUENCE, TRACED, changed, make_bench, mistakes

from bench.model.drivers import driver_class
from bench.model.errors import InputErrors
from bench.model.lab import find_shipped
from bench.model.yamlio import parse_yaml
from bench.plan import Plan, Station, compile_sequence, load_station, summarise, unwatched
from bench.plan.served import served_station
from bench.plan.station import StationFile
from sim_instruments.fluke_5720a import CURRENT_RANGES

LINKS = "links:                          # frame"
PROBE = """standards:
  reference_probe: {{model: PT100, serial: R-1, certificate: C-1, calibrated: "1999-11-01", due: "{due}",
    stated: {{r0: {r0}, a: 3908.1 ppm/degC, b: -0.5774 ppm/degC2}}}}

"""
BOARD = "PRLGX-TCPIP::10.0.0.7::1234::INTFC"
ABORT = "{signal: unit_temperature, high: 65 degC, dwell: 10 s, action: abort}"
MISTAKES = [
    ("- {range: 22 mA, gain", "- {range: 23 mA, gain", "B-PLAN-064 B-PLAN-065"),
    ("- {range: 22 mA, gain", "- {range: 2.2 mA, gain", "B-PLAN-064 B-PLAN-064"),
    ("- {range: 22 mA, rel", "- {range: 23 mA, rel", "B-PLAN-065 B-PLAN-064"),
    (f"        - {{range: 22 mA, relative: 20 ppm, floor: 40 nA{TRACED}\n", "", "B-PLAN-064"),
    ("resource: GPIB0::7::INSTR", "resource: GPIB::4", "B-PLAN-013"),
    ("resource: GPIB0::7::INSTR", "resource: GPIB0:7:INSTR", "B-PLAN-012"),
    ("resource: GPIB0::22::INSTR", "resource: TCPIP0::10.0.0.1::inst0::INSTR", ""),
    ("world:", f"adapters: [{BOARD}]\nworld:", ""),
    ("name: af_converter", "name: af_convertor", "B-PLAN-014"),
    ('    noise: "on"', '    nois: "on"', "B-PLAN-004"),
    ('    noise: "on"', "    noise: maybe", "B-PLAN-015"),
    ("master_error_ppm: null", "master_error_ppm: large", "B-PLAN-015"),
    ("driver: hp_3458a", "driver: hp_3459a", "B-PLAN-011"),  # no shipped sequence uses it
    ("options: {slot: 1}", "options: {slit: 1}", "B-INST-020"),
    ("options: {slot: 1}", "options: {slot: 11}", "B-INST-020"),
    ("  port_b: {frame", "  port_b: {frame: ngu_b, baud: 115200}\n  supply: {frame", "B-PLAN-013"),
    ('due: "2000-11-01"\n      uncertainty', 'due: "2000-01-01"\n      uncertainty', ""),
    ('due: "2000-11-01"\n      uncertainty', 'due: "1999-12-31"\n      uncertainty', "B-PLAN-063"),
    ('calibrated: "1999-11-01"', 'calibrated: "2000-02-01"', "B-PLAN-063"),
    ("    standard: {model: 34401A, serial", "    # {model: 34401A, serial", ""),
    ("    standard: {model: E3631A, serial", "    # {model: E3631A, serial", ""),
    ('    standard: {model: "7002", serial', "    # {model: 7002, serial", "B-PLAN-062"),
    ("- {range: 22 mA, relative: 20 ppm, floor: 40 nA", "- {range: 22 mA, relative: 20 ppm, floor: 41 nA", ""),
    ("floor: 7 nA, specification: relative, age: 2160 h", "floor: 7 nA, specification: relative, age: 1465 h", ""),
    ("floor: 7 nA, specification: relative, age: 2160 h", "floor: 7 nA, specification: relative, age: 1464 h",
     "B-PLAN-130"),
    ("floor: 7 nA, specification: relative", "floor: 7 nA, specification: absolute", "B-YAML-012"),
    ("floor: 7 nA, specification: relative", "floor: 7 nA, specification: traceable", "B-YAML-013"),
    ("floor: 7 nA, specification: relative, ", "floor: 7 nA, ", "B-YAML-012"),
    (f"floor: 7 nA{TRACED}", "floor: 7 nA, specification: relative}", "B-YAML-012"),
    (f"floor: 7 nA{TRACED}", "floor: 7 nA, specification: absolute, common_with: one resistor}", ""),
    (f"floor: 7 nA{TRACED}", "floor: 7 nA, common_with: one resistor}", "B-YAML-012"),
    ("      corrections:", "      traceability: 3 ppm\n      corrections:", "B-YAML-012"),
    ("limits: {current: [0 A, 220 mA]}", "limits: {current: [220 mA, 0 A]}", "B-YAML-012"),
    ("limits: {current: [0 A, 220 mA]}", "limits: {current: [0 A, 220 mV]}", "B-YAML-012"),
    ('calibrated: "1999-11-01"', 'calibrated: "2000-12-01"', "B-YAML-012"),
    ("simulated: true", "simulated: false", "B-YAML-012"),
    (ABORT, ABORT.replace("65 degC,", "65 degC, release_high: 66 degC,"), "B-PLAN-081"),
    ("links:", "guard: {limits: {chamber_air: 50 degC}}\nlinks:", "B-YAML-012"),
]  # fmt: skip


@pytest.fixture(scope="module")
def station() -> Station:
    return load_station(find_shipped("stations", "af_bench_sim"))


def test_the_shipped_station(station: Station) -> None:
    """The current goes off before a relay moves, power goes last; the register is in SI units, lowest range first."""
    resources = [entry["resource"] for entry in station.wiring()["instruments"].values()]
    assert len(resources) == len(set(resources)) == 10
    assert (set(station.wiring()["links"]), station.simulated) == ({"port_a", "port_b"}, True)
    order = station.safe_order
    assert order[:3] == ("calibrator", "switch", "chamber")
    assert order.index("supply") > order.index("aux_supply") > order.index("function_generator")
    standards = station.standards()
    assert set(standards) == set(station.instruments)
    calibrator = standards["calibrator"]
    assert calibrator["due"] == "2000-11-01"
    table_2 = {
        2.2e-4: (2e-5, 6e-9),
        2.2e-3: (2e-5, 7e-9),
        2.2e-2: (2e-5, 4e-8),
        0.22: (2e-5, 7e-7),
        2.2: (3.2e-5, 1.2e-5),
    }
    assert {u["range_A"]: (u["relative"], u["floor_A"]) for u in calibrator["uncertainty"]} == table_2
    assert all(c["gain"] == c["offset_A"] == 0.0 for c in calibrator["corrections"])
    assert station.ranges_A("calibrator") == tuple(table_2)
    assert station.ranges_A("nobody") == ()


def probe(due: str = "2000-11-01", r0: str = "100.0123 ohm") -> tuple[str, str]:
    return LINKS, PROBE.format(due=due, r0=r0) + LINKS


def test_a_certificate_may_state_degrees_of_freedom_and_values(tmp_path: Path) -> None:
    make_bench(tmp_path, station=("certificate: SIM-0001", "certificate: SIM-0001\n      degrees_of_freedom: 12"))
    register = load_station(tmp_path / "stations" / "af_bench_sim.yaml").standards()
    assert register["calibrator"]["dof"] == 12.0
    assert "dof" not in register["switch"]
    make_bench(tmp_path / "b", station=("certificate: SIM-0001", "certificate: SIM-0001\n      degrees_of_freedom: 0"))
    with pytest.raises(InputErrors):
        load_station(tmp_path / "b" / "stations" / "af_bench_sim.yaml")
    make_bench(tmp_path, station=probe())
    entry = load_station(tmp_path / "stations" / "af_bench_sim.yaml").standards()["reference_probe"]
    assert entry["stated"]["r0"] == {"value": 100.0123, "unit": "ohm"}
    assert entry["stated"]["a"] == {"value": pytest.approx(3.9081e-3, rel=1e-15), "unit": "1/degC"}
    assert entry["stated"]["b"] == {"value": pytest.approx(-5.774e-7, rel=1e-15), "unit": "1/degC2"}
    assert (entry["driver"], entry["certificate"], entry["due"]) == ("", "C-1", "2000-11-01")


@pytest.mark.parametrize(
    "path", [*ROOT.glob("stations/*_sim.yaml"), *ROOT.glob("examples/*/stations/*.yaml")], ids=attrgetter("stem")
)
def test_a_served_station_is_the_same_but_for_places_and_dates(path: Path) -> None:
    station = load_station(path)
    places = {role: f"TCPIP0::h::hislip{at}::INSTR" for at, role in enumerate(station.instruments)}
    urls = dict.fromkeys(station.links, "/dev/null")
    text = served_station(station, places, urls, Path("/control.sock"), date(2026, 1, 1))
    again, dates = parse_yaml(text, "served.yaml", StationFile).model, {"calibrated", "due"}
    entries = again.instruments | again.standards, station.file.instruments | station.file.standards
    served, written = (
        {name: one.model_dump(exclude={"resource": True, "standard": dates, **dict.fromkeys(dates, True)})
         for name, one in either.items()} for either in entries
    )  # fmt: skip
    assert served == written
    assert {str(one.due) for one in again.standards.values()} <= {"2026-12-02"}


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (probe(due="1999-12-31"), "B-PLAN-063", "reference_probe: calibrated 1999-11-01, due 1999-12-31"),
        (probe(r0="100.0123"), "B-YAML-012", "is not a quantity with its unit"),
        ((LINKS, PROBE.replace("reference_probe", "supply").format(due="2000-11-01", r0="1 ohm") + LINKS),
         "B-YAML-012", "'supply' is an instrument"),
        (("GPIB0::22::INSTR", "TCPIP0::h::5025::SOCKET"), "B-PLAN-012",
         "dmm (hp_3458a): TCPIP0::h::5025::SOCKET through '@bench' gives no serial poll"),
        (("GPIB0::22::INSTR", BOARD), "B-PLAN-012", "is an interface, not an instrument"),
        (("driver: hp_3458a\n", "driver: hp_3458a\n    serial_line: {baud: 9600}\n"), "B-YAML-012", "no serial port"),
        (("world:", "adapters: [TCPIP::h::1234::SOCKET]\nworld:"), "B-YAML-012", "write it as PRLGX-TCPIP0::"),
        (("world:", f"adapters: [{BOARD}, {BOARD}]\nworld:"), "B-YAML-012", "one number of a GPIB board"),
    ],
)  # fmt: skip
def test_a_wrong_entry_is_one_clear_mistake(tmp_path: Path, change: tuple[str, str], code: str, said: str) -> None:
    found = mistakes(make_bench(tmp_path, station=change))
    assert [error.code for error in found] == [code]
    assert said in found[0].message


@pytest.mark.parametrize(("old", "new", "codes"), MISTAKES)
def test_a_mistake_in_the_station_is_found_before_the_run(tmp_path: Path, old: str, new: str, codes: str) -> None:
    found = mistakes(make_bench(tmp_path, station=(old, new)))
    assert [error.code for error in found] == codes.split()
    assert all("stations" in error.where for error in found)


def test_a_range_that_is_used_needs_an_uncertainty_under_its_own_name(tmp_path: Path) -> None:
    lines = f"        - {{range: 2.2 mA, relative: 20 ppm, floor: 7 nA{TRACED}\n"
    text = changed('range: "{calibrator.range}", ', "")  # the condition would have been the first to notice
    found = mistakes(make_bench(tmp_path, text, station=(lines, "")))
    assert [error.code for error in found] == ["B-PLAN-066", "B-PLAN-064"]
    assert "the plan uses 2.2 mA; the register has 220 uA, 22 mA, 220 mA, 2.2 A" in found[0].message
    found = mistakes(make_bench(tmp_path, station=("- {range: 2.2 mA, rel", "- {range: 2 mA, rel")))
    assert [error.code for error in found] == ["B-PLAN-066", "B-PLAN-065", "B-PLAN-064", "B-PLAN-076"]
    assert "range 0.002 A, but calibrator is on 0.0022 A" in found[3].message


def test_the_driver_and_the_simulator_have_the_same_ladder() -> None:
    from bench.plan.station import driver_ladder_A

    assert driver_ladder_A("fluke_5720a") == tuple(one.full_scale_A for one in CURRENT_RANGES)
    assert driver_ladder_A("keithley_7002") == ()


@pytest.mark.parametrize(
    ("overrides", "code"),
    [
        ({"world.noise": "maybe"}, "B-PLAN-015"),
        ({"world.master_error_ppm": "nan"}, "B-PLAN-015"),
        ({"world.master_error_ppm": "-50"}, ""),
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


PLACE = "simulated: true\n"


def test_a_reason_is_taken(tmp_path: Path) -> None:
    path = make_bench(tmp_path, station=(PLACE, f"{PLACE}arm_after_hold: {{never: locked enclosure}}\n"))
    assert compile_sequence(path).station.never_armed == "locked enclosure"
    assert compile_sequence(make_bench(tmp_path)).station.never_armed == ""


@pytest.mark.parametrize("text", ["{never: }", '{never: ""}', "no", "{}", "{always: x}"])
def test_without_a_reason_it_is_refused(tmp_path: Path, text: str) -> None:
    found = mistakes(make_bench(tmp_path, station=(PLACE, f"{PLACE}arm_after_hold: {text}\n")))
    assert found
    assert all("af_bench_sim.yaml:5:" in error.where for error in found)


AIR = "  air: {signal: lab_air, of: logger, channel: 101, high: 24 degC, action: warn"


def with_section(folder: Path, section: str) -> Plan:
    (folder / "sequences").mkdir()
    path = folder / "sequences" / "sample.yaml"
    path.write_text(SEQUENCE + section)
    return compile_sequence(path, None, {})


def test_a_sequence_adds_to_the_interlocks_of_its_station_and_replaces_by_name(tmp_path: Path) -> None:
    plain = {rule.name: rule for rule in compile_sequence("scale_factor_short", None, {}).interlocks}
    section = (
        "interlocks:\n  chamber_air: {signal: chamber_air, high: 40 degC, release_high: 38 degC, dwell: 2 min, "
        "action: hold}\n  mine: {signal: unit_slope, low: -1 degC/min, high: 1 degC/min, action: warn}\n"
    )
    plan = with_section(tmp_path, section)
    rules = {rule.name: rule for rule in plan.interlocks}
    assert set(rules) == {*plain, "mine"}
    air = rules["chamber_air"]
    assert (air.high, air.release_high, air.low, air.dwell_s, air.release_after_s) == (40.0, 38.0, None, 120.0, 120.0)
    assert (air.action, air.stale_s) == ("hold", None)
    assert rules["mine"].release_low == -1.0
    assert rules["laboratory_air"] == plain["laboratory_air"]
    assert air.where.startswith(str(tmp_path))


def test_interlocks_do_not_change_the_hash_of_the_steps(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    assert with_section(tmp_path, "").sha256 == with_section(other, f"interlocks:\n{AIR}}}\n").sha256


@pytest.mark.parametrize(
    ("section", "code", "words"),
    [
        ("  a: {signal: lab_airr, high: 1 degC, action: warn}", "B-PLAN-080", "did you mean 'lab_air'"),
        ("  a: {signal: link_loss, high: 1 %, action: warn}", "B-PLAN-080", "which link"),
        ("  a: {signal: unit_temperature, of: dmm, high: 1 degC, action: warn}", "B-PLAN-080", "needs no 'of'"),
        ("  a: {signal: lab_air, of: logger, high: 1 degC, action: warn}", "B-PLAN-080", "needs a channel"),
        ("  a: {signal: supply_current, action: warn}", "B-PLAN-081", "neither 'high' nor 'low'"),
        (f"{AIR}, release_high: 24.1 degC}}", "B-PLAN-081", "beyond its trip level"),
        (f"{AIR}, low: 24 degC}}", "B-PLAN-081", "not below high"),
        (f"{AIR}, release_low: 21 degC}}", "B-PLAN-081", "no 'low' to release from"),
        (f"{AIR}, low: 22 degC, release_low: 23.5 degC, release_high: 23 degC}}", "B-PLAN-081", "never release"),
        (f"{AIR.replace('logger', 'dmm')}}}", "B-PLAN-080", "scans no channels"),
        (f"{AIR.replace('101', '9')}}}", "B-PLAN-080", "[101, 102, 103]"),
        ("  a: {signal: supply_current, high: 3 V, action: warn}", "B-PLAN-082", "'3 V'"),
        ("  a: {signal: rate_step, high: 5 Hz, action: retake}", "B-PLAN-083", "too late"),
    ],
)
def test_a_wrong_interlock_is_told_with_its_place(tmp_path: Path, section: str, code: str, words: str) -> None:
    with pytest.raises(InputErrors) as caught:
        with_section(tmp_path, f"interlocks:\n{section}\n")
    found = [one for one in caught.value.errors if one.code == code]
    assert found, caught.value
    assert words in found[0].message
    line = SEQUENCE.count("\n") + 2
    assert f"sample.yaml:{line}:" in found[0].where


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("  webhook: {url: http://example.org/hook}", "https"),
        ("  webhook: {url: https://me:word@example.org/hook}", "token_env"),
        ("  webhook: {url: https://example.org/hook, url_env: HOOK}", "either"),
        ("  email: {host: mail.example.org, sender: bench@example.org, to: []}", "to"),
        ("  heartbeat: 1 s", "below the limit"),
        ("  on: [sometimes]", "hold"),
        ("  on: [end]", "nobody is told"),
        ("  email: {host: mail.example.org, sender: b@example.org, to: [b@example.org]}\n  heartbeat: 1 h", "webhook"),
    ],
)
def test_a_wrong_notification_is_refused(tmp_path: Path, section: str, words: str) -> None:
    found = mistakes(make_bench(tmp_path, station=("links:", f"notify:\n{section}\nlinks:")))
    assert any(words in str(error) for error in found), found


def test_a_sequence_may_ask_for_early_verdicts(tmp_path: Path) -> None:
    plan = with_section(tmp_path, "early: {after: 30 min, every: 2 h, on_fail: hold, max_lost: 0.5 %}\n")
    assert (plan.early.after, plan.early.every, plan.early.on_fail) == (1800.0, 7200.0, "hold")
    assert plan.early.max_lost == 0.005


def test_a_plan_that_no_interlock_watches_says_so(tmp_path: Path) -> None:
    station = (ROOT / "stations" / "af_bench_sim.yaml").read_text(encoding="utf-8")
    before, _, behind = station.partition("interlocks:\n")
    bare = tmp_path / "bare.yaml"
    bare.write_text(before + behind[behind.index("# What the live page draws") :], encoding="utf-8")
    disk = tmp_path / "disk.yaml"
    only = "interlocks:\n  disk: {signal: disk_time, low: 1 h, action: hold}\n"
    disk.write_text(before + only + behind[behind.index("# What the live page draws") :], encoding="utf-8")
    sequence = find_shipped("sequences", "scale_factor_short")
    assert "no interlock is declared" in unwatched(compile_sequence(sequence, load_station(bare), {}))[0]
    assert "no interlock watches the chamber" in unwatched(compile_sequence(sequence, load_station(disk), {}))[0]
    watched = compile_sequence(sequence, None, {})
    assert unwatched(watched) == summarise(watched).unwatched == ()


@pytest.mark.parametrize(
    ("library", "address", "dmm", "tagger"),
    [
        ("@py", "GPIB0::22::INSTR", "", ""),
        ("@py", "TCPIP0::10.0.0.1::hislip0::INSTR", "", ""),
        ("@py", "tcpip0::10.0.0.1::5025::socket", "serial poll", "END, device clear"),
        ("@py", "ASRL/dev/ttyUSB0::INSTR", "serial poll", "END, device clear"),
        ("@py", "USB0::0x0957::0x0607::MY1::INSTR", "serial poll", "device clear"),
        ("@ivi", "USB0::0x0957::0x0607::MY1::INSTR", "", ""),
        ("@ivi", "ASRL1::INSTR", "serial poll", "END, device clear"),
        ("@absent", "GPIB0::22::INSTR", "", ""),
        ("adapters", "GPIB0::22::INSTR", "", "END"),
    ],
)
def test_what_an_address_does_not_give(library: str, address: str, dmm: str, tagger: str) -> None:
    found = [driver_class(name).lacking(library, address) for name in ("hp_3458a", "pendulum_cnt_91")]
    assert [", ".join(needs) for needs in found] == [dmm, tagger]
