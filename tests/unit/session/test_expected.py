"""What a session was to give and will come to, in part and at its end; its happenings in words."""

import json
import math
import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import pytest
from plan_sample import planned
from rehearsal import ROOT
from trend_sample import run_short, short_plan

from bench.analysis import (
    Analysis,
    Estimates,
    Evidence,
    Prediction,
    agreements,
    analyse,
    by_foreseen_name,
    estimate,
    weigh,
)
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.events import Environment, Event, Phase, Resume, event_of
from bench.model.lab import find_shipped
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.model.systems import analyses
from bench.plan import Plan, compile_sequence
from bench.record import UNIT_TEMPERATURE, RecordRow
from bench.replay import Splice
from bench.session import partial as command
from bench.session.away import doubted, placed_later
from bench.session.happenings import alarms_raised, commands_given, happening_tables, happenings, length_s, surroundings
from bench.session.makeup import make_up_sequence
from bench.session.predicted import predicted
from bench.session.record_states import record_states
from bench.session.service import merged, read_view
from bench.session.view import SessionView, expectations, material_of, predicted_of

Short = tuple[Path, subprocess.CompletedProcess[str]]
FIRST_TEMPERATURE = 45  # records of the short campaign, three channels of fifteen
CLOSE = 1.15  # temperatures that were not quite reached
SENSOR, DRIFT = "temperature sensor of the unit", "drift of the calibrator"
STEADY = "steady drift of the calibrator, by the times of the records"


@pytest.fixture(scope="module")
def view(short: Short) -> SessionView:
    return read_view(short[0])


def stated(view: SessionView) -> Estimates:
    return analyse(material_of(view)).estimates


def test_the_prediction_of_a_session_is_that_of_its_sequence(view: SessionView) -> None:
    plan = compile_sequence(ROOT / "sequences" / "scale_factor_short.yaml", None, {"world.calibrator_gain": "off"})
    assert predicted_of(view, "gls") == predicted(plan).estimates
    assert len(predicted_of(view, "gls")) == len(stated(view))


def test_nothing_is_held_against_a_part_another_method_or_without_a_plan(view: SessionView) -> None:
    assert predicted_of(replace(view, incomplete=True), "gls") == []
    assert predicted_of(view, "regression") == []
    texts = {name: text for name, text in view.texts.items() if not name.startswith("stations/")}
    for without in (replace(view, plan_steps=()), replace(view, texts=texts)):
        assert predicted_of(without, "gls") == []
        assert expectations(without, stated(view)) == {}
    other = {**view.manifest, "campaign": {**view.manifest["campaign"], "analysis": "imu_strapdown"}}
    assert expectations(replace(view, manifest=other), {}) == {}


