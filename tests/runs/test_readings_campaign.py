"""A campaign without a serial unit, from its check to its certificate: records are of readings."""

import json
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import pytest
from probe_bench import (
    NAME,
    OHM_AT_0,
    OHM_PER_DEGC,
    RECORD,
    TEMPERATURES_DEGC,
    at_reading,
    command,
    probe_plan,
    written,
)
from rehearsal import SEED, Rehearsal, Watched, go_on, rehearsed

from bench.commands.run import view_of
from bench.model.clock import NS
from bench.model.errors import InputErrors, InstrumentError
from bench.model.events import Event, Reading
from bench.model.quantities import Quality
from bench.plan import check_plan, compile_sequence
from bench.plan.summary import summarise
from bench.replay import replay_rows
from bench.run.besides import besides
from bench.run.context import RunContext
from bench.run.control.client import FeedClient
from bench.run.observers import Observer
from bench.run.stop import Wish
from bench.session.early import verdict
from bench.session.record_states import INVALID, VALID, record_states
from bench.session.service import merged, read_view
from bench.session.view import KEPT_EVENTS, analyse_view, material_of
from bench.tui.look import UNICODE, Look, catalogue
from bench.tui.page import records as record_lines
from bench.tui.watch import Seen
from bench.web.recorded.past import Past
from sim_instruments.worlds.common.terminals import Source
from sim_instruments.worlds.common.world import World

ROUNDS, READINGS, RECORDS = 3, 4, 4
SESSION = tuple[Path, Path]
Start = Callable[..., Rehearsal]
pytestmark = pytest.mark.usefixtures("probes")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, probes: None) -> SESSION:
    """The sequence's file, and the session of its run."""
    folder = tmp_path_factory.mktemp("probes")
    sequence = written(folder)
    command("run", sequence, "--out", folder / "out", "--seed", SEED, "--truth")
    return sequence, folder / "out" / NAME


def test_the_check_knows_steps_duration_and_disk_use(tmp_path: Path) -> None:
    plan = probe_plan(tmp_path)
    summary = summarise(plan)
    assert (plan.measurement_link, dict(plan.frames), plan.link_bytes_s) == ("", {}, 0.0)
    assert (summary.records, summary.duration_s) == (RECORDS, 2 * (3600.0 + 2 * 60.0))
    less = summarise(probe_plan(tmp_path / "less", ("every: 20 s", "every: 60 s"))).disk_bytes
    assert summary.disk_bytes - less == 1500 * RECORDS * READINGS * (ROUNDS - 1)
    assert "no mistake found" in command("check", written(tmp_path / "again"))
    assert " 0 fail" in command("check", written(tmp_path / "live"), "--live")


def test_results_of_a_run(session: SESSION) -> None:
    """Each probe follows the chamber within the meter's one-year accuracy; its leads, 2 x 1.5 ohm, do not show."""
    results: dict[str, Any] = json.loads((session[1] / "results.json").read_text())
    frames = {"frames": 0, "frames_bad": 0, "frames_lost": 0}
    assert results["quality"] == {**frames, "records": RECORDS, "retaken": 0, "splices": 0}
    assert results["provenance"]["frame_sha256"] == ""
    read = {(one["conditions"]["probe"], one["conditions"]["temperature_degC"]): one for one in results["estimates"]}
    for probe in ("scanner 101", "scanner 102", "meter 0"):
        for degC in TEMPERATURES_DEGC:
            assert read[probe, degC]["value"] == pytest.approx(OHM_AT_0 + OHM_PER_DEGC * degC, abs=0.7)
            assert read[probe, degC]["n"] == 2 * ROUNDS
        rise_ohm = read[probe, 40.0]["value"] - read[probe, 23.0]["value"]
        assert rise_ohm == pytest.approx(OHM_PER_DEGC * 17.0, abs=0.7)
    assert read["scanner 101", 40.0]["value"] != read["scanner 102", 40.0]["value"]  # each reading has its own noise
    assert (session[1] / "report.html").stat().st_size > 10_000


