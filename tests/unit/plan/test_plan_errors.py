"""Each mistake of a sequence: its code, the line it is reported on, which is where it is declared, and what is said."""

import re
import sys
from binascii import crc_hqx
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from plan_sample import FLAT, SEQUENCE, TRACED, changed, make_bench, mistakes, reworded

from bench.model.drivers import driver_class
from bench.model.errors import InputError
from bench.model.ports import Effect, action
from bench.plan import compile_sequence
from bench.plan.expand import MAX_STEPS

CASES = yaml.safe_load(Path(__file__).with_name("plan_errors.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("old", "new", "codes", "on_line"), CASES["structured"])
def test_a_mistake_in_the_sequence(tmp_path: Path, old: str, new: str, codes: str, on_line: str) -> None:
    text = changed(old, new)
    found = {error.code: error for error in reversed(mistakes(make_bench(tmp_path, text)))}
    assert sorted(found) == sorted(codes.split())
    error = found[codes.partition(" ")[0]]
    assert on_line in text.split("\n")[int(error.where.split(":")[-2]) - 1] + "\n", error


def test_a_level_over_the_full_scale_of_its_channel_b_plan_073(tmp_path: Path) -> None:
    text = changed("point: {current: 0 A", "point: {current: 2 mA", changed("full_scale: 299 mA", "full_scale: 1 mA"))
    found = {error.code: error for error in mistakes(make_bench(tmp_path, text))}
    assert "0.002 A is above the full scale 0.001 A of channel 2" in found["B-PLAN-073"].message


def test_a_frame_without_a_rate_b_plan_048_and_a_station_that_is_not_there_b_plan_045(tmp_path: Path) -> None:
    path = make_bench(tmp_path)
    frame = tmp_path / "frames" / "ngu_a.yaml"
    frame.write_text("\n".join(line for line in frame.read_text().split("\n") if not line.startswith("rate:")))
    assert [error.code for error in mistakes(path)] == ["B-PLAN-048"]
    (found,) = mistakes(make_bench(tmp_path, changed("station: af", "station: xf")))
    assert (found.code, found.where) == ("B-PLAN-045", f"{path}:3:1")


def test_a_station_by_the_path_of_its_file(tmp_path: Path) -> None:
    named = compile_sequence(make_bench(tmp_path))
    (tmp_path / "benches").mkdir()
    moved = (tmp_path / "stations" / "af_bench_sim.yaml").rename(tmp_path / "benches" / "mine.yaml")
    for path in ("../benches/mine.yaml", str(moved)):
        plan = compile_sequence(make_bench(tmp_path, changed("station: af_bench_sim", f"station: {path}")))
        assert plan.station.path == tmp_path / "sequences" / path
        assert (plan.station.name, plan.sha256) == (named.station.name, named.sha256)
    (found,) = mistakes(make_bench(tmp_path, changed("station: af_bench_sim", "station: ../benches/none.yaml")))
    assert (found.code, found.where) == ("B-PLAN-045", f"{tmp_path}/sequences/sample.yaml:3:1")
    (found,) = mistakes(make_bench(tmp_path, changed("station: af_bench_sim", "station: ../frames/ngu_a.yaml")))
    assert (found.code, found.message) == ("B-PLAN-045", "this is a frame, and a station is due")


def test_all_mistakes_are_listed_at_once_in_order(tmp_path: Path) -> None:
    text = changed("verify: calibrator.operating", "verify: calibrator.opera")
    text = changed("range: lowest_that_holds", "range: highest", text)
    text = changed("polarity: \"{polarity}\"}", "polarity: 2}", text)  # fmt: skip
    found = mistakes(make_bench(tmp_path, text))
    assert [error.code for error in found] == ["B-PLAN-052", "B-PLAN-052", "B-PLAN-050"]
    lines = [int(error.where.split(":")[1]) for error in found]
    assert lines == sorted(lines)


@pytest.mark.parametrize(("old", "new", "code"), CASES["flat"])
def test_a_mistake_in_the_flat_form(tmp_path: Path, old: str, new: str, code: str) -> None:
    assert code in [error.code for error in mistakes(make_bench(tmp_path, changed(old, new, FLAT)))]


def test_no_range_of_the_standard_holds_the_level_b_plan_031(tmp_path: Path) -> None:
    ranges = f"        - {{range: 2.2 mA, relative: 20 ppm, floor: 7 nA{TRACED}\n"
    text = (make_bench(tmp_path).parent.parent / "stations" / "af_bench_sim.yaml").read_text()
    start, end = text.index(ranges), text.index("      corrections:")
    corrections = text[end : text.index("  switch:")]
    found = mistakes(make_bench(tmp_path, station=(text[start:end] + corrections, "")))
    assert [error.code for error in found] == ["B-PLAN-031"]
    assert "no range of calibrator in the station file holds 0.001 A" in found[0].message


@pytest.mark.parametrize(
    ("overrides", "code", "says"),
    [
        ({"dwel": "1 s"}, "B-PLAN-003", "did you mean 'dwell'?"),
        ({"world.calibrator_gian": "off"}, "B-PLAN-004", "did you mean 'calibrator_gain'?"),
        ({"dwell": "1 V"}, "B-PLAN-005", "a quantity in s is due"),
        ({"turns": "x"}, "B-PLAN-005", "'x' cannot replace 2: a whole number is due"),
        ({"share": "nan"}, "B-PLAN-005", "a number is due"),
    ],
)
def test_a_mistake_in_set(tmp_path: Path, overrides: dict[str, str], code: str, says: str) -> None:
    numbers = changed("  dwell: 10 s\n", "  dwell: 10 s\n  turns: 2\n  share: 0.5\n")
    more = numbers if set(overrides) & {"turns", "share"} else SEQUENCE
    found = mistakes(make_bench(tmp_path, more), overrides)
    assert [error.code for error in found] == [code]
    assert says in found[0].message
    assert found[0].where == f"--set {next(iter(overrides))}"


def test_loops_that_never_end_are_stopped_b_plan_036(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("expand", "unroll"):
        monkeypatch.setattr(f"bench.plan.{module}.MAX_STEPS", MAX_STEPS // 20)
    values = ", ".join(map(str, range(30)))
    loop = "steps:\n" + "".join(
        f"{'  ' * d}  - for: v{d}\n{'  ' * d}    in: [{values}]\n{'  ' * d}    do:\n" for d in range(4)
    )
    text = changed("steps:\n", f"{loop}            - calibrator.standby\n")
    found = {error.code: error.message for error in mistakes(make_bench(tmp_path, text))}
    assert str(MAX_STEPS // 20) in found["B-PLAN-036"]
    empty = changed("            - calibrator.standby\n", "            - nothing\n", text)
    assert {"B-PLAN-033", "B-PLAN-036"} <= {error.code for error in mistakes(make_bench(tmp_path, empty))}


NO_NAMES = ("../evil", "os.path", "", "_x", "a" * 41, "Fluke", "a b")


@pytest.mark.parametrize(
    ("name", "code"), [*((name, "B-PLAN-010") for name in NO_NAMES), ("base", "B-PLAN-011"), ("nobody", "B-PLAN-011")]
)
def test_a_driver_is_a_plain_name_of_a_module_with_one(name: str, code: str) -> None:
    with pytest.raises(InputError, match=code):
        driver_class(name)


def plant(monkeypatch: pytest.MonkeyPatch, name: str, driver: type) -> None:
    """A driver of this name for one test."""
    module: Any = ModuleType(f"instruments.{name}")
    module.DRIVER, module.__spec__ = driver, ModuleSpec(module.__name__, None)
    monkeypatch.setitem(sys.modules, f"instruments.{name}", module)


class Heater:
    @action(effect=Effect.POWER)
    def output_on(self) -> None: ...


def test_no_safe_state_b_plan_075_and_no_raw_text_b_plan_053(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant(monkeypatch, "test_heater", Heater)
    monkeypatch.setattr("bench.plan.check.stations.simulator_module", lambda name: name)
    text = changed("call: switch.open_all", "call: aux_supply.output_on", FLAT)
    text = changed("record: 10 s", 'send: {aux_supply: "ON"}', text)
    found = mistakes(make_bench(tmp_path, text, ("driver: agilent_e3631a", "driver: test_heater")))
    limits = ["B-PLAN-095", "B-PLAN-095"]  # those of the station are none of the heater's
    assert [error.code for error in found] == [*limits, "B-PLAN-075", "B-PLAN-053", "B-PLAN-075"]


def test_two_switches_must_not_both_be_closed_b_plan_071(tmp_path: Path) -> None:
    text = changed("- calibrator.operate\n", "- matrix.route: {channel: 1, polarity: +}\n      - calibrator.operate\n")
    entry = (
        "  matrix: {driver: keithley_7002, resource: GPIB0::8::INSTR, safe_order: 2, standard: {model: x, serial: x, "
    )
    entry += "certificate: x, calibrated: 1999-11-01, due: 2000-11-01}}\n"
    path = make_bench(tmp_path, text, ("  chamber:\n", entry + "  chamber:\n"))
    assert "B-PLAN-071" in [error.code for error in mistakes(path)]


def test_a_sequence_has_exactly_one_form(tmp_path: Path) -> None:
    for text in (SEQUENCE + FLAT[FLAT.index("timeline:") :], FLAT[: FLAT.index("timeline:")]):
        assert mistakes(make_bench(tmp_path, text))[0].message.startswith("a sequence has either 'steps'")


GNC = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(
    ("old", "new", "code", "says"),
    [
        ("silence: 50 ms", "silence: 50", "B-YAML-012", ""),  # in a frame that can then not be read
        ("limits: {rate: [", "limits: {rat: [", "B-PLAN-095", "no action of turntable (acutrol_3000) takes 'rat'"),
        ("rate: [-360 deg/s, 360 deg/s]", "rate: [-360 deg, 360 deg]", "B-PLAN-095", "is no quantity in deg"),
        ("faults: null", "faults: GNC-02=nosuch", "B-PLAN-015", "nosuch"),
        ("tilt_arcmin: null", "tilt_arcmin: 500", "B-PLAN-015", "tilt_arcmin is '500'"),
        ("tilt_arcmin: null", "tilt_arcmin: 5", "", ""),
    ],
)
def test_a_mistake_in_the_station_or_frame_of_gnc_modules(
    tmp_path: Path, old: str, new: str, code: str, says: str
) -> None:
    for folder in ("sequences", "stations", "frames"):
        (tmp_path / folder).mkdir()
    wrong = Path("frames/gnc_422.yaml" if "silence" in old else "stations/gnc_bench_sim.yaml")
    (tmp_path / wrong).write_text(reworded((GNC / wrong).read_text(), (old, new)))
    path = tmp_path / "sequences" / "gnc_unit_test.yaml"
    path.write_text((GNC / "sequences" / path.name).read_text())
    found = mistakes(path)
    assert [error.code for error in found] == ([code] if code else [])
    assert not code or says in found[0].message


CHANNELS = "  - {numbers: 1-2, kind: gyro, levels: levels}"
STATION_FILE = "af_bench_sim.yaml"


def with_six_channels(text: str) -> str:
    """Return a definition of frames of ten channels with six, its golden frame too."""
    head, _, rest = text.partition("golden: >-\n")
    golden, _, expected = rest.partition("expect:\n")
    frame = bytes.fromhex("".join(golden.split()))
    body = frame[2:4] + frame[4:16] + frame[24:36] + frame[44:-2]
    checked = frame[:2] + body + crc_hqx(body, 0xFFFF).to_bytes(2)
    assert crc_hqx(frame[2:-2], 0xFFFF) == int.from_bytes(frame[-2:])
    head = re.sub(r"(name: [np]pp, type: u16, count: )10", r"\g<1>6", head)
    expected = re.sub(r"([np]pp: \[(?:\d+, ){5}\d+).*", r"\g<1>]", expected)
    return f"{head}golden: {checked.hex()}\nexpect:\n{expected}"


def line_of(error: InputError, folder: Path) -> tuple[str, str]:
    """Return the name of the file an error names, and the text of the line."""
    path, line, _ = error.where.rsplit(":", 2)
    file = next(folder.rglob(Path(path).name))
    return file.name, file.read_text().splitlines()[int(line) - 1]


@pytest.mark.parametrize("number", [11, 41])
def test_a_channel_that_the_unit_does_not_have_b_plan_027(tmp_path: Path, number: int) -> None:
    text = changed(CHANNELS, f"{CHANNELS}\n  - {{numbers: {number}, kind: gyro, levels: levels}}")
    text = changed("in: {channels: 2}", "in: channels", text)
    found = mistakes(make_bench(tmp_path, text))
    declared = [error for error in found if error.code in ("B-PLAN-027", "B-PLAN-052")]
    assert {error.code for error in declared} == {"B-PLAN-027", "B-PLAN-052"}  # neither the frame nor the switch has it
    for error in declared:
        name, line = line_of(error, tmp_path)
        assert (name, f"numbers: {number}" in line) == ("sample.yaml", True), error


def test_a_channel_beyond_those_of_frame_or_link_is_named_where_it_is_declared_or_used(tmp_path: Path) -> None:
    found = mistakes(
        make_bench(
            tmp_path, changed('channel: "{channel}", polarity: "{polarity}"', 'channel: 11, polarity: "{polarity}"')
        )
    )
    [error] = [error for error in found if error.code == "B-PLAN-052"]
    assert "channel: 11" in line_of(error, tmp_path)[1]
    found = mistakes(make_bench(tmp_path, changed("port_a: ngu_a", "port_a: ngu_b")))
    error = next(error for error in found if error.code == "B-PLAN-027")
    assert "counts no pulses" in error.message
    assert line_of(error, tmp_path)[1].startswith("frame: {port_a: ngu_b")


def test_a_frame_with_fewer_channels_b_plan_027(tmp_path: Path) -> None:
    path = make_bench(tmp_path, changed("1-2, kind", "1-7, kind"))
    frame = tmp_path / "frames" / "ngu_a.yaml"
    frame.write_text(with_six_channels(frame.read_text()))
    [error] = [error for error in mistakes(path) if error.code != "B-PLAN-084"]  # a graph of the station is without too
    assert error.code == "B-PLAN-027"
    assert "there is no channel 7: the frame 'ngu_a' of port_a counts pulses of 6 channels" in error.message
    assert line_of(error, tmp_path) == ("sample.yaml", CHANNELS.replace("1-2", "1-7"))


@pytest.mark.parametrize("wrong", [("full_scale: 299 mA", "full_scale: 0.5 mA"), ("[1 mA]", "[300 mA]")])
def test_a_level_over_full_scale_is_said_once_with_its_sources(tmp_path: Path, wrong: tuple[str, str]) -> None:
    text = changed(*wrong)
    [error] = [error for error in mistakes(make_bench(tmp_path, text)) if error.code in ("B-PLAN-024", "B-PLAN-073")]
    assert error.code == "B-PLAN-024"
    lines = [text.splitlines()[int(number) - 1] for number in re.findall(r"line (\d+)", error.message)]
    assert lines[0] == CHANNELS
    assert lines[1].startswith("    gyro:")
    assert line_of(error, tmp_path)[1].startswith("  levels:")


def with_channels(numbers: str) -> str:
    return changed("gyro: {k0", f"gyro: {{channels: {numbers}, k0")


@pytest.mark.parametrize(("numbers", "listed"), [("2", "1"), ("[2, 4-6]", "1"), ("7-10", "1, 2")])
def test_a_channel_of_the_other_kind_whose_levels_fit_b_plan_028(tmp_path: Path, numbers: str, listed: str) -> None:
    text = with_channels(numbers)
    [error] = mistakes(make_bench(tmp_path, text))
    assert error.code == "B-PLAN-028"
    assert f"declared as gyro: {listed}; the unit has gyro channels " in error.message
    assert line_of(error, tmp_path) == ("sample.yaml", CHANNELS)
    (line,) = re.findall(r"line (\d+)", error.message)
    assert text.splitlines()[int(line) - 1].startswith("    gyro:")


def test_channels_of_a_kind_are_written_as_others_are(tmp_path: Path) -> None:
    assert mistakes(make_bench(tmp_path, with_channels("[1, 2-6]"))) == []
    [error] = mistakes(make_bench(tmp_path, with_channels("6-1")))
    assert (error.code, line_of(error, tmp_path)[1][:9]) == ("B-PLAN-020", "    gyro:")


@pytest.mark.parametrize(
    ("right", "wrong", "role"),
    [
        ("driver: keithley_7002", "driver: hp_3458a", "switch"),
        ("driver: fluke_5720a", "driver: agilent_e3631a", "calibrator"),
    ],
)
def test_an_instrument_with_the_driver_of_another_b_plan_050(tmp_path: Path, right: str, wrong: str, role: str) -> None:
    found = mistakes(make_bench(tmp_path, SEQUENCE, (right, wrong)))
    [error] = [error for error in found if error.code == "B-PLAN-050"]
    assert f"{role} ({wrong.removeprefix('driver: ')}) has none of the actions that are called: " in error.message
    assert line_of(error, tmp_path) == (STATION_FILE, f"    {wrong}")
