"""What is declared wrongly is named where it is declared, in sequence, station or frame, not where it is used."""

from __future__ import annotations

import re
from binascii import crc_hqx
from pathlib import Path

import pytest
from plan_sample import SEQUENCE, changed, make_bench, mistakes

from bench.model.errors import InputError

SEQUENCES = Path(__file__).resolve().parents[3] / "sequences"
CHANNELS = "  - {numbers: 1-2, kind: gyro, levels: levels}"
STATION = "af_bench_sim.yaml"


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


def test_a_channel_that_is_used_by_number_is_named_where_it_is_used(tmp_path: Path) -> None:
    found = mistakes(
        make_bench(
            tmp_path, changed('channel: "{channel}", polarity: "{polarity}"', 'channel: 11, polarity: "{polarity}"')
        )
    )
    [error] = [error for error in found if error.code == "B-PLAN-052"]
    assert "channel: 11" in line_of(error, tmp_path)[1]


def test_a_frame_with_fewer_channels_b_plan_027(tmp_path: Path) -> None:
    path = make_bench(tmp_path, changed("1-2, kind", "1-7, kind"))
    frame = tmp_path / "frames" / "ngu_a.yaml"
    frame.write_text(with_six_channels(frame.read_text()))
    [error] = [error for error in mistakes(path) if error.code != "B-PLAN-084"]  # a graph of the station is without too
    assert error.code == "B-PLAN-027"
    assert "there is no channel 7: the frame 'ngu_a' of port_a counts pulses of 6 channels" in error.message
    assert line_of(error, tmp_path) == ("sample.yaml", CHANNELS.replace("1-2", "1-7"))


def test_a_link_with_the_frames_of_another_b_plan_027(tmp_path: Path) -> None:
    found = mistakes(make_bench(tmp_path, changed("port_a: ngu_a", "port_a: ngu_b")))
    error = next(error for error in found if error.code == "B-PLAN-027")
    assert "counts no pulses" in error.message
    assert line_of(error, tmp_path)[1].startswith("frame: {port_a: ngu_b")


@pytest.mark.parametrize("wrong", [("full_scale: 299 mA", "full_scale: 0.5 mA"), ("[1 mA]", "[300 mA]")])
def test_a_level_over_full_scale_is_said_once_with_all_that_declares_it_b_plan_024(
    tmp_path: Path, wrong: tuple[str, str]
) -> None:
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


def test_shipped_sequences_say_which_channels_are_of_which_kind() -> None:
    """Swapped kinds fit: no level of the accelerometers is over the full scale of the gyros."""
    for path in sorted(SEQUENCES.glob("*.yaml")):
        text = path.read_text()
        assert text.count("k0:") == len(re.findall(r"channels: [0-9-]+, k0:", text))


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
    assert line_of(error, tmp_path) == (STATION, f"    {wrong}")


def test_a_role_that_the_station_names_otherwise_b_plan_040(tmp_path: Path) -> None:
    found = mistakes(make_bench(tmp_path, SEQUENCE, ("  switch:  ", "  relays:  ")))
    errors = [error for error in found if error.code == "B-PLAN-040"]
    assert errors
    line = next(
        number
        for number, text in enumerate((tmp_path / "stations" / STATION).read_text().splitlines(), 1)
        if text == "instruments:"
    )
    assert all(f"({STATION}:{line})" in error.message for error in errors)
    assert len({error.where for error in errors}) == len(errors)


def test_a_limit_of_the_station_is_named_with_its_line_b_plan_055(tmp_path: Path) -> None:
    found = mistakes(make_bench(tmp_path, SEQUENCE, ("current: [0 A, 220 mA]", "current: [0 A, 0.5 mA]")))
    [error] = [error for error in found if error.code == "B-PLAN-055"]
    place = re.search(rf"station af_bench_sim \({STATION}:(\d+)\)", error.message)
    assert place is not None
    assert "0.5 mA]" in (tmp_path / "stations" / STATION).read_text().splitlines()[int(place[1]) - 1]


@pytest.mark.parametrize(
    ("right", "wrong", "says"),
    [
        ("{slot: 1}", "{slot: 11}", "switch (keithley_7002): slot 11 is no whole number from 1 to 10"),
        ("{slot: 1}", "{slots: 1}", "switch (keithley_7002): has no option 'slots'"),
        ('{dialect: "3800"}', "{dialect: 3800}", "dialect 3800 is neither '3800' nor '8800'"),
    ],
)
def test_an_impossible_option_of_a_driver_b_inst_020(tmp_path: Path, right: str, wrong: str, says: str) -> None:
    [error] = mistakes(make_bench(tmp_path, SEQUENCE, (f"options: {right}", f"options: {wrong}")))
    assert error.code == "B-INST-020"
    assert says in error.message
    assert line_of(error, tmp_path) == (STATION, f"    options: {wrong}")
