"""Short campaigns end to end: the bias ramp, and the DMM method with zeros in every range."""

import sys
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from rehearsal import rehearsed
from units_campaign import cut

from bench.analysis import Material
from bench.commands.run import view_of
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.plan import Plan, check_plan, compile_sequence
from bench.replay import replay_rows
from bench.replay.rows import Replayed
from bench.session.predicted import predicted
from bench.session.view import KEPT_EVENTS, material_of
from bench.systems.af_converter.dmm_method import analysis as dmm_method

KEYS = ("moment1", "moment2", "first", "last", "at_first", "at_last")


@pytest.fixture(scope="module")
def replayed(ramp: Path) -> Replayed:
    """The records of a finished run of the short campaign."""
    return replay_rows(ramp, strict=True)


def contiguous(windows: Iterable[RecordWindow]) -> bool:
    return all(
        after.first_counter == before.first_counter + before.frames and after.t_start_ns == before.t_end_ns
        for before, after in pairwise(windows)
    )


def test_all_windows_are_there_one_behind_the_other_and_nothing_is_lost(replayed: Replayed) -> None:
    rows = replayed.measurement_rows
    assert len(rows) == 540
    assert {(row.frames, row.lost, int(row.quality)) for row in rows} == {(2000, 0, 0)}
    assert (replayed.totals["frames_bad"], replayed.totals["frames_lost"]) == (0, 0)
    kinds = {event.kind for _, event in replayed.events}
    assert not kinds & {"gap", "slip", "late", "overrun", "retake", "error"}
    assert contiguous(row.window for row in rows)
    assert (rows[-1].window.t_end_ns - rows[0].window.t_start_ns) / NS == pytest.approx(10_800.0, abs=0.5)


def test_the_timing_of_each_window_agrees_with_its_sums(replayed: Replayed) -> None:
    """Cauchy's inequality and the ends bound the moments, whatever the pulses are."""
    for row in replayed.measurement_rows:
        for name in ("npp", "ppp"):
            assert {f"{name}.{key}" for key in KEYS} < set(row.timing)
            total, (m1, m2, first, last, at_first, at_last) = row.sums[name], (row.timing[f"{name}.{k}"] for k in KEYS)
            some = total > 0
            assert ((first >= 0) == some).all()
            assert ((last >= 0) == some).all()
            j1, j2 = first - row.window.first_counter + 1, last - row.window.first_counter + 1
            assert ((j1 >= 1) & (j1 <= j2) & (j2 <= 2000))[some].all()
            assert ((j1 * total <= m1) & (m1 <= j2 * total))[some].all()
            assert (m1.astype(object) ** 2 <= total.astype(object) * m2.astype(object)).all()
            assert ((at_first >= some) & (at_first + at_last * (first != last) <= total)).all()


SEED = 1
CUTS = (
    ("sequence: dmm_method", "sequence: tiny"),
    ("duration: 32050 s\nrecords: 170", "duration: 13690 s\nrecords: 34"),
    ("numbers: 1-6, kind: gyro", "numbers: 1, kind: gyro"),
    ("numbers: 7-10, kind", "numbers: 7, kind"),
)


def tiny(folder: Path, name: str = "dmm_method", cuts: tuple[tuple[str, str], ...] = CUTS) -> Plan:
    """Return a shipped sequence cut down, without mistakes."""
    path = folder / "tiny.yaml"
    path.write_text(cut(name, list(cuts)))
    plan = compile_sequence(path, None, {})
    assert check_plan(plan) == []
    return plan


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Material, list[dict[str, Any]]]:
    folder = tmp_path_factory.mktemp("dmm")
    plan = tiny(folder)
    done = rehearsed(folder, plan, seed=SEED, kept=KEPT_EVENTS).run
    assert done.outcome.error is None
    assert (done.outcome.overruns, done.outcome.slip_s, len(done.outcome.rows)) == (0, 0.0, 34)
    return material_of(view_of(plan, done)), list(done.truth or ())


@pytest.mark.slow
def test_agrees_with_truth_and_with_the_calibrator_method(session: tuple[Material, list[dict[str, Any]]]) -> None:
    """Assumption 2 holds: leakage of the simulated switch is below 0.1 nA, nothing shifts, each range has its zero."""
    given, truth = session
    analysis = dmm_method.analyse(given)
    true = {(one["quantity"], one["conditions"].get("channel")): one["value"] for one in truth}
    judged = [one for one in analysis.estimates if one.quantity.startswith("dsf_") and "mean" not in one.quantity]
    assert len(judged) == 6
    for one in judged:
        error = one.value - true[one.quantity, one.conditions["channel"]]
        sys.stdout.write(f"{one.conditions['channel']} {one.quantity}: error {error:.2f} ppm\n")
        assert abs(error) < 1.3 * one.expanded_uncertainty
        assert (one.n, one.dropped) == (14, 0)
    tables = {table.title: table.rows for table in analysis.tables}
    (agreement,) = (rows for title, rows in tables.items() if "calibrator method" in title)
    assert all(abs(row[7]) < 1.0 for row in agreement)
    assert [row[0] for row in tables["Zeros of the meter"]] == pytest.approx([0.1, 1.0, 10.0, 100.0, 1000.0])
    assert analysis.missing == []
    assert [one.verdict for one in analysis.estimates if one.quantity == "repeat_shift"] == ["pass"] * 4
    assert len([one for one in analysis.estimates if one.quantity == "switch_leakage"]) == 4
    assert len([note for note in analysis.notes if "no more than chance" in note]) == 2


def test_what_is_predicted_is_what_the_campaign_states(
    session: tuple[Material, list[dict[str, Any]]], tmp_path: Path
) -> None:
    def by_place(estimates: list[Any]) -> dict[tuple[Any, ...], float]:
        found = {}
        for entry in estimates:
            where = (pair for pair in entry.conditions.items() if pair[0] != "unit_temperature_degC")
            found[entry.quantity, *where] = entry.std_uncertainty
        return found

    before, after = by_place(predicted(tiny(tmp_path)).estimates), by_place(dmm_method.analyse(session[0]).estimates)
    ratios = [before[where] / stated for where, stated in after.items()]
    sys.stdout.write(f"predicted over stated: {min(ratios):.4f} to {max(ratios):.4f}\n")
    assert before == pytest.approx(after, rel=0.01)
