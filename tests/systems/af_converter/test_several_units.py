"""Three AF converters in one chamber, under the virtual clock: proof, results of each, one that fails, its export."""

import itertools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rehearsal import Rehearsal, main_of, rehearsed
from units_campaign import events_of, ramp_plan, units_plan

from bench.archive.refit import RefitTask, refit
from bench.commands.resume import resume
from bench.model.clock import VirtualClock
from bench.model.errors import InputError, InstrumentError, OperatorStop
from bench.model.ports import RecordWindow
from bench.plan import UNIT, Step
from bench.record import SessionReader
from bench.run.besides import besides
from bench.run.resume import read_stopped
from bench.session.one_unit import extract
from bench.session.service import read_view
from bench.session.units import UnitFinished, finish_units, in_each_unit
from bench.session.view import analyse_view
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.simulation import open_world

pytestmark = pytest.mark.usefixtures("without_pictures")

OUT_AT_REPEAT = "SIM-3"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Rehearsal:
    """A campaign in which the measurement link of unit C is unplugged when its closing repeat begins."""
    folder = tmp_path_factory.mktemp("units")
    pulled: list[int] = []

    def pull(world: World, step: Step) -> None:
        of_repeat = step.conditions.get(UNIT) == OUT_AT_REPEAT and step.conditions.get("repeat") == 1
        if step.kind == "record" and of_repeat and not pulled:
            pulled.append(step.number)
            world.switches.switch("unplug", "c_port_a")

    return rehearsed(folder, units_plan(folder), act=pull)


@pytest.fixture(scope="module")
def finished(campaign: Rehearsal, tmp_path_factory: pytest.TempPathFactory) -> list[UnitFinished]:
    history = tmp_path_factory.mktemp("history") / "history.sqlite"
    return finish_units(campaign.run.folder, f"sqlite:///{history}")


