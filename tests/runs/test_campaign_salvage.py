"""Salvage: the shortest make-up sequence, a session made with it, both together; and who may go on with a session."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from plan_sample import reworded
from rehearsal import (
    ROOT,
    SEED,
    Crashes,
    Rehearsal,
    assert_nothing_switched,
    compiled,
    copied,
    crashed_at,
    go_on,
    overheard,
    rehearsed,
    shortened,
    tiny_plan,
)

from bench.analysis import results_json
from bench.commands.fit import fit
from bench.commands.recover import recover
from bench.commands.resume import resume
from bench.model.clock import VirtualClock
from bench.model.errors import ExitStatus, InputError, InstrumentError, SessionDamaged
from bench.model.events import Skip
from bench.model.lab import find_shipped
from bench.plan import Plan, Step, check_plan, compile_sequence, frozen_plan, load_station
from bench.record import Journal, SessionReader
from bench.replay import replay_rows
from bench.run.bus.talk import TalkSession
from bench.run.resume import changed_files, read_stopped
from bench.run.session import Conducted
from bench.session.happenings import happenings
from bench.session.makeup import make_up_sequence
from bench.session.record_states import record_states
from bench.session.service import merged, read_view
from bench.session.view import SessionView, analyse_view
from sim_instruments.worlds.common.world import World

Start = Callable[..., Rehearsal]
SETTINGS = {"world.calibrator_gain": "off", "dwell": "8 s"}


def small_plan(folder: Path) -> Plan:
    """Two temperatures, one channel, no closing repeat, with a dwell given by hand: 30 records."""
    tiny_plan(folder)
    changes = (
        ("in: [25 degC]", "in: [23 degC, 25 degC]"),
        ("sequence: tiny", "sequence: small"),
        ("duration: 2250 s\nrecords: 15\n", ""),
    )
    return compile_sequence(shortened(folder / "tiny.yaml", folder, "small", *changes), None, SETTINGS)


def nothing_recorded(*events: tuple[int, object]) -> Any:
    """Return a replay without a record."""
    return SimpleNamespace(manifest={}, rows=(), events=list(events), damage=())


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A session whose run was killed inside the second temperature, and the same run undisturbed."""
    folder = tmp_path_factory.mktemp("salvage")
    plan = small_plan(folder)
    number = [step.number for step in plan.phase("campaign") if step.kind == "record"][21]
    crashes = crashed_at(plan, folder, {number})
    return crashes.at(number), crashes.whole


