"""Files that are changed while a run goes on: the run uses its frozen copy, says so, and gives the same numbers."""

from __future__ import annotations

import shutil
from pathlib import Path

from rehearsal import ROOT, SEED, Watched, tiny_plan

from bench.analysis import results_json
from bench.model.clock import VirtualClock
from bench.plan import Plan, Step, compile_sequence
from bench.record import SessionReader
from bench.run.control.operator import SimulatedOperator
from bench.run.frozen import changed_files
from bench.run.session import Conducted, conduct
from bench.session.happenings import happenings
from bench.session.service import read_view
from bench.session.view import analyse_view
from sim_instruments.worlds.common.world import World


def own_files(folder: Path) -> Path:
    """A sequence with its station and frames in folders of its own."""
    for kind in ("stations", "frames"):
        shutil.copytree(ROOT / kind, folder / kind)
    (folder / "sequences").mkdir()
    tiny_plan(folder)
    return (folder / "tiny.yaml").rename(folder / "sequences" / "tiny.yaml")


def run(path: Path, out: Path, watched: Watched) -> tuple[Plan, Conducted]:
    plan = compile_sequence(path, None, {"world.calibrator_gain": "off"})
    done = conduct(
        plan, clock=VirtualClock(), seed=SEED, out=out, operator=SimulatedOperator(), listener=watched,
        keep_events=("config",),
    )  # fmt: skip
    assert done.outcome.error is None
    return plan, done


def test_a_changed_file_does_not_matter_and_is_reported(tmp_path: Path) -> None:
    path = own_files(tmp_path)

    def change(world: World, step: Step) -> None:
        if step.kind == "soak" and step.phase == "campaign":
            path.write_text("sequence: destroyed\n")
            (tmp_path / "frames" / "ngu_a.yaml").unlink()

    quiet = Watched(lambda world, step: None, worlds=[None])  # type: ignore[list-item]
    plan, undisturbed = run(path, tmp_path / "a", quiet)
    assert undisturbed.events == []
    assert not any("on the disk" in text for text in quiet.messages)
    watched = Watched(change, worlds=[None])  # type: ignore[list-item]
    _, changed = run(path, tmp_path / "b", watched)
    events = [fields for _, _, fields in changed.events]
    assert events == [
        {"file": "frames/ngu_a.yaml", "change": "gone"},
        {"file": "sequences/tiny.yaml", "change": "changed"},
    ]
    assert "sequences/tiny.yaml is changed on the disk; the run used its own copy" in watched.messages
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
