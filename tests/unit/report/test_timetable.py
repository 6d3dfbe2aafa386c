"""The timetable: bars, planned temperature, thinning of the trace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plan_sample import planned
from report_sample import SamplePlan, sample_steps

from bench.model.shipped import find_shipped
from bench.plan import Step, compile_sequence, planned_temperature
from bench.report.plots import plot_timetable
from bench.report.plots.figures import thin
from bench.report.timetable import timetable


def test_bars_cover_exactly_the_planned_time() -> None:
    table = timetable(sample_steps(), prepare_s=600.0)
    assert sum(bar.duration_s for bar in table.bars if bar.kind not in {"prepare", "finally"}) == 136_800.0
    assert table.lanes == ("prepare", "soak", *(f"channel {n}" for n in range(1, 11)), "finally")
    repeat = [bar for bar in table.bars if bar.kind == "repeat"]
    assert [(bar.lane, bar.start_s, bar.duration_s) for bar in repeat] == [("channel 1", 135_000.0, 1800.0)]
    assert len(table.bars) == 1 + 5 + 50 + 1 + 1


def test_planned_temperature_ramps_then_holds() -> None:
    t_s, degC = planned_temperature(sample_steps((-10.0, 5.0)), 600.0, start_degC=23.0)
    assert np.interp([0.0, 1980.0, 3960.0, 27_000.0, 27_900.0, 28_800.0], t_s, degC).tolist() == [
        23.0,
        6.5,
        -10.0,
        -10.0,
        -2.5,
        5.0,
    ]
    assert (t_s[0], t_s[-1]) == (0.0, 2 * (9000.0 + 18_000.0) + 1800.0 + 60.0)


def chamber(at_s: float, name: str, temperature: float = 0.0, ramp: float = 0.0) -> Step:
    arguments = {"temperature": temperature, "ramp": ramp} if name == "set_temperature" else {}
    return planned("call", at_s=at_s, role="chamber", name=name, **arguments)


def record(at_s: float, seconds: float) -> Step:
    return planned("record", at_s=at_s, duration_s=seconds)


def corners(*steps: Step, prepare_s: float = 0.0) -> list[tuple[float, float]]:
    t_s, degC = planned_temperature(steps, prepare_s, start_degC=23.0)
    return list(zip(t_s.tolist(), degC.tolist(), strict=True))


def test_commands_to_the_chamber_are_planned_like_soaks_in_every_phase() -> None:
    asked = {"temperature": 3.0, "ramp": 1.0}
    found = corners(
        planned("soak", phase="prepare", at_s=10.0, duration_s=1800.0, **asked),
        record(0.0, 600.0),
        chamber(600.0, "set_temperature", 13.0, 0.5),
        chamber(600.0, "run"),
        record(600.0, 1800.0),
        planned("soak", phase="finally", duration_s=900.0, temperature=23.0, ramp=1.0),
        prepare_s=1810.0,
    )
    assert found == [
        (-1800.0, 23.0), (-600.0, 3.0), (600.0, 3.0), (1800.0, 13.0), (2400.0, 13.0), (3000.0, 23.0), (3300.0, 23.0)
    ]  # fmt: skip


def test_a_set_point_counts_from_run_on_and_a_new_one_at_once() -> None:
    asked = chamber(0.0, "set_temperature", 43.0, 1.0)
    assert corners(asked, record(0.0, 60.0)) == []
    on_the_way = (asked, chamber(60.0, "run"), chamber(660.0, "set_temperature", 23.0, 2.0), record(660.0, 600.0))
    assert corners(*on_the_way) == [(60.0, 23.0), (660.0, 33.0), (960.0, 23.0), (1260.0, 23.0)]


def test_the_ramp_stands_still_on_hold_and_ends_with_stop() -> None:
    begun = (chamber(0.0, "set_temperature", 43.0, 1.0), chamber(0.0, "run"), chamber(300.0, "hold"))
    assert corners(*begun, record(300.0, 60.0)) == [(0.0, 23.0), (300.0, 28.0), (360.0, 28.0)]
    assert corners(*begun, chamber(600.0, "run"), record(600.0, 1200.0))[2:] == [
        (600.0, 28.0), (1500.0, 43.0), (1800.0, 43.0)
    ]  # fmt: skip
    stopped = corners(*begun, chamber(600.0, "stop"), record(600.0, 100.0))
    assert stopped[:-1] == [(0.0, 23.0), (300.0, 28.0), (600.0, 28.0)]
    assert stopped[-1][0] == 600.0
    assert np.isnan(stopped[-1][1])


def test_shipped_bias_ramp_is_planned_from_the_room_to_both_ends_and_back() -> None:
    plan = compile_sequence(find_shipped("sequences", "bias_ramp_25h"))
    found = corners(*plan.steps, prepare_s=plan.prepare_s)
    assert found[0] == (-10_800.0, 23.0)
    assert found[-1] == (97_800.0, 23.0)
    hours = [(t_s / 3600.0, degC) for t_s, degC in found[2:-2]]
    assert hours == [(2.0, -10.0), (12.0, 50.0), (13.0, 50.0), (23.0, -10.0), (25.0, -10.0)]


def test_thinning_keeps_extremes_and_drops_missing_readings() -> None:
    rng = np.random.default_rng(11)
    t_s = np.arange(20_000.0)
    value = rng.normal(20.0, 0.1, t_s.size)
    value[12_345], value[777], value[5:50] = 99.0, -99.0, np.nan
    thin_t_s, thin_value = thin(t_s, value, most=200)
    assert thin_t_s.size <= 200
    assert (thin_value.max(), thin_value.min()) == (99.0, -99.0)
    assert np.all(np.diff(thin_t_s) > 0)
    assert np.array_equal(value[thin_t_s.astype(int)], thin_value)
    assert thin(t_s, np.empty(0))[0].size == 0


def test_same_plan_same_svg(tmp_path: Path) -> None:
    plan = SamplePlan("Scale factor", sample_steps(), 600.0)
    for name in ("a.svg", "b.svg"):
        plot_timetable(plan, tmp_path / name)
    text = (tmp_path / "a.svg").read_text(encoding="utf-8")
    assert text == (tmp_path / "b.svg").read_text(encoding="utf-8")
    assert "Temperature / °C" in text
    assert "Time from hour 0 / h" in text
    assert "<dc:date>" not in text