def test_material_has_each_reading_with_time_arguments_and_conditions(session: SESSION) -> None:
    """What an analysis needs: readings by channel, when they came, at which temperature, and the chamber's air."""
    material = material_of(read_view(session[1]))
    assert len(material.rows) == RECORDS
    for row in material.rows:
        readings = material.readings_of(row)
        assert (row.readings, row.unread, row.frames, row.quality) == (ROUNDS * READINGS, 0, 0, Quality.GOOD)
        assert [reading.arguments.get("channel") for reading in readings] == [101, 102, None, None] * ROUNDS
        roles = [f"{reading.role}.{reading.name}" for reading in readings[:READINGS]]
        assert roles == ["scanner.measure_resistance"] * 2 + ["meter.measure_resistance", "chamber.measure_air"]
        assert all(reading.conditions == row.window.conditions for reading in readings)
        assert all(reading.step == row.window.step for reading in readings)
        first_s = row.window.t_start_ns / NS
        for turn in range(ROUNDS):
            times_s = [reading.t_s - first_s for reading in readings[turn * READINGS : (turn + 1) * READINGS]]
            assert times_s == sorted(times_s)
            assert 20.0 * turn < times_s[0] < 20.0 * turn + 1.5
            assert times_s[-1] < 20.0 * turn + 6.5
        inside = (material.trace.t_s >= first_s) & (material.trace.t_s <= row.window.t_end_ns / NS)
        degC = row.window.conditions["temperature_degC"]
        assert material.trace.air_degC[inside] == pytest.approx([degC] * int(inside.sum()), abs=1.0)


def test_every_reader_of_a_session_takes_it(session: SESSION) -> None:
    folder = session[1]
    assert "every number is identical" in command("replay", folder)
    assert "4 records, 0 frames" in command("fit", folder)
    assert "identical" in command("report", folder, "--verify")
    assert "4 valid, 0 missing, 0 invalid" in command("recover", folder)
    history = f"sqlite:///{folder.parent / 'history.sqlite'}"
    assert NAME in command("history", "list", "--history", history)
    assert "resistance" in command("history", "show", NAME, "--history", history)
    assert "unchanged" in command("history", "import", folder, "--history", history)
    assert "certificate.specimen.xml" in command("certificate", folder, "--specimen")
    (folder / "certificate.specimen.xml").unlink()
    early = verdict(folder, {"max_lost": 0.0, "max_bad": 0.0, "max_dispersion": 5.0, "max_residual": 6.0})
    assert (early["ok"], early["records"]) == (None, RECORDS)  # no frames, so nothing that could be judged early


def test_the_page_and_the_terminal_show_readings(tmp_path: Path) -> None:
    """The state that a run tells while it goes on, and the one of its recording, say the same of its last record."""
    plan = probe_plan(tmp_path)
    documents: list[dict[str, Any]] = []

    class Watcher(Watched):
        def record(self, row: object) -> None:
            client = FeedClient(next((tmp_path / "out").iterdir()))
            documents.append(client.poll(0).header["state"])
            client.close()

    done = rehearsed(tmp_path / "out", plan, watched=Watcher(), beside=besides(plan, {}, virtual=True)).run
    assert done.outcome.error is None
    recorded = Past().final(done.folder)
    for document in (documents[-1], recorded):
        newest = document["records"]["last"][0]
        assert (newest["frames"], newest["readings"], newest["lost"]) == (None, ROUNDS * READINGS, 0)
        assert document["links"] in ({}, None)
        lines = record_lines(Seen(document, NAME), Look(catalogue(), UNICODE, 100, False))
        assert any("12 readings" in line.plain for line in lines)
    assert (recorded["records"]["done"], recorded["records"]["planned"]) == (RECORDS, RECORDS)
    assert documents[-1]["records"]["done"] == documents[-1]["records"]["last"][0]["number"]  # up to a second old