def test_the_run_begins_when_its_first_event_says(view: SessionView, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bench clock that has counted for seventy days is no run that began seventy days ago."""
    begins: list[float | None] = []

    def noted(plan: Plan, begin_utc_s: float | None) -> Prediction:
        begins.append(begin_utc_s)
        return predicted(plan)

    monkeypatch.setattr("bench.session.view.predicted", noted)
    assert view.utc_offset_ns is not None
    late_ns = 70 * 86400 * NS
    later = [(t_ns + late_ns, event) for t_ns, event in view.events]
    for one in (view, replace(view, utc_offset_ns=view.utc_offset_ns - late_ns, events=later)):
        predicted_of(one, "gls")
    first_ns, _ = view.events[0]
    assert begins == [pytest.approx((view.utc_offset_ns + first_ns) / NS)] * 2
    assert first_ns < 60 * NS


def test_before_the_first_record_and_after_the_last_the_end_is_known(view: SessionView) -> None:
    found = expectations(replace(view, rows=()), {})
    assert len(found) == len(predicted_of(view, "gls"))
    assert all(expected.at_end_U == expected.predicted.expanded_uncertainty for expected in found.values())
    entries = by_foreseen_name(stated(view))
    found = expectations(view, entries)
    for name, entry in entries.items():
        assert found[name].at_end_U == pytest.approx(entry.expanded_uncertainty, rel=1e-12)


def test_after_the_first_temperature_the_end_is_nearer_than_what_is_known_so_far(view: SessionView) -> None:
    part = replace(view, rows=view.rows[:FIRST_TEMPERATURE])
    so_far, end = by_foreseen_name(stated(part)), by_foreseen_name(stated(view))
    found, pairs = expectations(part, so_far), agreements(predicted_of(view, "gls"), end.values())
    told_at_the_end = {name: pair.grown for pair in pairs for name in by_foreseen_name([pair.predicted])}
    ratios = {}
    for name, entry in end.items():
        ratios[name] = entry.expanded_uncertainty / found[name].at_end_U
        if not 0.999 < ratios[name] < CLOSE:
            assert told_at_the_end[name] in (SENSOR, DRIFT, STEADY), "nothing else could not be known"
    near = [ratio for ratio in ratios.values() if ratio < CLOSE]
    assert len(near) > 20
    dsf_n = next(name for name in so_far if name[0] == "dsf_n")
    assert found[dsf_n].at_end_U > 1.05 * so_far[dsf_n].expanded_uncertainty, (
        "the drift until the closing repeat is not in it yet"
    )


def test_what_is_doubtful_has_no_expected_uncertainty(view: SessionView) -> None:
    entries = stated(view)
    entries[0] = entries[0].model_copy(update={"expanded_uncertainty": None})
    named = by_foreseen_name(entries)
    doubtful, sound = list(named)[:2]
    found = expectations(view, named)
    assert found[doubtful].at_end_U is None
    assert found[sound].at_end_U is not None


MAIN = analyses()["scale_factor"][0].main


@pytest.fixture(scope="module")
def short_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_short(tmp_path_factory.mktemp("partial"))[0].folder


def test_a_finished_session_gives_its_main_estimates(short_session: Path) -> None:
    found = command.partial(short_session)
    full = {
        (one.quantity, one.conditions["channel"], one.conditions["temperature_degC"]): one.value
        for one in analyse(material_of(read_view(short_session))).estimates
        if one.quantity in MAIN
    }
    assert found["records"] > 0
    assert {row["quantity"] for row in found["rows"]} >= {"dsf_n", "dsf_p"}
    assert next(row["titles"]["en"] for row in found["rows"] if row["quantity"] == "dsf_n") == "Scale-factor error N"
    for row in found["rows"]:
        assert set(row) == {*command.KEYS, "titles", "predicted_uncertainty", "expected_uncertainty"}
        assert row["expected_uncertainty"] == pytest.approx(row["expanded_uncertainty"], rel=1e-12), "nothing comes"
        assert "unit_temperature_degC" not in row["conditions"], "what is measured does not name an estimate"
        key = (row["quantity"], row["conditions"]["channel"], row["conditions"]["temperature_degC"])
        assert row["value"] == full.pop(key)
    assert full == {}


def test_a_session_that_has_just_begun_says_what_is_expected_and_why_nothing_is_determined(
    short_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "nice", lambda step: 0)
    shutil.copy(short_session / "session.0001.mcap", tmp_path)
    content = (tmp_path / "session.0001.mcap").read_bytes()
    (tmp_path / "session.0001.mcap").write_bytes(content[: len(content) // 4])
    assert command.main([str(tmp_path)]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["why"] != ""
    whole = predicted(short_plan()).estimates
    assert len(said["rows"]) == len([entry for entry in whole if entry.quantity in MAIN])
    for row in said["rows"]:
        assert (row["value"], row["expanded_uncertainty"], row["quality"]) == (None, None, None)
        assert row["expected_uncertainty"] == row["predicted_uncertainty"] > 0.0


@pytest.mark.parametrize(
    ("analysis", "last"),
    [
        ("scale_factor", ("invalid", "without a unit temperature")),
        ("dmm_method", ("invalid", "without a unit temperature")),
        ("bias_ramp", ("valid", "")),
    ],
)
def test_a_record_whose_temperature_is_not_known_is_to_be_taken_again(analysis: str, last: tuple[str, str]) -> None:
    assert states(analysis) == [*[("valid", "")] * 3, last]


KNOWN = Splice(2 * NS, None, None, 5.0, 3, "crash", None, None, False)
UNKNOWN = replace(KNOWN, at_ns=6 * NS, away_s=None, step=8, placed=False)
AIR = Environment(air_degC=20.0, unit_degC=21.0)


def away_row(number: int, start_s: float) -> RecordRow:
    window = RecordWindow(number, "port_a", 100 * number, 100, round(start_s * NS), round((start_s + 1) * NS))
    return RecordRow(window, {"npp": np.array([3, 0])}, 100, 0, 0, Quality.GOOD)


def found_analysis(*values: float, evidence: list[Evidence] | None = None, expanded: float = 2.0) -> Analysis:
    entries = [
        estimate(name, "1", value, expanded / 2.0, {"channel": 1}, n=9, factor=2.0)
        for name, value in zip(("dsf", "drift"), values, strict=False)
    ]
    return Analysis("any", "wls", {}, entries, evidence or [])


def of_quality(analysis: Analysis) -> list[bool]:
    """Whether each estimate is sound."""
    against = weigh(analysis.evidence).against
    return [not any(check.bears_on(entry) for check in against) for entry in analysis.estimates]


def test_only_what_lies_behind_a_splice_of_unknown_length_is_placed_later() -> None:
    rows = [away_row(1, 0.0), away_row(2, 3.0), away_row(3, 7.0), away_row(4, 8.0)]
    events = [(NS, AIR), (2 * NS, Resume(reason="x")), (6 * NS, AIR), (6 * NS, Resume(reason="x")), (7 * NS, AIR)]
    later_rows, later = placed_later(rows, events, [KNOWN, UNKNOWN], 3600.0)
    assert [one.window.t_start_ns / NS for one in later_rows] == [0.0, 3.0, 3607.0, 3608.0]
    assert [t_ns / NS for t_ns, _ in later] == [1.0, 2.0, 6.0, 3606.0, 3607.0]
    counters = [one.window.first_counter for one in later_rows]
    assert counters[2] - counters[1] == pytest.approx(100 * 3604, rel=0.01), "frames that would have come meanwhile"
    assert counters[3] - counters[2] == 100


def test_an_estimate_that_depends_on_the_time_away_is_doubtful_and_no_other() -> None:
    analysis = doubted(found_analysis(1.0, 5.0), [found_analysis(1.0, 5.0), found_analysis(1.1, 9.0)], [KNOWN, UNKNOWN])
    assert of_quality(analysis) == [True, False]
    (against,) = weigh(analysis.evidence).against
    assert (against.code, against.figure) == ("unknown_time_away", 2.0)
    assert "step 8 " in against.sentence
    assert "1 of 2 estimates" in analysis.notes[-1]


@pytest.mark.parametrize(
    "other",
    [
        None,  # cannot be made at all
        found_analysis(1.0),  # an estimate less
        found_analysis(1.0, 5.0, expanded=3.0),
        found_analysis(1.0, math.nan),
        found_analysis(1.0, 5.0, evidence=[Evidence("bent", "bent", None, 0.0, quantities=("drift",))]),
    ],
)
def test_whatever_is_otherwise_with_a_longer_time_away_counts(other: Analysis | None) -> None:
    assert not of_quality(doubted(found_analysis(1.0, 5.0), [other], [UNKNOWN]))[1]


def test_numbers_that_are_not_known_either_way_are_the_same() -> None:
    assert of_quality(doubted(found_analysis(1.0, math.nan), [found_analysis(1.0, math.nan)], [UNKNOWN])) == [
        True,
        True,
    ]
    exact = found_analysis(1.0, 5.0, expanded=0.0)
    assert of_quality(doubted(exact, [exact], [UNKNOWN])) == [True, True]
    assert of_quality(doubted(exact, [found_analysis(1.0, 5.1, expanded=0.0)], [UNKNOWN])) == [True, False]


COUNTS = {name: np.array([50_000]) for name in ("npp", "ppp", "af_clock", "master_count")}


def state_row(number: int, temperature_degC: float | None) -> Any:
    conditions = {"channel": 1, "temperature_degC": 23.0}
    window = SimpleNamespace(
        number=number, step=number, link="port_a", frames=50, conditions=conditions,
        t_start_ns=number * 10**9, t_end_ns=number * 10**9 + 5 * 10**8,
    )  # fmt: skip
    context = {} if temperature_degC is None else {UNIT_TEMPERATURE: temperature_degC}
    quality = int(Quality.STALE) if temperature_degC is None else 0
    return SimpleNamespace(window=window, sums=COUNTS, frames=50, lost=0, quality=quality, context=context)


def states(analysis: str) -> list[tuple[str, str]]:
    """Of three records: one measured, one between two that are, one behind the last that is."""
    rows = [state_row(1, 23.0), state_row(2, None), state_row(3, 23.0), state_row(4, None)]
    steps = [planned("record", number) for number in (1, 2, 3, 4)]
    manifest = {"campaign": {"analysis": analysis}}
    replayed: Any = SimpleNamespace(manifest=manifest, rows=rows, measurement_rows=rows, events=[], damage=())
    return [(one.state, one.why) for one in record_states(steps, replayed)]


def sampled(number: int, **more: Any) -> Any:
    conditions = {"item": "position"}
    window = SimpleNamespace(number=number, step=number, link="rs422", frames=200, conditions=conditions)
    fields = {"window": window, "sums": {}, "frames": 199, "lost": 1, "quality": 0, "context": {}} | more
    return SimpleNamespace(**fields)


def test_a_record_of_samples_needs_no_clock_counts() -> None:
    """Its frames and flags count; a lost sample is seen from the counter and is no reason to leave the record out."""
    rows = [sampled(1), sampled(2, frames=0, lost=200), sampled(3, quality=int(Quality.OVERLOAD))]
    steps = [planned("record", number, samples=True) for number in (1, 2, 3)]
    manifest = {"campaign": {"analysis": "imu_calibration"}}
    replayed: Any = SimpleNamespace(manifest=manifest, rows=rows, measurement_rows=rows, events=[], damage=())
    found = record_states(steps, replayed)
    assert [one.state for one in found] == ["valid", "invalid", "invalid"]
    assert found[1].why == "no frames"
    with pytest.raises(InputError, match=r"B-RES-008: .*how it was mounted"):
        make_up_sequence(SimpleNamespace(steps=steps, station=SimpleNamespace(instruments={})), found)  # type: ignore[arg-type]


@pytest.mark.parametrize("arguments", [None, {"samples": True}])
def test_what_is_not_made_up_one_by_one_is_not_completed(arguments: dict[str, Any] | None) -> None:
    """Unit tests, which have no records, and records of samples: another session completes neither."""
    step = planned("record", 1, **(arguments or {}))
    view: Any = SimpleNamespace(plan_steps=[] if arguments is None else [step], manifest={"session": "first"})
    with pytest.raises(InputError, match="made up one by one") as caught:
        merged(view, [])
    assert (caught.value.code, caught.value.where) == ("B-RES-010", "first")


BOOT_S = 16_000  # the bench clock begins with the machine, not with the run
E = TypeVar("E", bound=Event)
START_ns = 7 * NS


@dataclass
class Session:
    events: list[tuple[int, Event]]

    def events_of(self, model: type[E]) -> list[tuple[int, E]]:
        return [(t_ns, event) for t_ns, event in self.events if isinstance(event, model)]


def ran(*events: tuple[str, int, Mapping[str, Any]]) -> Session:
    phases = (("phase", BOOT_S, {"name": "prepare"}), ("phase", BOOT_S + 9, {"name": "campaign"}))
    return Session([(t_s * NS, event_of(kind, fields)) for kind, t_s, fields in (*phases, *events)])


EVENTS: dict[str, tuple[dict[str, Any], str]] = {
    "late": ({"step": 7, "policy": "hold", "last_degC": 23.0, "slope_degC_min": -3.4421}, "-3.442 degC/min: hold"),
    "overrun": ({"seconds": 0.3041, "step": 38}, "step 38: began 0.3 s late, what was before it took longer"),
    "alarm": ({"what": "hold", "step": 3, "seconds": 600.2, "reasons": {"link port_a": "no good frame"}}, "holding"),
    "link": ({"link": "port_a", "state": "lost", "reason": "the port was hung up"}, "link port_a is lost: the port"),
    "guard": ({"state": "withheld", "parts": ["sequencer", "links"]}, "no sign of life of sequencer, links"),
}


@pytest.mark.parametrize("kind", EVENTS)
def test_each_kind_is_a_sentence_at_the_time_since_the_run_began(kind: str) -> None:
    fields, words = EVENTS[kind]
    (line,) = happenings(ran((kind, BOOT_S + 3661, fields)))
    assert line.startswith(f"{kind} at 1:01:01: ")
    assert words in line
    assert "[" not in line


def test_the_table_of_the_report_is_in_order_of_time() -> None:
    (table,) = happening_tables(
        ran(("link", BOOT_S + 5, {"state": "x"}), ("late", BOOT_S + 4, {"state": "y"}), ("link", 0, {"state": "open"}))
    )
    assert table.prose is True
    assert [row[:2] for row in table.rows] == [["0:00:04", "late"], ["0:00:05", "link"]]


def told(*events: tuple[str, float, dict[str, Any]]) -> Session:
    phase = (START_ns, Phase(name="prepare", t_start_ns=0))
    return Session([phase, *((START_ns + round(at_s * NS), event_of(kind, fields)) for kind, at_s, fields in events)])


def test_commands_say_when_what_who_why_and_what_else() -> None:
    view = told(
        ("control", 60.0, {"what": "pause", "by": "A, operator, 10.0.0.7", "reason": "lunch"}),
        ("control", 3661.0, {"what": "acknowledge", "by": "B", "reason": "", "alarm": "lab_air"}),
    )
    assert commands_given(view) == [
        {"time": "0:01:00", "what": "pause", "by": "A, operator, 10.0.0.7", "reason": "lunch"},
        {"time": "1:01:01", "what": "acknowledge", "by": "B", "reason": "–", "alarm": "lab_air"},
    ]


def test_alarms_and_interlocks_in_order_of_time_and_nothing_else() -> None:
    trip = {
        "name": "unit_hot", "signal": "unit_temperature", "of": "", "state": "tripped", "value": 61.0, "unit": "degC",
        "limit": 60.0, "action": "abort",
    }  # fmt: skip
    held = {"what": "hold", "step": 4, "seconds": 600.0, "reasons": {"operator": "lunch"}}
    view = told(
        ("interlock", 90.0, trip), ("alarm", 30.0, held), ("control", 10.0, {"what": "pause", "by": "A", "reason": "r"})
    )
    found = alarms_raised(view)
    assert [(one["time"], one["what"]) for one in found] == [("0:00:30", "alarm"), ("0:01:30", "interlock")]
    assert found[1]["text"] == "interlock unit_hot: unit_temperature is 61 degC, limit 60 degC: abort"


def test_length_is_from_the_first_phase_to_the_end() -> None:
    assert length_s(told(("end", 99.5, {}))) == pytest.approx(99.5)
    assert math.isnan(length_s(told()))
    assert math.isnan(length_s(Session([(1, event_of("end", {}))])))


def test_the_station_says_which_channel_is_the_room() -> None:
    scans = [
        ("surroundings", at, {"role": "logger", "degC": {"101": 23.0 + at / 1e4, "103": 50.0}}) for at in (0.0, 1500.0)
    ]
    path = find_shipped("stations", "af_bench_sim")
    view, text = told(*scans), path.read_text(encoding="utf-8")
    room, unit = surroundings(view, {"stations/af_bench_sim.yaml": text}, START_ns + 600 * NS)
    assert (room.name, room.laboratory, unit.name, unit.laboratory) == ("logger 101", True, "logger 103", False)
    assert room.t_s.tolist() == [-600.0, 900.0]
    assert room.degC.tolist() == pytest.approx([23.0, 23.15])
    unknown = surroundings(view, {"stations/other.yaml": "no: station\n"}, 0)
    assert [one.laboratory for one in unknown] == [False, False]
