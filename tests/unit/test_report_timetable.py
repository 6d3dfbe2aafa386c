"""The timetable: bars, planned temperature, thinning of the trace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from report_sample import SamplePlan, SampleStep, sample_steps

from bench.report import TemperatureTrace, plot_timetable
from bench.report.figures import thin, timetable_picture
from bench.report.timetable import planned_temperature, timetable


def test_bars_cover_exactly_the_planned_time() -> None:
    table = timetable(sample_steps(), prepare_s=600.0)
    assert sum(bar.duration_s for bar in table.bars if bar.kind not in {"prepare", "finally"}) == 136_800.0
    assert table.lanes == ("prepare", "soak", *(f"channel {n}" for n in range(1, 11)), "finally")
    repeat = [bar for bar in table.bars if bar.kind == "repeat"]
    assert [(bar.lane, bar.start_s, bar.duration_s) for bar in repeat] == [("channel 1", 135_000.0, 1800.0)]
    assert len(table.bars) == 1 + 5 + 50 + 1 + 1


def test_preparation_lies_before_hour_0_and_the_end_after_the_campaign() -> None:
    bars = timetable(sample_steps(), prepare_s=600.0).bars
    assert (bars[0].start_s, bars[0].duration_s) == (-600.0, 600.0)
    assert (bars[-1].start_s, bars[-1].duration_s) == (136_800.0, 60.0)


def test_planned_temperature_ramps_then_holds() -> None:
    t_s, degC = planned_temperature(sample_steps((-10.0, 5.0)), start_degC=23.0)
    assert np.interp([0.0, 1980.0, 3960.0, 27_000.0, 27_900.0, 28_800.0], t_s, degC).tolist() == [
        23.0,
        6.5,
        -10.0,
        -10.0,
        -2.5,
        5.0,
    ]
    assert t_s[-1] == 2 * (9000.0 + 18_000.0) + 1800.0


def test_plan_without_soak_or_channels_has_lanes_by_kind() -> None:
    steps = (SampleStep("campaign", "settle", 0.0, 20.0), SampleStep("campaign", "record", 20.0, 100.0))
    table = timetable(steps, prepare_s=0.0)
    assert table.lanes == ("settle", "record")
    picture = timetable_picture(table, TemperatureTrace())
    assert picture is not None
    assert "Temperature" not in picture.svg
    assert "Time from hour 0 / min" in picture.svg


def test_nothing_planned_nothing_drawn() -> None:
    assert timetable_picture(timetable((), prepare_s=0.0), TemperatureTrace()) is None


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
