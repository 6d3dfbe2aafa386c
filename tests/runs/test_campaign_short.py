"""The short campaign end to end: same seed same bytes, replay, schema, truth, watched; faults of its bench."""

import json
import shutil
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace
from typing import Any

import jsonschema
import pytest
from rehearsal import (
    NAME,
    SEED,
    Act,
    Inside,
    Rehearsal,
    Watched,
    assert_nothing_switched,
    assert_safe,
    contents,
    overheard,
    record_golden,
    rehearsed,
    tiny_plan,
    writable_copy,
)
from sim_bench import trip_calibrator

from bench.analysis import Material, analyse, results_schema
from bench.model.clock import NS
from bench.model.errors import BenchError, ExitStatus
from bench.model.quantities import Quality
from bench.plan import Plan, Step
from bench.record import RecordError, SessionReader, SessionWriter
from bench.replay import replay_rows
from bench.run import hold
from bench.run.besides import besides
from bench.run.control.client import FeedClient, FeedGone
from bench.run.session import Beside, Conducted
from bench.tables import watch
from sim_instruments.worlds.common.world import World

Short = tuple[Path, CompletedProcess[str]]
LIMIT_ppm = {"gyro": 8.0, "accelerometer": 5.0}


def results_of(folder: Path) -> dict[str, object]:
    return json.loads((folder / "results.json").read_text())


def test_a_campaign_ends_with_its_files_and_exit_status_0(short: Short) -> None:
    folder, done = short
    assert done.returncode == 0, done.stderr
    assert sorted(contents(folder)) == [
        "bench.001s", "bench.010s", "bench.100s", "coefficients.h", "coefficients.json", "port_a.001s", "port_a.010s",
        "port_a.100s", "port_b.001s", "port_b.010s", "port_b.100s", "report.html", "results.json", "session.0001.mcap",
        "session.0002.mcap", "session.0003.mcap", "trend.json",
    ]  # fmt: skip
    assert (folder.parent / "history.sqlite").is_file()
    assert "SIMULATED" in done.stdout
    assert str(folder / "report.html") in done.stdout
    assert "Traceback" not in done.stdout + done.stderr


def test_a_folder_of_that_name_gives_a_suffix_which_is_in_no_file(golden: Path, tmp_path: Path) -> None:
    """Else the same seed gives the same bytes; the whole short campaign is held against another in test_page_killed."""
    taken = tmp_path / golden.name
    taken.mkdir()
    record_golden(tmp_path)
    first, second = contents(golden), contents(taken.with_name(f"{golden.name}-2"))
    assert {name for name in first if first[name] != second[name]} == set()
    assert first.keys() == second.keys()
    assert not list(taken.iterdir())


def test_results_match_their_schema(short: Short) -> None:
    jsonschema.validate(results_of(short[0]), results_schema())


def test_scale_factors_agree_with_the_simulated_truth(short: Short) -> None:
    folder, _ = short
    true = json.loads(folder.with_name(NAME + ".truth.json").read_text())["estimates"]
    keys = ("channel", "temperature_degC")
    expected = {
        (one["quantity"], *(one["conditions"].get(key) for key in keys)): one["value"]
        for one in true
        if one["quantity"] in ("dsf_n", "dsf_p")
    }
    worst = {"gyro": 0.0, "accelerometer": 0.0}
    judged = 0
    for one in results_of(folder)["estimates"]:  # type: ignore[attr-defined]
        conditions = one["conditions"]
        where = (one["quantity"], *(conditions.get(key) for key in keys))
        if where in expected:
            judged += 1
            worst[conditions["kind"]] = max(worst[conditions["kind"]], abs(one["value"] - expected[where]))
    print(f"seed {SEED}: worst errors {worst} ppm over {judged} estimates")
    assert judged >= 2 * 3 * 2
    for kind, limit_ppm in LIMIT_ppm.items():
        assert worst[kind] < limit_ppm