def test_a_run_that_is_killed_inside_a_record_takes_it_again(tmp_path: Path) -> None:
    """The readings of the record that was cut off stay in the session and belong to no record."""

    class CopyBeside(Observer):
        def __init__(self, context: RunContext) -> None:
            self._folder, self._readings = context.folder, 0

        def event(self, event: Event, t_mono_ns: int) -> None:
            if isinstance(event, Reading):
                self._readings += 1
                if self._readings == ROUNDS * READINGS + 6:
                    shutil.copytree(self._folder, tmp_path / "crash" / self._folder.name)

    def copy_beside(context: RunContext) -> AbstractContextManager[None]:
        context.observers.add(CopyBeside(context))
        return nullcontext()

    rehearsed(tmp_path / "out", probe_plan(tmp_path), beside=[copy_beside])
    folder = tmp_path / "crash" / NAME
    assert go_on(folder).outcome.error is None
    view = read_view(folder)
    assert [row.readings for row in view.rows] == [ROUNDS * READINGS] * RECORDS
    assert len(material_of(view).readings) > RECORDS * ROUNDS * READINGS
    assert {one["n"] for one in analyse_view(view)[0]["estimates"]} == {2 * ROUNDS}


def bus_failed(context: RunContext) -> None:
    raise InstrumentError("B-INST-003", "the bus failed", where="meter")


def wished_again(context: RunContext) -> None:
    context.stop.holds.wish(Wish("retake", "interlock air", "too warm"))


@pytest.mark.parametrize("act", [bus_failed, wished_again])
def test_a_record_that_is_interrupted_is_taken_again(act: Callable[[RunContext], None], tmp_path: Path) -> None:
    """An instrument is waited for, or an interlock asks for it: the readings before belong to no record."""
    meter = at_reading(ROUNDS + 2, act)
    done = rehearsed(tmp_path / "out", probe_plan(tmp_path), beside=[meter], kept=KEPT_EVENTS).run
    assert done.outcome.error is None
    holds = [str(fields["by"]) for kind, _, fields in done.events if kind == "hold"]
    assert holds == (["instrument meter"] if act is bus_failed else [])
    rows = read_view(done.folder).rows
    assert [row.window.number for row in rows] == list(range(1, RECORDS + 1))
    assert [row.readings for row in rows] == [ROUNDS * READINGS] * RECORDS
    assert rows == list(done.outcome.rows)


def open_leads(world: World) -> None:
    world.terminals.connect(Source(resistance_ohm=lambda t_ns: 1e9), "scanner", 101)


def test_a_reading_without_a_value_is_flagged_and_the_run_goes_on(tmp_path: Path, rehearse: Start) -> None:
    done = rehearse(
        probe_plan(tmp_path, ("seconds: 60 s", "seconds: 60 s\n          max_lost: 30 %")), arrange=open_leads
    )
    assert done.run.outcome.error is None
    assert [(row.readings, row.unread, row.quality) for row in done.run.outcome.rows] == [
        (9, 3, Quality.GOOD)
    ] * RECORDS
    flags = {one["quality"] for one in done.events("reading") if one["value"] is None}
    assert flags == {int(Quality.OVERLOAD)}
    again = replay_rows(done.run.folder)
    assert [(row.readings, row.unread) for row in again.rows] == [(9, 3)] * RECORDS
    assert not done.events("retake")


def test_a_record_that_lost_too_many_readings_is_taken_again(tmp_path: Path, rehearse: Start) -> None:
    plan = probe_plan(tmp_path, ("seconds: 60 s", "seconds: 60 s\n          retry: 1"))
    done = rehearse(plan, act=lambda world, step: open_leads(world) if step.number == plan.steps[-1].number else None)
    assert [one["reason"] for one in done.events("retake")] == ["3 of 12 readings lost"]
    assert done.run.outcome.retaken == 1
    assert [row.unread for row in replay_rows(done.run.folder).rows] == [0, 0, 0, 3]


