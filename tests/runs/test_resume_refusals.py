"""Who may go on with a session: what is refused, and a file changed since that does not matter."""

from __future__ import annotations

import json
import shutil
import zlib
from pathlib import Path

import pytest
from rehearsal import (
    ROOT,
    Crashes,
    assert_nothing_switched,
    compiled,
    copied,
    go_on,
    kinds,
    overheard,
    rehearsed,
    tiny_plan,
)

from bench.analysis import results_json
from bench.commands.resume import resume
from bench.model.clock import VirtualClock
from bench.model.errors import ExitStatus, InputError, InstrumentError, SessionDamaged
from bench.model.shipped import find_shipped
from bench.plan import Step, frozen_plan, load_station
from bench.record import Journal, SessionReader
from bench.run.bench.talk import TalkSession
from bench.run.resume import changed_files, read_stopped
from bench.run.session import Conducted
from bench.session.happenings import happenings
from bench.session.service import read_view
from bench.session.view import analyse_view
from sim_instruments.worlds.common.world import World


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


def test_a_living_run_is_not_gone_on_with(crashes: Crashes, tmp_path: Path) -> None:
    folder = copied(crashes, "between points", tmp_path)
    journal = Journal(folder)
    with pytest.raises(InputError, match="B-RES-002"):
        read_stopped(folder)
    journal.close()
    assert read_stopped(folder).plan.sha256 == crashes.plan.sha256


def test_a_journal_of_another_version_is_refused_and_nothing_is_lost(crashes: Crashes, tmp_path: Path) -> None:
    folder = copied(crashes, "between points", tmp_path)
    path = folder / "journal.jsonl"
    content = b""
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        text = json.dumps({"v": 2, **json.loads(line[9:])}).encode()
        content += b"%08x %b\n" % (zlib.crc32(text, number), text)
    path.write_bytes(content)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    with pytest.raises(InputError, match="B-REC-007") as caught:
        resume(folder, None, None, as_json=False)
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


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


def test_the_frozen_plan_is_the_plan(crashes: Crashes) -> None:
    stopped = read_stopped(crashes.at(kinds(crashes.plan)["between points"]))
    assert stopped.plan.sha256 == crashes.plan.sha256
    assert dict(stopped.plan.settings) == dict(crashes.plan.settings) == {"world.calibrator_gain": "off"}
    assert dict(stopped.plan.station.world_options) == dict(crashes.plan.station.world_options)
    assert dict(stopped.plan.campaign) == dict(crashes.plan.campaign)


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