@pytest.mark.validates(
    "replay of a session from its raw bytes",
    against="every number the run itself wrote, in a copy without the simulated truth",
)
def test_a_copy_elsewhere_replays_fits_and_reports_without_the_truth(
    short: Short, tmp_path: Path, inside: Inside
) -> None:
    folder, _ = short
    copy = writable_copy(folder, tmp_path / "somewhere" / "else")
    (copy / "report.html").unlink()
    replayed = inside("replay", str(copy), cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr
    assert "every number is identical" in replayed.stdout
    fitted = inside("fit", str(copy), "--json", cwd=tmp_path)
    assert fitted.returncode == 0
    assert json.loads(fitted.stdout) == results_of(folder)
    assert inside("report", str(copy), cwd=tmp_path).returncode == 0
    assert (copy / "report.html").read_bytes() == (folder / "report.html").read_bytes()


UTC_S = 946_684_800.0


class Crowd:
    """Watchers of a run: one polls as fast as it can and keeps what it sees, one never reads, one is a notebook."""

    def __init__(self, out: Path) -> None:
        self.seen: list[dict[str, Any]] = []
        self.points = 0
        self.pictures: list[bytes] = []
        self.looked = threading.Event()  # the notebook, whose libraries take their time, has its first picture
        self._out, self._ended = out, threading.Event()
        self._threads = [threading.Thread(target=one) for one in (self._poll, self._ask_and_never_read, self._watch)]

    def __enter__(self) -> "Crowd":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(20.0)

    def _folder(self) -> Path | None:
        while not self._ended.wait(0.01):
            if found := next(iter(self._out.glob("*/live.*")), None):
                return found.parent
        return None

    def _poll(self) -> None:
        if (folder := self._folder()) is None:
            return
        client, since = FeedClient(folder), 0
        while not self._ended.is_set():
            try:
                reply = client.poll(since)
            except FeedGone:
                continue
            since = int(reply.header["seq"])
            self.points += len(reply.t_utc_s)
            self.seen.append(reply.header["state"])
        client.close()

    def _watch(self) -> None:
        """Look at the run as a notebook does; the view ends with the run."""
        if (folder := self._folder()) is not None:
            watch(folder, "bench.unit")
            self.pictures.append(b"end")

    def DisplayHandle(self) -> Any:
        """Stand in for IPython.display, whose handle shows a picture and replaces it."""
        return SimpleNamespace(display=self._show, update=self._show)

    def _show(self, picture: bytes) -> None:
        self.pictures.append(picture)
        self.looked.set()

    def Image(self, data: bytes) -> bytes:
        return data

    def _ask_and_never_read(self) -> None:
        if (folder := self._folder()) is None:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as mute:
            mute.settimeout(0.1)
            try:
                mute.connect(str(folder / "live.sock"))
                while not self._ended.is_set():
                    mute.sendall(b'{"since": 0, "state": true}\n' * 100)
            except OSError:  # the run is over, or it was dropped
                self._ended.wait(20.0)


def conducted(plan: Plan, out: Path, act: Callable[[], object] = lambda: None, *beside: Beside) -> Conducted:
    watched = [*besides(plan, {}, virtual=True), *beside]
    return rehearsed(out, plan, act=lambda world, step: act(), seed=5, beside=watched).run


@pytest.mark.slow
def test_a_watched_run_writes_the_same_bytes_and_tells_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = tiny_plan(tmp_path)
    alone = conducted(plan, tmp_path / "alone")
    with Crowd(tmp_path / "watched") as crowd:
        monkeypatch.setitem(sys.modules, "IPython.display", crowd)  # type: ignore[arg-type]
        watched = conducted(plan, tmp_path / "watched", lambda: crowd.looked.wait(20.0))
    assert contents(watched.folder) == contents(alone.folder)
    assert not list(watched.folder.glob("live*"))
    assert len(crowd.seen) > 5
    assert crowd.points > 600
    assert len(set(crowd.pictures)) > 1
    assert {picture[:4] for picture in crowd.pictures[:-1]} == {b"\x89PNG"}
    assert crowd.pictures[-1] == b"end"
    (end,) = [utc_s(t_ns) for _, t_ns, _ in SessionReader(watched.folder).events("end")]
    etas = [one["eta"] for one in crowd.seen if one["eta"] is not None]
    assert etas
    for eta in etas:
        assert eta["earliest_utc_s"] <= end <= eta["latest_utc_s"]
    boots = {one["boot_id"] for one in crowd.seen}
    assert len(boots) == 1
    assert len(boots.pop()) == 16
    last = crowd.seen[-1]
    assert (last["simulated"], last["clock"], last["source"]) == (True, "virtual", "live")
    assert last["records"]["planned"] == 15
    assert {str(record["flags"]) for record in last["records"]["last"]} == {"[]"}
    assert set(last["instruments"]) == set(plan.station.instruments)
    assert not any(link["state"] in ("lost", "silent") for one in crowd.seen for link in one["links"].values())
    json.dumps(crowd.seen, allow_nan=False)


def utc_s(t_ns: int) -> float:
    return t_ns / 1e9 + UTC_S


Start = Callable[..., Rehearsal]
TRIPPED_POINT = 10  # number of the record during which the calibrator trips


def estimates_of(rehearsal: Rehearsal) -> Any:
    run = rehearsal.run
    return analyse(Material(run.outcome.rows, run.manifest["campaign"], run.manifest["standards"])).estimates


def worst_u(rehearsal: Rehearsal) -> float:
    """Largest difference of a scale-factor error from the truth, in its stated standard uncertainty (11 to 12 ppm)."""
    true = {one["quantity"]: one["value"] for one in rehearsal.run.truth if one["quantity"] in ("dsf_n", "dsf_p")}
    errors = {
        one.quantity: abs(one.value - true[one.quantity]) / one.std_uncertainty
        for one in estimates_of(rehearsal) if one.quantity in true
    }  # fmt: skip
    assert set(errors) == {"dsf_n", "dsf_p"}
    print(f"seed {SEED}: errors {errors} u")
    return float(max(errors.values()))


def ended_with(rehearsal: Rehearsal, code: str) -> BenchError:
    error = rehearsal.run.outcome.error
    assert error.code == code
    assert error.exit_status is ExitStatus.SAFE_AFTER_FAULT
    return error


def at_record(wanted: int, do: Callable[[World], object]) -> Act:
    """Do something when so many records of the campaign have begun."""
    seen: list[int] = []

    def act(world: World, step: Step) -> None:
        if step.kind == "record" and step.phase == "campaign":
            seen.append(step.number)
            if len(seen) == wanted:
                do(world)

    return act


def at_soak(do: Callable[[World], object], phases: tuple[str, ...] = ("prepare", "campaign", "finally")) -> Act:
    """Do something at each soak."""
    return lambda world, step: do(world) if step.kind == "soak" and step.phase in phases else None


def windows_again(rehearsal: Rehearsal) -> list[tuple[object, object]]:
    """Return window and quality of each record that a replay finds."""
    again = replay_rows(rehearsal.run.folder, strict=True).measurement_rows
    return [(row.window, row.quality) for row in again]


def lived_through(rehearsal: Rehearsal) -> None:
    """The run has ended as planned, all its records are there, and they are true."""
    assert rehearsal.run.outcome.error is None
    assert len(rehearsal.run.outcome.rows) == 15
    assert worst_u(rehearsal) < 1.0


def test_a_trip_during_a_dwell_takes_the_point_again(tmp_path: Path, rehearse: Start) -> None:
    trip = at_record(TRIPPED_POINT, lambda world: trip_calibrator(world, world.clock.now_ns() + 5 * NS))
    found = rehearse(tiny_plan(tmp_path), act=trip)
    lived_through(found)
    outcome = found.run.outcome
    assert outcome.retaken == len(found.events("retake")) == 1
    assert windows_again(found) == [(row.window, row.quality) for row in outcome.rows]


def mute(world: World, role: str) -> None:
    world.faults.instrument(role).mute = True


@pytest.mark.slow
@pytest.mark.parametrize("role", ["calibrator", pytest.param("switch", marks=pytest.mark.sweep)])
def test_an_instrument_that_stays_silent_ends_the_run_safely(
    tmp_path: Path, rehearse: Start, role: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hold, "AWAY_LIMIT_S", 60.0)
    found = rehearse(tiny_plan(tmp_path), act=at_record(4, lambda world: mute(world, role)))
    error = ended_with(found, "B-RUN-070")
    assert role in error.where
    assert [(failure.where, failure.code) for failure in found.run.outcome.unsafe] == [(role, "B-RUN-060")]
    assert_safe(found.world)  # it hears what it cannot confirm
    assert (found.run.folder / "journal.jsonl").exists()


@pytest.mark.parametrize(
    "role", ["switch", "supply", *(pytest.param(role, marks=pytest.mark.sweep) for role in ("calibrator", "chamber"))]
)
def test_an_instrument_that_is_silent_for_a_while_costs_no_record(tmp_path: Path, rehearse: Start, role: str) -> None:
    def for_a_while(world: World) -> None:
        world.switches.switch("mute", role)
        world.after(60.0, lambda: world.switches.switch("mute", role, "off"))

    found = rehearse(tiny_plan(tmp_path), act=at_record(4, for_a_while))
    lived_through(found)
    assert found.run.outcome.unsafe == ()
    assert_safe(found.world)


@pytest.mark.parametrize("role", ["calibrator", "switch", "chamber", "rail_dmm"])
def test_a_wrong_instrument_gets_no_command_and_nothing_is_switched(tmp_path: Path, rehearse: Start, role: str) -> None:
    heard: list[list[str]] = []

    def exchange(world: World) -> None:
        world.faults.instrument(role).identity = "ACME,42,0,0"
        heard.append(overheard(world))

    with pytest.raises(BenchError) as caught:
        rehearse(tiny_plan(tmp_path), arrange=exchange)
    assert caught.value.code == "B-INST-002"
    assert role in caught.value.where
    assert_nothing_switched(heard[0])
    assert not (tmp_path / "out").exists()


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
    assert {one.dropped for one in estimates_of(found) if one.quantity == "dsf_n"} == {3}
    assert worst_u(found) < 1.0


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


def test_a_chamber_that_runs_away_is_stopped_and_not_held(tmp_path: Path, rehearse: Start) -> None:
    run_away = at_soak(lambda world: world.switches.switch("chamber_runaway", 0.3), ("campaign",))
    found = rehearse(tiny_plan(tmp_path), act=run_away)
    ended_with(found, "B-RUN-031")
    assert found.run.outcome.unsafe == ()
    assert found.world.instruments["chamber"].outputs()["mode"] == "stopped"
    assert_safe(found.world)


def left_on(world: World) -> None:
    """As after a controller that was killed: 100 mA through channel 1."""
    switch, calibrator = world.instruments["switch"], world.instruments["calibrator"]
    switch.execute(":CLOS (@1!1!1)")
    for text in ("OUT 1.0E-01 A, 0 HZ", "OPER"):
        calibrator.execute(text)
    assert calibrator.operating


def refused(tmp_path: Path, rehearse: Start, change: Callable[[World], object]) -> tuple[BenchError, World]:
    """Return why a run does not begin on a bench that was left on and changed, and its world."""
    watched = Watched()
    with pytest.raises(BenchError) as caught:
        rehearse(tiny_plan(tmp_path), arrange=lambda world: (left_on(world), change(world)), watched=watched)
    world = watched.worlds[0]
    assert world.wiring.closed == frozenset()
    return caught.value, world


def no_space(*_: object, **__: object) -> Any:
    raise RecordError("B-REC-001", "cannot be written: No space left on device")


def test_a_bench_that_was_left_on_is_made_safe_before_the_first_prompt(tmp_path: Path, rehearse: Start) -> None:
    seen: list[bool] = []
    found = rehearse(
        tiny_plan(tmp_path),
        arrange=left_on,
        act=lambda world, step: seen.append(bool(world.instruments["calibrator"].operating)),
    )
    assert found.run.outcome.error is None
    assert seen[0] is False


@pytest.mark.parametrize("role", ["logger", "calibrator"])
def test_a_silent_instrument_at_the_start_leaves_nothing_on(tmp_path: Path, rehearse: Start, role: str) -> None:
    error, world = refused(tmp_path, rehearse, lambda world: setattr(world.faults.instrument(role), "mute", True))
    assert error.code == "B-INST-001"
    assert any("B-RUN-060" in note and role in note for note in error.__notes__)
    assert role == "calibrator" or not world.instruments["calibrator"].operating


def test_an_instrument_with_another_serial_number_is_refused(tmp_path: Path, rehearse: Start) -> None:
    def other(world: World) -> None:
        world.faults.instrument("calibrator").identity = "FLUKE,5720A,OTHER99,1.0"

    error, world = refused(tmp_path, rehearse, other)
    assert error.code == "B-RUN-006"
    assert "OTHER99" in error.message
    assert not world.instruments["calibrator"].operating
    assert not (tmp_path / "out").exists()


def test_a_disk_without_room_is_refused_before_anything_is_opened(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(free=1_000_000))
    with pytest.raises(BenchError, match="B-RUN-005"):
        rehearse(tiny_plan(tmp_path), arrange=lambda world: pytest.fail("the bench was opened"))


def test_a_session_that_cannot_be_created_leaves_nothing_on(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SessionWriter, "create", no_space)
    error, world = refused(tmp_path, rehearse, lambda world: None)
    assert error.code == "B-REC-001"
    assert not world.instruments["calibrator"].operating


def test_a_session_that_cannot_be_closed_still_tells_how_the_run_ended(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SessionWriter, "close", no_space)
    outcome = rehearse(tiny_plan(tmp_path)).run.outcome
    assert outcome.error.code == "B-RUN-061"
    assert outcome.unsafe == ()
    assert len(outcome.rows) == 15
