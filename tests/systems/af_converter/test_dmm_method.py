"""The DMM method on the simulated bench: its own sequence, shortened to two channels, through instruments and links."""

import sys
from pathlib import Path
from typing import Any

import pytest
from rehearsal import nobody
from units_campaign import cut

from bench.analysis import Material
from bench.commands.run import view_of
from bench.model.clock import VirtualClock
from bench.plan import Plan, check_plan, compile_sequence
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from bench.session.predicted import predicted
from bench.session.view import KEPT_EVENTS, material_of
from bench.systems.af_converter.dmm_method import analysis as dmm_method

SEED = 1
CUTS = (
    ("sequence: dmm_method", "sequence: dmm_tiny"),
    ("duration: 32050 s\nrecords: 170", "duration: 13690 s\nrecords: 34"),
    ("numbers: 1-6, kind: gyro", "numbers: 1, kind: gyro"),
    ("numbers: 7-10, kind", "numbers: 7, kind"),
)


def tiny(folder: Path) -> Plan:
    path = folder / "dmm_tiny.yaml"
    path.write_text(cut("dmm_method", list(CUTS)))
    return compile_sequence(path, None, {})


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Material, list[dict[str, Any]]]:
    folder = tmp_path_factory.mktemp("dmm")
    plan = tiny(folder)
    assert check_plan(plan) == []
    done = conduct(
        plan, clock=VirtualClock(), seed=SEED, out=folder, operator=SimulatedOperator(), listener=nobody(),
        keep_events=KEPT_EVENTS,
    )  # fmt: skip
    assert done.outcome.error is None
    assert (done.outcome.overruns, done.outcome.slip_s, len(done.outcome.rows)) == (0, 0.0, 34)
    return material_of(view_of(plan, done)), list(done.truth or ())


def test_the_whole_sequence_compiles_to_what_it_says() -> None:
    plan = compile_sequence("dmm_method", None, {})
    assert check_plan(plan) == []
    campaign = plan.phase("campaign")
    assert campaign[-1].at_s + campaign[-1].duration_s == 32_050.0
    assert plan.record_count == 170


@pytest.mark.slow
def test_agrees_with_truth_and_with_the_calibrator_method(session: tuple[Material, list[dict[str, Any]]]) -> None:
    """Assumption 2 holds: leakage of the simulated switch is below 0.1 nA, nothing shifts, each range has its zero."""
    given, truth = session
    analysis = dmm_method.analyse(given)
    true = {(one["quantity"], one["conditions"].get("channel")): one["value"] for one in truth}
    judged = [one for one in analysis.estimates if one["quantity"].startswith("dsf_") and "mean" not in one["quantity"]]
    assert len(judged) == 6
    for one in judged:
        error = one["value"] - true[one["quantity"], one["conditions"]["channel"]]
        sys.stdout.write(f"{one['conditions']['channel']} {one['quantity']}: error {error:.2f} ppm\n")
        assert abs(error) < 1.3 * one["expanded_uncertainty"]
        assert (one["n"], one["dropped"]) == (14, 0)
    tables = {table.title: table.rows for table in analysis.tables}
    (agreement,) = (rows for title, rows in tables.items() if "calibrator method" in title)
    assert all(abs(row[7]) < 1.0 for row in agreement)
    assert [row[0] for row in tables["Zeros of the meter"]] == pytest.approx([0.1, 1.0, 10.0, 100.0, 1000.0])
    assert analysis.missing == []
    assert [one["verdict"] for one in analysis.estimates if one["quantity"] == "repeat_shift"] == ["pass"] * 4
    assert len([one for one in analysis.estimates if one["quantity"] == "switch_leakage"]) == 4
    assert len([note for note in analysis.notes if "no more than chance" in note]) == 2


def test_what_is_predicted_is_what_the_campaign_states(
    session: tuple[Material, list[dict[str, Any]]], tmp_path: Path
) -> None:
    def by_place(estimates: list[Any]) -> dict[tuple[Any, ...], float]:
        found = {}
        for entry in estimates:
            where = (pair for pair in entry["conditions"].items() if pair[0] != "unit_temperature_degC")
            found[entry["quantity"], *where] = entry["std_uncertainty"]
        return found

    before, after = by_place(predicted(tiny(tmp_path)).estimates), by_place(dmm_method.analyse(session[0]).estimates)
    ratios = [before[where] / stated for where, stated in after.items()]
    sys.stdout.write(f"predicted over stated: {min(ratios):.4f} to {max(ratios):.4f}\n")
    assert before == pytest.approx(after, rel=0.01)