def test_a_record_in_which_nothing_was_read_is_invalid_and_can_be_made_up(tmp_path: Path, rehearse: Start) -> None:
    folder = tmp_path / "first"
    plan = probe_plan(folder, (RECORD[RECORD.index("            - scanner.measure_resistance: {channel: 102") :], ""))
    done = rehearse(plan, act=lambda world, step: open_leads(world) if step.number == plan.steps[-1].number else None)
    assert done.run.outcome.error is None
    replayed = replay_rows(done.run.folder)
    assert [one.state for one in record_states(plan.steps, replayed)] == [VALID] * 3 + [INVALID]
    sequence = folder / "sequences" / "probes_make_up.yaml"
    command("recover", done.run.folder, "--make-up", sequence)
    command("run", sequence, "--out", tmp_path / "again")
    (made_up,) = (found for found in (tmp_path / "again").iterdir() if found.is_dir())
    whole = merged(read_view(done.run.folder), [read_view(made_up)])
    assert not whole.incomplete
    rows = material_of(whole)
    assert sum(len([one for one in rows.readings_of(row) if one.value is not None]) for row in rows.rows) == ROUNDS * 5


def test_records_of_readings_without_a_gap(tmp_path: Path, rehearse: Start) -> None:
    windows = ("seconds: 60 s", "seconds: 60 s\n          windows: 2"), ("records: 4", "records: 8")
    plan = probe_plan(tmp_path, *windows)
    done = rehearse(plan)
    rows = done.run.outcome.rows
    assert [row.window.conditions["window_index"] for row in rows] == [0, 1] * RECORDS
    assert [row.readings for row in replay_rows(done.run.folder).rows] == [ROUNDS * READINGS] * 8
    material = material_of(view_of(plan, done.run))
    times_s = [reading.t_s for row in rows for reading in material.readings_of(row)]
    assert len(set(times_s)) == len(times_s) == 8 * ROUNDS * READINGS


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
    "missing argument": ((METER, "meter.measure_resistance: {range: 1 kohm}"), "B-PLAN-051", "cycles"),
    "not a range": ((METER, METER.replace("1 kohm", "300 ohm")), "B-PLAN-055", "the nearest is 100 ohm"),
    "a sense channel": ((CHANNEL_2, CHANNEL_2.replace("102", "112")), "B-PLAN-052", "channel is 112"),
    "part of a round": (("every: 20 s", "every: 25 s"), "B-PLAN-042", "not a whole number of rounds"),
    "too often": (("every: 20 s", "every: 5 s"), "B-PLAN-060", "one round of the record's readings takes up to"),
    "pulses": (("every: 20 s", "every: 20 s\n          pulse_timing: true"), "B-PLAN-069", "record of readings has no"),
    "samples": (("every: 20 s", "every: 20 s\n          samples: true"), "B-PLAN-092", "record of readings has no"),
    "a wiring check": (("every: 20 s", "every: 20 s\n          purpose: wiring"), "B-PLAN-096", "counts frames"),
    "a soak by the unit": (("sensor: air", "sensor: unit"), "B-PLAN-097", "names no link"),
    "a command to the unit": ((STEPS, f"{STEPS}  - unit: {{port_b: start}}\n"), "B-PLAN-097", "names no link"),
    "an interlock on the unit": ((STEPS, f"{INTERLOCK}{STEPS}"), "B-PLAN-097", "unit_temperature"),
    "an interlock on no thermocouple": ((STEPS, f"{LAB_AIR}{STEPS}"), "B-PLAN-080", "does not scan channel 101"),
    "a wrong temperature": (('temperature: "{temperature}"', "temperature: 30 degC"), "B-PLAN-076", "temperature 23"),
    "an analysis of frames": (("analysis: probe_means", "analysis: imu_bias"), "B-PLAN-078", "names no link"),
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