@pytest.fixture(scope="module")
def exported(campaign: Rehearsal, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("customer") / "session"
    extract(campaign.run.folder, "SIM-1", folder)
    return folder


def test_the_others_finish_once_a_unit_is_confirmed_off(campaign: Rehearsal) -> None:
    assert campaign.run.outcome.error is None
    assert campaign.run.outcome.unsafe == ()
    (out,) = events_of(campaign.run.folder, "unit_left_out")
    assert (out["uut"], out["slot"], out["code"]) == ("SIM-3", "C", "B-RUN-024")
    assert out["confirmed"] == ["calibrator", "switch", "supply_c"]
    rows = [row.window.conditions for row in campaign.run.outcome.rows]
    by_unit = {unit: sum(row[UNIT] == unit for row in rows) for unit in ("SIM-1", "SIM-2", "SIM-3")}
    assert by_unit == {"SIM-1": 14, "SIM-2": 14, "SIM-3": 7}


def test_nothing_is_done_for_a_unit_behind_its_leaving_out(campaign: Rehearsal) -> None:
    """By what was sent over the bus: the supply of C was told off and never on again."""
    (left_ns,) = [t for kind, t, _ in SessionReader(campaign.run.folder).events() if kind == "unit_left_out"]
    said = SessionReader(campaign.run.folder).select(frozenset({"/instrument/supply_c"}))
    sent = [(m.t_ns, m.document()["text"]) for m in said if m.document()["direction"] == "tx"]
    assert any(text == "OUTP OFF" and t_ns <= left_ns for t_ns, text in sent)
    assert [text for t_ns, text in sent if t_ns > left_ns and text == "OUTP ON"] == []
    closed = SessionReader(campaign.run.folder).select(frozenset({"/instrument/switch"}))
    assert not any("(@3!" in m.document()["text"] for m in closed if m.t_ns > left_ns)


def test_each_unit_gets_its_own_numbers(campaign: Rehearsal, finished: list[UnitFinished]) -> None:
    """Against the simulated truth of each unit, which differ by hundreds of ppm; U is that of 95 %."""
    truth = {
        (entry["conditions"]["unit"], entry["quantity"]): entry["value"]
        for entry in campaign.run.truth
        if entry["quantity"] in ("dsf_n", "dsf_p", "dsf_asymmetry")
    }
    spread = [truth["SIM-1", "dsf_n"], truth["SIM-2", "dsf_n"]]
    assert abs(spread[0] - spread[1]) > 100.0
    for done in finished[:2]:
        results = done.finished.results
        assert results["uut"]["serial"] == done.serial
        assert results["quality"]["records"] == 14
        compared = [entry for entry in results["estimates"] if (done.serial, entry["quantity"]) in truth]
        assert len(compared) == 3
        for entry in compared:
            error = entry["value"] - truth[done.serial, entry["quantity"]]
            assert abs(error) <= 1.5 * entry["expanded_uncertainty"], (done.serial, entry)


def test_the_list_of_all_has_every_estimate_with_its_unit(campaign: Rehearsal, finished: list[UnitFinished]) -> None:
    """That which failed has no verdict, and says why; no report of a unit names another one."""
    whole = json.loads((campaign.run.folder / "results.json").read_text())
    assert {entry["conditions"][UNIT] for entry in whole["estimates"]} == {"SIM-1", "SIM-2", "SIM-3"}
    assert whole["uut"]["serial"] == "LOT-1"
    assert whole["provenance"]["session_sha256"] == campaign.run.session_sha256
    assert sum(len(done.finished.results["estimates"]) for done in finished if done.finished) == len(whole["estimates"])
    failed = finished[2].finished
    assert failed.results["incomplete"] is True
    assert {entry["verdict"] for entry in failed.results["estimates"]} == {"none"}
    pages = [(campaign.run.folder / "units" / name / "report.html").read_text() for name in ("SIM-3", "SIM-1")]
    assert "unit SIM-3 in slot C is left out" in pages[0]
    assert not any(serial in pages[1] for serial in ("SIM-2", "SIM-3"))
    assert "between channels" not in pages[1]  # one channel: nothing that it could be correlated with


def test_the_archive_refits_each_unit(campaign: Rehearsal, finished: list[UnitFinished], tmp_path: Path) -> None:
    """The values of each unit again as released, and not from another recording."""
    released = [entry for done in finished if done.finished for entry in done.finished.results["estimates"]]
    head = {"session": "units", "session_sha256": campaign.run.session_sha256}
    task = RefitTask(str(campaign.run.folder), head, None, {}, 1)
    rows = refit(task)
    assert {row["uut_serial"] for row in rows if row["code"] == ""} == {"SIM-1", "SIM-2", "SIM-3"}
    assert len(rows) == len(released)
    assert all(row["value"] == row["released_value"] for row in rows)
    (other,) = refit(replace(task, head={**head, "session_sha256": "0" * 64}))
    assert other["code"] == "B-ARC-004"


def test_an_export_verifies_without_the_other_units(
    exported: Path, finished: list[UnitFinished], monkeypatch: pytest.MonkeyPatch
) -> None:
    view = read_view(exported, strict=True)
    results, _ = analyse_view(view)
    done = finished[0].finished
    assert json.dumps(results, sort_keys=True) == json.dumps(done.results, sort_keys=True)
    assert view.manifest["part_of"]["units"] == 3
    for name in ("results.json", "report.html"):
        source = finished[0].folder / name
        (exported / name).write_bytes(source.read_bytes())
    assert main_of(monkeypatch, "report", str(exported), "--verify") == 0


def test_an_export_holds_nothing_of_another_unit(campaign: Rehearsal, exported: Path, tmp_path: Path) -> None:
    """No serial number in any text, no other link or supply, and exactly the bytes of the unit's own links."""
    whole, own = SessionReader(campaign.run.folder), SessionReader(exported)
    links = {topic for topic in own.counts if topic.startswith("/link/")}
    assert links == {"/link/port_a/rx", "/link/port_b/rx", "/link/port_b/tx"}
    for port in ("port_a", "port_b"):
        topics = (frozenset({f"/link/a_{port}/rx"}), frozenset({f"/link/{port}/rx"}))
        before, after = (
            b"".join(bytes(m.payload) for m in reader.select(topic))
            for reader, topic in zip((whole, own), topics, strict=True)
        )
        assert before == after
    assert {"/instrument/supply", "/instrument/calibrator"} <= own.counts.keys()
    assert not any("supply_" in topic for topic in own.counts)
    assert not any(role.startswith("supply_") for role in (*own.manifest["standards"], *own.manifest["identities"]))
    for message in own.messages():
        told = b"" if message.topic.startswith("/link/") else bytes(message.payload)
        assert not any(serial in told for serial in (b"SIM-2", b"SIM-3")), message.topic
    assert own.damage == []
    assert extract(campaign.run.folder, "SIM-1", tmp_path / "again") == own.sha256, "the same whenever it is made"


def links_exchanged(world: World) -> None:
    ports: Any = world.unit
    a, b = ports._ports["a_port_b"], ports._ports["b_port_b"]
    ports._ports.update({"a_port_b": b, "b_port_b": a})


def cables_exchanged(world: World) -> None:
    plain = world.wiring.switch
    other = {column: column + 10 if column <= 10 else column - 10 for column in range(1, 21)}
    world.wiring.switch = lambda closed, t_ns: plain(  # type: ignore[method-assign]
        frozenset((row, other.get(column, column)) for row, column in closed), t_ns
    )


@pytest.mark.parametrize(
    ("exchange", "code", "said"),
    [
        (links_exchanged, "B-RUN-026", "slot A answers 'NGU SIM-2 1.0', expected SIM-1; it is the unit of slot B"),
        (cables_exchanged, "B-RUN-052", "unit SIM-1 in slot A moves channel 2 of unit SIM-2 in slot B"),
    ],
)
def test_exchanged_links_and_cables_are_named(
    tmp_path: Path, exchange: Callable[[World], None], code: str, said: str
) -> None:
    outcome = rehearsed(tmp_path, units_plan(tmp_path), arrange=exchange).run.outcome
    assert outcome.error.code == code
    assert said in outcome.error.message
    assert outcome.rows == []


def test_what_is_done_for_one_unit_refuses_a_session_of_several(campaign: Rehearsal, tmp_path: Path) -> None:
    """And a world of one unit takes no slots."""
    station = {"slots": {"A": {}}}
    for code, done in (
        ("B-RPL-007", lambda: read_view(campaign.run.folder)),
        ("B-CLI-014", lambda: extract(campaign.run.folder, "SIM-9", tmp_path)),
        ("B-SIM-020", lambda: open_world("plain_unit", clock=VirtualClock(), seed=1, station=station)),
    ):
        with pytest.raises(InputError) as refused:
            done()
        assert refused.value.code == code
    seen: list[str] = []
    assert in_each_unit(campaign.run.folder, lambda home: seen.append(home.name) or len(seen)) == 3
    assert seen == ["SIM-1", "SIM-2", "SIM-3"]
    assert list((campaign.run.folder / "units" / "SIM-1").glob("*.mcap")) == []


def test_a_run_that_is_gone_on_with_keeps_who_was_left_out(tmp_path: Path) -> None:
    """Stopped at the closing repeat; behind the resumption the port of C is there again, and nobody asks for it."""

    def pull_then_stop(world: World, step: Step) -> None:
        if step.kind == "record" and step.phase == "campaign" and step.conditions[UNIT] == "SIM-3":
            world.switches.switch("unplug", "c_port_a")
        if step.kind == "record" and step.conditions.get("repeat") == 1:
            raise OperatorStop("B-RUN-010", "stopped by the test")

    first = rehearsed(tmp_path, units_plan(tmp_path), act=pull_then_stop).run
    stopped = read_stopped(first.folder)
    resume(first.folder, None, None, as_json=False)
    of_each = {path.parent.name: path.read_bytes() for path in first.folder.glob("units/*/results.json")}
    assert of_each.keys() >= {"SIM-1", "SIM-2"}
    (first.folder / "results.json").unlink()
    resume(first.folder, None, None, as_json=False)  # only the results are missing
    assert json.loads((first.folder / "results.json").read_text())["estimates"]
    assert of_each == {path.parent.name: path.read_bytes() for path in first.folder.glob("units/*/results.json")}
    said = SessionReader(first.folder).select(frozenset({"/instrument/supply_c", "/link/c_port_b/tx"}))
    after = [message for message in said if message.t_ns > stopped.last_ns]
    assert not any(m.topic.startswith("/link/") for m in after)
    assert [m.document()["text"] for m in after if m.document()["text"] == "OUTP ON"] == []
    for serial, records in (("SIM-1", 14), ("SIM-3", 0)):
        extract(first.folder, serial, tmp_path / serial)
        view = read_view(tmp_path / serial)
        assert (len(view.rows), len(view.splices), view.incomplete) == (records, 1, serial == "SIM-3")


def test_open_inputs_of_all_units_are_recorded_at_once_and_without_a_gap(tmp_path: Path) -> None:
    """Each by its own counter: no frame of any unit is in two windows, none between them."""
    run = rehearsed(tmp_path, ramp_plan(tmp_path)).run
    assert run.outcome.error is None
    windows: dict[str, list[RecordWindow]] = {}
    for row in run.outcome.rows:
        assert row.lost == 0
        windows.setdefault(str(row.window.conditions[UNIT]), []).append(row.window)
    assert {unit: len(own) for unit, own in windows.items()} == {"SIM-1": 20, "SIM-2": 20, "SIM-3": 20}
    for own in windows.values():
        assert all(after.first_counter == w.first_counter + w.frames for w, after in itertools.pairwise(own))
    assert len({own[0].t_start_ns for own in windows.values()}) == 1
    assert events_of(run.folder, "gap") == []
    extract(run.folder, "SIM-2", tmp_path / "SIM-2")
    view = read_view(tmp_path / "SIM-2")
    assert [row.window.number for row in view.rows] == list(range(1, 21))
    assert all(row.timing is not None for row in view.rows)


def test_a_unit_that_is_not_confirmed_off_ends_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise InstrumentError("B-INST-009", "the output is still on", where="supply_c")

    def pull(world: World, step: Step) -> None:
        if step.kind == "record" and step.conditions.get(UNIT) == "SIM-3":
            world.switches.switch("unplug", "c_port_a")
            monkeypatch.setattr("instruments.hp_6632b.Hp6632B.make_safe", fails)

    found = rehearsed(tmp_path, units_plan(tmp_path), act=pull)
    error = found.run.outcome.error
    assert error.code == "B-RUN-053"
    assert "supply_c" in str(error)
    assert {failure.where for failure in found.run.outcome.unsafe} == {"supply_a", "supply_b", "supply_c", "supply_d"}


def test_a_unit_beyond_its_own_limit_is_left_out_when_it_lasts(campaign: Rehearsal, tmp_path: Path) -> None:
    """The warmest of the three by a limit between it and the others; a hold that lasts ten minutes."""
    told = [event for event in events_of(campaign.run.folder, "environment") if event["unit_degC"] is not None]
    first = {str(event["uut"]): event["unit_degC"] for event in reversed(told) if "uut" in event}
    (_, second), (warmest, highest) = sorted(first.items(), key=lambda item: item[1])[-2:]
    rule = f"warm: {{signal: unit_temperature, high: {(second + highest) / 2:.4f} degC, dwell: 5 s, action: hold}}"

    def end(world: World, step: Step) -> None:
        if step.phase == "campaign":
            raise OperatorStop("B-RUN-010", "nothing more is to be seen")

    plan = units_plan(tmp_path, ("\nunit_commands:\n", f"\ninterlocks:\n  {rule}\n\nunit_commands:\n"))
    found = rehearsed(tmp_path, plan, act=end, beside=besides(plan, {}, virtual=True))
    (out,) = events_of(found.run.folder, "unit_left_out")
    assert (out["uut"], out["code"]) == (warmest, "B-RUN-070")
    assert out["confirmed"] == ["calibrator", "switch", f"supply_{out['slot'].lower()}"]


def test_the_gradient_of_the_slot_is_in_u_once(short: tuple[Path, Any]) -> None:
    """u grows by what one standard deviation of the gradient moves, by the channel's own temperature coefficient."""
    view = read_view(short[0])
    campaign = {**view.manifest["campaign"], "gradient_degC": 0.6}
    in_slot = replace(view, manifest={**view.manifest, "campaign": campaign})
    (alone, _), (shared, analysis) = analyse_view(view), analyse_view(in_slot)
    slopes = {
        (entry["quantity"].removesuffix("_tc1"), entry["conditions"]["channel"]): entry["value"]
        for entry in alone["estimates"]
        if entry["quantity"] in ("dsf_n_tc1", "dsf_p_tc1")
    }
    pairs = [
        (before, after)
        for before, after in zip(alone["estimates"], shared["estimates"], strict=True)
        if before["quantity"] in ("dsf_n", "dsf_p")
    ]
    assert len(pairs) == 12
    for before, after in pairs:
        slope = slopes[before["quantity"], before["conditions"]["channel"]]
        grown = after["std_uncertainty"] ** 2 - before["std_uncertainty"] ** 2
        assert grown == pytest.approx((0.3 * slope) ** 2, rel=1e-6)
        assert after["value"] == before["value"]
    names = [str(component["component"]) for component in analysis.components]
    assert names.count("chamber's gradient and heat of neighbours") == 2  # a kind of channel each
