"""Faults of the simulated bench while a campaign runs: the run survives or ends safely, and its numbers stay true."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from calibrator_trip import trip_calibrator
from rehearsal import SEED, Rehearsal, SOAK_s, tiny_plan

from bench.analysis import Material, analyse
from bench.model.clock import NS
from bench.model.errors import BenchError, ExitStatus
from bench.model.quality import Quality
from bench.plan import Step
from bench.record import SessionReader
from bench.replay import replay_rows
from sim_instruments.worlds.common.world import World

Start = Callable[..., Rehearsal]
GYRO_LIMIT_ppm = 12.0  # 3.5 times what clean runs of 40 seeds are off (rms 2.8 and 3.5 ppm)
TRIPPED_POINT = 10  # number of the record during which the calibrator trips


def worst_ppm(rehearsal: Rehearsal) -> float:
    """Largest difference of a scale-factor error from the truth, ppm."""
    run = rehearsal.run
    found = analyse(Material(run.outcome.rows, run.manifest["campaign"], run.manifest["standards"])).estimates
    true = {one["quantity"]: one["value"] for one in run.truth if one["quantity"] in ("dsf_n", "dsf_p")}
    errors = {one["quantity"]: abs(one["value"] - true[one["quantity"]]) for one in found if one["quantity"] in true}
    assert set(errors) == {"dsf_n", "dsf_p"}
    print(f"seed {SEED}: errors {errors} ppm")
    return max(errors.values())


def assert_safe(world: World) -> None:
    """No current, no closed relay, no power to the unit, chamber stopped or on hold: what the world itself says."""
    assert world.wiring.loop_current_A == 0.0
    assert world.wiring.closed == frozenset()
    assert not world.instruments["calibrator"].operating
    assert not world.instruments["supply"].on
    assert world.instruments["chamber"].outputs()["mode"] in ("stopped", "holding")


def ended_with(rehearsal: Rehearsal, code: str) -> BenchError:
    error = rehearsal.run.outcome.error
    assert error is not None
    assert error.code == code
    assert error.exit_status is ExitStatus.SAFE_AFTER_FAULT
    return error


def records_begun(step: Step, wanted: int, seen: list[int]) -> bool:
    if step.kind == "record" and step.phase == "campaign":
        seen.append(step.number)
        return len(seen) == wanted
    return False


def commands(rehearsal: Rehearsal, role: str) -> list[str]:
    """What was sent to an instrument, from the session."""
    messages = SessionReader(rehearsal.run.folder).select(frozenset({f"/instrument/{role}"}))
    return [one["text"] for one in (message.document() for message in messages) if one["direction"] == "tx"]


def test_a_bench_without_faults(tmp_path: Path, rehearse: Start) -> None:
    found = rehearse(tiny_plan(tmp_path))
    assert found.run.outcome.error is None
    assert found.run.outcome.unsafe == ()
    assert len(found.run.outcome.rows) == 15
    assert worst_ppm(found) < GYRO_LIMIT_ppm
    assert_safe(found.world)


def test_a_trip_during_a_dwell_takes_the_point_again(tmp_path: Path, rehearse: Start) -> None:
    seen: list[int] = []

    def trip(world: World, step: Step) -> None:
        if records_begun(step, TRIPPED_POINT, seen):
            trip_calibrator(world, world.clock.now_ns() + 5 * NS)

    found = rehearse(tiny_plan(tmp_path), act=trip)
    outcome = found.run.outcome
    assert outcome.error is None
    assert outcome.retaken == 1
    assert len(outcome.rows) == 15
    assert len(found.events("retake")) == 1
    assert worst_ppm(found) < GYRO_LIMIT_ppm
    again = replay_rows(found.run.folder, strict=True).measurement_rows
    assert [row.window for row in again] == [row.window for row in outcome.rows]


def test_a_silent_thermometer_costs_its_readings_and_not_the_campaign(tmp_path: Path, rehearse: Start) -> None:
    def mute(world: World, step: Step) -> None:
        if step.kind == "soak":
            world.faults.instrument("logger").mute = True

    found = rehearse(tiny_plan(tmp_path), act=mute)
    assert found.run.outcome.error is None
    assert len(found.run.outcome.rows) == 15
    assert [one["code"] for one in found.events("reading") if one["role"] == "logger"] == ["B-INST-001"]
    assert [failure.where for failure in found.run.outcome.unsafe] == ["logger"]


@pytest.mark.slow
@pytest.mark.parametrize("role", ["calibrator", "switch"])
def test_an_instrument_that_stays_silent_ends_the_run_safely(tmp_path: Path, rehearse: Start, role: str) -> None:
    seen: list[int] = []

    def mute(world: World, step: Step) -> None:
        if records_begun(step, 4, seen):
            world.faults.instrument(role).mute = True

    found = rehearse(tiny_plan(tmp_path), act=mute)
    error = ended_with(found, "B-RUN-070")  # after half an hour
    assert role in error.where
    assert [failure.where for failure in found.run.outcome.unsafe] == [role]
    assert [failure.code for failure in found.run.outcome.unsafe] == ["B-RUN-060"]
    assert_safe(found.world)  # it hears what it cannot confirm
    assert (found.run.folder / "journal.jsonl").exists()


@pytest.mark.parametrize("role", ["calibrator", "switch", "chamber", "supply"])
def test_an_instrument_that_is_silent_for_a_while_costs_no_record(tmp_path: Path, rehearse: Start, role: str) -> None:
    seen: list[int] = []

    def mute(world: World, step: Step) -> None:
        if records_begun(step, 4, seen):
            world.switches.switch("mute", role)
            world.after(60.0, lambda: world.switches.switch("mute", role, "off"))

    found = rehearse(tiny_plan(tmp_path), act=mute)
    assert found.run.outcome.error is None
    assert found.run.outcome.unsafe == ()
    assert len(found.run.outcome.rows) == 15
    assert worst_ppm(found) < GYRO_LIMIT_ppm
    assert_safe(found.world)


@pytest.mark.parametrize("role", ["calibrator", "switch", "chamber", "rail_dmm"])
def test_a_wrong_instrument_gets_no_command_and_nothing_is_switched(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch, role: str
) -> None:
    worlds: list[World] = []
    heard: list[str] = []

    def arrange(world: World) -> None:
        worlds.append(world)
        world.faults.instrument(role).identity = "ACME,42,0,0"
        for device in world.instruments.values():
            plain = device.execute
            device.execute = lambda text, plain=plain: (heard.append(text), plain(text))[1]  # type: ignore

    with pytest.raises(BenchError) as caught:
        rehearse(tiny_plan(tmp_path), arrange=arrange)
    assert caught.value.code == "B-INST-002"
    assert role in caught.value.where
    assert heard
    stimulus = ("OPER", "OUT ", "OUTP ON", ":CLOS", "RUNM", "SETP1,", "VOLT ", "FUNC")
    assert [text for text in heard if text.upper().startswith(stimulus) and "?" not in text] == []
    assert not (tmp_path / "out").exists()


def test_a_silent_port_ends_the_run(tmp_path: Path, rehearse: Start) -> None:
    seen: list[int] = []

    def unplug(world: World, step: Step) -> None:
        if records_begun(step, 3, seen):
            world.faults.link("port_a").silent = True

    found = rehearse(tiny_plan(tmp_path), act=unplug)
    ended_with(found, "B-RUN-021")
    assert len(found.run.outcome.rows) == 2
    assert_safe(found.world)


def noisy(world: World) -> None:
    link = world.faults.link("port_a")
    link.drop_rate, link.bit_error_rate, link.duplicate_rate = 2e-4, 1e-6, 1e-4


def test_a_noisy_cable_costs_frames_but_no_truth(tmp_path: Path, rehearse: Start) -> None:
    found = rehearse(tiny_plan(tmp_path), arrange=noisy)
    outcome, counts = found.run.outcome, found.run.counts
    assert outcome.error is None
    print(f"seed {SEED}: {counts}, {outcome.retaken} retaken")
    assert counts["frames_lost"] > 0
    assert counts["frames_bad"] > 0
    damaged = [row for row in outcome.rows if row.quality & (Quality.LOST | Quality.BAD_FRAMES | Quality.DUPLICATE)]
    assert damaged
    assert all(row.frames + row.lost == row.window.frames for row in outcome.rows)
    assert all(bool(row.quality & Quality.LOST) == (row.lost > 0) for row in outcome.rows)
    assert worst_ppm(found) < GYRO_LIMIT_ppm


def test_one_frame_in_a_hundred_lost_during_part_of_the_campaign(tmp_path: Path, rehearse: Start) -> None:
    """The records of that time are taken again, stay flagged if that does not help, and are left out of the fit."""
    seen: list[int] = []

    def cable(world: World, step: Step) -> None:
        if step.kind == "record" and step.phase == "campaign":
            seen.append(step.number)
            world.faults.link("port_a").drop_rate = 0.01 if 6 <= len(seen) <= 8 else 0.0

    found = rehearse(tiny_plan(tmp_path), act=cable)
    outcome = found.run.outcome
    assert outcome.error is None
    assert outcome.retaken == 3
    flagged = [row.window.number for row in outcome.rows if row.quality & Quality.LOST]
    assert flagged == [6 + 2, 7 + 2, 8 + 2]  # two wiring records come first
    assert found.run.counts["frames_lost"] >= sum(row.lost for row in outcome.rows) > 0
    estimates = analyse(
        Material(outcome.rows, found.run.manifest["campaign"], found.run.manifest["standards"])
    ).estimates
    assert {one["dropped"] for one in estimates if one["quantity"] == "dsf_n"} == {3}
    assert worst_ppm(found) < GYRO_LIMIT_ppm


def swap(world: World, wiring: Callable[[tuple[int, int]], tuple[int, int]]) -> None:
    """Connect the switch to the unit by another cable."""
    plain = world.wiring.switch
    world.wiring.switch = lambda closed, t_ns: plain(frozenset(map(wiring, closed)), t_ns)  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("wiring", "code"),
    [
        (lambda point: (3 - point[0], point[1]), "B-RUN-050"),  # HI and LO crossed
        (lambda point: (point[0], 3 - point[1]), "B-RUN-051"),  # channels 1 and 2 exchanged
    ],
)
def test_swapped_wires_are_found_before_hour_0(tmp_path: Path, rehearse: Start, wiring: Any, code: str) -> None:
    found = rehearse(tiny_plan(tmp_path), arrange=lambda world: swap(world, wiring))
    ended_with(found, code)
    assert {step.phase for step in found.watched.steps} == {"prepare"}
    assert found.world.wiring.loop_current_A == 0.0
    assert not found.world.instruments["supply"].on


def test_a_chamber_that_never_settles_is_held_for_and_then_given_up(tmp_path: Path, rehearse: Start) -> None:
    def short_of(world: World) -> None:
        world.switches.switch("chamber_shortfall", 1.5)

    found = rehearse(tiny_plan(tmp_path), arrange=short_of)
    ended_with(found, "B-RUN-031")
    (late,) = found.events("late")
    assert late["policy"] == "hold"
    assert found.run.outcome.rows == []
    assert found.run.outcome.slip_s == pytest.approx(SOAK_s)
    assert_safe(found.world)


def test_the_flag_of_a_skipped_soak_survives_a_replay(tmp_path: Path, rehearse: Start) -> None:
    def short_of(world: World) -> None:
        world.switches.switch("chamber_shortfall", 1.5)

    found = rehearse(tiny_plan(tmp_path, ("late: hold", "late: skip")), arrange=short_of)
    assert found.run.outcome.error is None
    assert {row.quality for row in found.run.outcome.rows} == {Quality.NOT_SETTLED}
    again = replay_rows(found.run.folder, strict=True).measurement_rows
    assert {row.quality for row in again} == {Quality.NOT_SETTLED}


def test_an_open_thermocouple_is_a_flagged_reading(tmp_path: Path, rehearse: Start) -> None:
    def open_wire(world: World) -> None:
        logger = world.instruments["logger"]
        plain = logger.reply
        logger.reply = lambda text, **o: plain("9.9E37,9.9E37,9.9E37" if "," in text and "E+" in text else text, **o)  # type: ignore

    found = rehearse(tiny_plan(tmp_path), arrange=open_wire)
    assert found.run.outcome.error is None
    flagged = [event for event in found.events("reading") if event.get("quality") == Quality.OVERLOAD]
    assert [(event["role"], event["code"]) for event in flagged] == [("logger", "B-INST-007")]
    assert len(found.run.outcome.rows) == 15


def test_a_chamber_that_runs_away_is_stopped_and_not_held(tmp_path: Path, rehearse: Start) -> None:
    def run_away(world: World, step: Step) -> None:
        if step.kind == "soak" and step.phase == "campaign":
            world.switches.switch("chamber_runaway", 0.3)

    found = rehearse(tiny_plan(tmp_path), act=run_away)
    ended_with(found, "B-RUN-031")
    assert found.run.outcome.unsafe == ()
    assert found.world.instruments["chamber"].outputs()["mode"] == "stopped"
    assert_safe(found.world)
