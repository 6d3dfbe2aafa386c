"""What the check refuses of sequences without a link, each with its code and place."""

from __future__ import annotations

from pathlib import Path

import pytest
from probe_bench import RECORD, written

from bench.model.errors import InputErrors
from bench.plan import check_plan, compile_sequence

pytestmark = pytest.mark.usefixtures("probes")

METER = "meter.measure_resistance: {range: 1 kohm, cycles: 10}"
CHANNEL_2 = "{channel: 102, range: 1 kohm, cycles: 10}"
STEPS = "\nsteps:\n"
INTERLOCK = "\ninterlocks:\n  warm: {signal: unit_temperature, high: 50 degC, dwell: 10 s, action: hold}\n"
LAB_AIR = INTERLOCK.replace("unit_temperature, high", "lab_air, of: scanner, channel: 101, high")


def mistakes(folder: Path, *changes: tuple[str, str]) -> list[tuple[str, str]]:
    """Code and message of all mistakes of the changed sequence."""
    try:
        plan = compile_sequence(written(folder, *changes))
    except InputErrors as errors:
        return [(error.code, error.message) for error in errors.errors]
    return [(error.code, error.message) for error in check_plan(plan)]


READ = RECORD[RECORD.index("          every:") :]
REFUSED = {
    "neither frames nor readings": ((READ, ""), "B-PLAN-096", "neither frames nor readings"),
    "a period without readings": ((READ, "          every: 20 s\n"), "B-PLAN-096", "neither frames nor readings"),
    "not an instrument": (("meter.measure_resistance", "voltmeter.measure_resistance"), "B-PLAN-040", "voltmeter"),
    "not an action": (("chamber.measure_air", "chamber.measure_gas"), "B-PLAN-050", "measure_gas"),
    "no value": (("chamber.measure_air", "chamber.stop"), "B-PLAN-096", "is no reading"),
    "changes the bench": (("chamber.measure_air", "chamber.run"), "B-PLAN-096", "is no reading"),
    "unknown argument": ((METER, METER.replace("cycles", "turns")), "B-PLAN-051", "turns"),
    "missing argument": ((METER, "meter.measure_resistance: {range: 1 kohm}"), "B-PLAN-051", "cycles"),
    "wrong unit": ((METER, METER.replace("1 kohm", "1 kHz")), "B-PLAN-052", "a quantity in ohm is due"),
    "outside the limits": ((METER, METER.replace("1 kohm", "1 ohm")), "B-PLAN-055", "outside"),
    "not a range": ((METER, METER.replace("1 kohm", "300 ohm")), "B-PLAN-055", "the nearest is 100 ohm"),
    "a sense channel": ((CHANNEL_2, CHANNEL_2.replace("102", "112")), "B-PLAN-052", "channel is 112"),
    "part of a round": (("every: 20 s", "every: 25 s"), "B-PLAN-042", "not a whole number of rounds"),
    "longer than the record": (("every: 20 s", "every: 90 s"), "B-PLAN-042", "not a whole number of rounds"),
    "too often": (("every: 20 s", "every: 5 s"), "B-PLAN-060", "one round of the record's readings takes up to"),
    "an unknown variable": (("every: 20 s", 'every: "{period}"'), "B-PLAN-030", "period"),
    "pulses": (("every: 20 s", "every: 20 s\n          pulse_timing: true"), "B-PLAN-069", "record of readings has no"),
    "samples": (("every: 20 s", "every: 20 s\n          samples: true"), "B-PLAN-092", "record of readings has no"),
    "a wiring check": (("every: 20 s", "every: 20 s\n          purpose: wiring"), "B-PLAN-096", "counts frames"),
    "a soak by the unit": (("sensor: air", "sensor: unit"), "B-PLAN-097", "names no link"),
    "a command to the unit": ((STEPS, f"{STEPS}  - unit: {{port_b: start}}\n"), "B-PLAN-097", "names no link"),
    "a test of the unit": ((STEPS, f"{STEPS}  - test: {{item: cpu, command: go}}\n"), "B-PLAN-097", "names no link"),
    "an interlock on the unit": ((STEPS, f"{INTERLOCK}{STEPS}"), "B-PLAN-097", "unit_temperature"),
    "an interlock on no thermocouple": ((STEPS, f"{LAB_AIR}{STEPS}"), "B-PLAN-080", "does not scan channel 101"),
    "a wrong temperature": (('temperature: "{temperature}"', "temperature: 30 degC"), "B-PLAN-076", "temperature 23"),
    "an analysis of frames": (("analysis: probe_means", "analysis: imu_bias"), "B-PLAN-078", "names no link"),
    "an overdue standard": (("serial: SIM34401, certificate: SIM-3, calibrated: \"1999-11-01\", due: \"2000-11-01\"",
                             "serial: SIM34401, certificate: SIM-3, calibrated: \"1998-11-01\", due: \"1999-11-01\""),
                            "B-PLAN-063", "meter: calibrated"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_has_its_code(name: str, tmp_path: Path) -> None:
    change, code, words = REFUSED[name]
    found = mistakes(tmp_path, change)
    assert any(code == one and words in message for one, message in found), found
    if name == "neither frames nor readings":  # one for each of the two records of the file, and nothing that follows
        assert [one for one, _ in found] == [code] * 2


def test_readings_beside_frames_are_refused(tmp_path: Path) -> None:
    """A sequence with a link counts its frames; what instruments read stands in steps of its own."""
    head = ("station: probe_bench\nanalysis", "station: probe_bench\nframe: {port_a: ngu_a}\nanalysis")
    links = ("links: {}", "links:\n  port_a: {frame: ngu_a, baud: 921600}")
    found = mistakes(tmp_path, head, links)
    assert any(code == "B-PLAN-096" and "counts frames of port_a" in message for code, message in found), found
    found = mistakes(tmp_path / "every", head, links, (READ, "          every: 20 s\n"))
    assert any(code == "B-PLAN-096" and "'every' says when" in message for code, message in found), found


def test_the_station_s_interlocks_on_a_unit_are_not_watched(tmp_path: Path) -> None:
    """A rule of the station for a signal that nothing tells here must not hold the run for ever."""
    links = ("links: {}", "links:\n  port_a: {frame: ngu_a, baud: 921600}\n" + INTERLOCK + (
        "  gone: {signal: link_age, of: port_a, high: 5 s, dwell: 1 s, action: hold}\n"
        "  air: {signal: chamber_air, high: 58 degC, dwell: 10 s, action: hold}\n"
    ))  # fmt: skip
    plan = compile_sequence(written(tmp_path, links))
    assert [rule.name for rule in plan.interlocks] == ["air"]