def test_the_make_up_takes_what_is_missing_and_an_overlap(
    stopped: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The salvaged folder itself is untouched."""
    path = tmp_path / "rest.yaml"
    before = {path.name: path.read_bytes() for path in stopped[0].iterdir()}
    assert recover(stopped[0], path, as_json=False) == ExitStatus.PASS
    replay_rows(stopped[0])
    assert {path.name: path.read_bytes() for path in stopped[0].iterdir()} == before
    said = capsys.readouterr().out
    assert "9 points to make up and 1 that overlap" in " ".join(said.split())
    plan = compile_sequence(path, None, {"world.calibrator_gain": "off"})
    assert check_plan(plan) == []
    planned = small_plan(tmp_path)
    taken = [step for step in plan.phase("campaign") if step.kind == "record"]
    assert [step.kind for step in plan.phase("campaign")].count("soak") == 1
    assert len(taken) == 10
    wanted = [step for step in planned.phase("campaign") if step.kind == "record"]
    assert [dict(step.conditions) for step in taken[1:]] == [dict(step.conditions) for step in wanted[21:]]
    assert {step.seconds for step in taken} == {8.0}
    assert taken[0].conditions["temperature_degC"] == 25.0
    assert taken[0].conditions["current_A"] > 0
    with pytest.raises(InputError, match="B-RES-009"):
        recover(stopped[0], path, as_json=False)


@pytest.mark.slow
def test_both_sessions_together_give_what_was_promised(stopped: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "rest.yaml"
    recover(stopped[0], path, as_json=False)
    made = compile_sequence(path, None, {"world.calibrator_gain": "off"})
    make_up = rehearsed(tmp_path / "out", made).run.folder
    alone, _ = analyse_view(read_view(stopped[0]))
    assert alone["incomplete"] is True
    view = merged(read_view(stopped[0]), [read_view(make_up)])
    together, analysis = analyse_view(view)
    assert analysis.missing == []
    assert "incomplete" not in together
    assert together["provenance"]["make_up_sha256"] == [read_view(make_up).session_sha256]
    assert together["quality"]["records"] == 31
    starts = [row.window.t_start_ns for row in view.rows]
    assert starts == sorted(starts)
    assert [row.window.number for row in view.rows] == list(range(3, 24)) + list(range(26, 36))
    (note,) = [note for note in view.notes if note.startswith("Overlap, channel 1 at 25 degC")]
    again = next(row for row in view.rows if row.window.number == 26)
    (before, _) = (row for row in view.rows if row.window.conditions == again.window.conditions)
    counts = [int(row.sums["npp"][0]) - int(row.sums["ppp"][0]) for row in (before, again)]
    assert abs(counts[1] - counts[0]) <= 1, "the level may be one at which a count is 1600 ppm"
    assert before.sums["master_count"] == again.sums["master_count"]
    change_ppm = 1e6 * (counts[1] / counts[0] - 1.0)
    assert note.split(": ")[1] == f"{change_ppm:+.2f} ppm in the make-up session."
    whole, _ = analyse_view(read_view(stopped[1]))
    for name in ("dsf_n", "dsf_p"):
        for temperature_degC in (23.0, 25.0):
            one, other = (estimate(each, name, temperature_degC) for each in (together, whole))
            print(
                f"seed {SEED}: {name} at {temperature_degC} degC: {one['value']} ppm, undisturbed {other['value']} ppm"
            )
            assert abs(one["value"] - other["value"]) < 3 * 2**0.5 * one["std_uncertainty"]
    assert fit(stopped[0], None, as_json=True, make_up=[make_up]) == ExitStatus.PASS


def estimate(results: dict[str, Any], quantity: str, temperature_degC: float) -> dict[str, Any]:
    (found,) = [
        one
        for one in results["estimates"]
        if one["quantity"] == quantity and one["conditions"].get("temperature_degC") == temperature_degC
    ]
    return dict(found)


def test_invalid_records_are_made_up_with_their_reason(
    tmp_path: Path, rehearse: Start, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[int] = []

    def cable(world: World, step: Step) -> None:
        if step.kind == "record" and step.phase == "campaign":
            seen.append(step.number)
            world.faults.link("port_a").drop_rate = 0.05 if len(seen) in (4, 9) else 0.0

    found = rehearse(tiny_plan(tmp_path), act=cable)
    path = tmp_path / "rest.yaml"
    assert recover(found.run.folder, path, as_json=True) == ExitStatus.PASS
    states = json.loads(capsys.readouterr().out)["record_states"]
    assert [(one["number"], one["why"]) for one in states if one["state"] == "invalid"] == [
        (6, "frames lost"),
        (11, "frames lost"),
    ]
    plan = compile_sequence(path, None)
    assert len([step for step in plan.phase("campaign") if step.kind == "record"]) == 3


def test_nothing_to_make_up_is_said_and_a_ramp_cannot_be(stopped: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="B-RES-007"):
        recover(stopped[1], tmp_path / "rest.yaml", as_json=False)
    assert not (tmp_path / "rest.yaml").exists()
    plan = compile_sequence("bias_ramp_short")
    with pytest.raises(InputError, match="B-RES-008"):
        make_up_sequence(plan, record_states(plan.steps, nothing_recorded()))


def test_skipped_records_are_missing_for_that_reason(stopped: tuple[Path, Path]) -> None:
    plan = compile_sequence("scale_factor_short")
    records = [step for step in plan.phase("campaign") if step.kind == "record"]
    skip = Skip(first=records[0].number, stop=records[1].number, reason="a door", by="kim")
    states = record_states(plan.steps, nothing_recorded((0, skip)))
    assert [one.why for one in states[:2]] == ["skipped: a door", "the run stopped before"]


@pytest.mark.parametrize("field", ["uut", "serial", "certificate", "corrections"])
def test_a_session_of_another_unit_or_standard_does_not_complete_this_one(
    stopped: tuple[Path, Path], field: str
) -> None:
    """Its records would be judged by the values and uncertainties of a standard that never saw them."""
    view = read_view(stopped[0])
    if field == "uut":
        changed = {"campaign": {**view.manifest["campaign"], "uut": {"model": "NGU", "serial": "SIM-2"}}}
    else:
        changed = {"standards": {role: {**one, field: "another"} for role, one in view.manifest["standards"].items()}}
    other = SessionView({**view.manifest, **changed}, view.rows, view.counts, view.session_sha256)
    with pytest.raises(InputError, match="B-RES-010" if field == "uut" else "standards"):
        merged(view, [other])


def test_the_flat_form_is_made_up_too(tmp_path: Path) -> None:
    """Records of a timeline carry no procedure: what stands since the record before them belongs to the point.

    A second record under the same stimulus is made up under it, too.
    """
    text = (ROOT / "sequences" / "timeline_example.yaml").read_text(encoding="utf-8")
    standby = '  - {at: "00:02:21", call: calibrator.standby}\n'
    path = tmp_path / "twice.yaml"
    twice = (standby, '  - {at: "00:02:21", record: 100 s}\n' + standby.replace("02:21", "04:02"))
    path.write_text(reworded(text, twice, ("00:02:22", "00:04:03")), encoding="utf-8")
    plan = compile_sequence(path)
    text, points, overlap = make_up_sequence(plan, record_states(plan.steps, nothing_recorded()))
    assert (points, overlap) == (2, 0)
    first, second = text.partition("procedures:")[2].split("point_")[1:]
    assert all(part.count("calibrator.operate") == 1 for part in (first, second))
    path = tmp_path / "flat.yaml"
    path.write_text(text)
    made = compile_sequence(path)
    assert check_plan(made) == []
    kinds = [f"{step.role}.{step.name}" for step in made.phase("campaign") if step.kind in ("call", "verify", "unit")]
    assert kinds.index("calibrator.operate") < kinds.index("calibrator.operating")
    assert "supply.output_on" in kinds


def test_another_standard_is_refused_before_any_stimulus(crashes: Crashes, tmp_path: Path) -> None:
    folder = copied(crashes, "between points", tmp_path)
    before = sorted(path.name for path in folder.iterdir())
    heard: list[list[str]] = []

    def exchange(world: World) -> None:
        world.faults.instrument("rail_dmm").identity = "HEWLETT-PACKARD,34401A,4711,11-5-2"
        heard.append(overheard(world))

    with pytest.raises(InstrumentError) as caught:
        go_on(folder, arrange=exchange)
    assert caught.value.code in ("B-RES-006", "B-RUN-006")
    assert_nothing_switched(heard[0])
    assert sorted(path.name for path in folder.iterdir()) == before


def test_a_living_run_is_not_gone_on_with_and_the_frozen_plan_is_the_plan(crashes: Crashes, tmp_path: Path) -> None:
    folder = copied(crashes, "between points", tmp_path)
    journal = Journal(folder)
    with pytest.raises(InputError, match="B-RES-002"):
        read_stopped(folder)
    journal.close()
    frozen, plan = read_stopped(folder).plan, crashes.plan
    assert (frozen.sha256, dict(frozen.campaign)) == (plan.sha256, dict(plan.campaign))
    assert dict(frozen.settings) == dict(plan.settings) == {"world.calibrator_gain": "off"}
    assert dict(frozen.station.world_options) == dict(plan.station.world_options)


def test_another_plan_is_refused_and_the_same_one_is_not(crashes: Crashes, tmp_path: Path) -> None:
    folder = copied(crashes, "finally", tmp_path)
    (tmp_path / "other").mkdir()
    text = crashes.plan.texts["sequences/tiny.yaml"]
    other = tmp_path / "other.yaml"
    other.write_text(text.replace("dwell: 10 s", "dwell: 8 s").replace("duration: 2250 s\n", ""))
    with pytest.raises(InputError, match="B-RES-005"):
        resume(folder, str(other), None, as_json=False)
    same = tmp_path / "same.yaml"
    same.write_text(text)
    assert resume(folder, str(same), None, as_json=False) == ExitStatus.PASS


def test_a_session_without_a_plan_is_refused(tmp_path: Path) -> None:
    station = load_station(find_shipped("stations", "af_bench_sim"))
    with TalkSession(station, "dmm", VirtualClock(), tmp_path) as session:
        session.send("ID?")
        folder = session.folder
    with pytest.raises(InputError, match="B-RES-003"):
        read_stopped(folder)


def test_a_session_that_lost_its_plan_is_refused(crashes: Crashes, tmp_path: Path) -> None:
    folder = copied(crashes, "between points", tmp_path)
    stopped = read_stopped(folder)
    texts = dict(SessionReader(folder).texts)
    changed = texts["plan.json"].replace('"current":0.1,', '"current":0.2,', 1)
    assert changed != texts["plan.json"]
    missing = {name: text for name, text in texts.items() if not name.startswith("stations/")}
    for damaged in ({**texts, "plan.json": changed}, {**texts, "plan.json": "[{}]"}, missing):
        with pytest.raises(SessionDamaged, match="B-RES-004"):
            frozen_plan(folder, stopped.manifest, damaged)


def own_files(folder: Path) -> Path:
    """A sequence with its station and frames in folders of its own."""
    for kind in ("stations", "frames"):
        shutil.copytree(ROOT / kind, folder / kind)
    (folder / "sequences").mkdir()
    tiny_plan(folder)
    return (folder / "tiny.yaml").rename(folder / "sequences" / "tiny.yaml")


def test_a_changed_file_does_not_matter_and_is_reported(tmp_path: Path) -> None:
    path = own_files(tmp_path)

    def nothing(world: World, step: Step) -> None:
        return None

    def change(world: World, step: Step) -> None:
        if step.kind == "soak" and step.phase == "campaign":
            path.write_text("sequence: destroyed\n")
            (tmp_path / "frames" / "ngu_a.yaml").unlink()

    plan = compiled(path)
    quiet, told = (rehearsed(tmp_path / act.__name__, plan, act=act, kept=("config",)) for act in (nothing, change))
    assert quiet.events("config") == []
    assert not any("on the disk" in text for text in quiet.watched.messages)
    assert told.events("config") == [
        {"file": "frames/ngu_a.yaml", "change": "gone"},
        {"file": "sequences/tiny.yaml", "change": "changed"},
    ]
    undisturbed, changed = quiet.run, told.run
    assert undisturbed.outcome.error is changed.outcome.error is None
    assert "sequences/tiny.yaml is changed on the disk; the run used its own copy" in told.watched.messages
    assert any(text.startswith("config at") for text in happenings(read_view(changed.folder)))
    assert changed_files(plan.files, plan.texts) == {"frames/ngu_a.yaml": "gone", "sequences/tiny.yaml": "changed"}
    the_same_but_for_the_hash(undisturbed, changed)


def the_same_but_for_the_hash(first: Conducted, second: Conducted) -> None:
    """Results to the last bit, and every byte and command; the session's own hash covers the event that says so."""
    documents, payloads = [], []
    for done in (first, second):
        results, _ = analyse_view(read_view(done.folder))
        assert results["provenance"].pop("session_sha256") == done.session_sha256
        documents.append(results_json(results))
        recorded = SessionReader(done.folder).messages(frozenset({"/link/", "/instrument/"}))
        payloads.append([(one.topic, one.t_ns, one.payload) for one in recorded])
    assert documents[0] == documents[1]
    assert payloads[0] == payloads[1]
