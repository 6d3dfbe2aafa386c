"""Ring lasers from blocks to results, and each number that a reader sees against its own definition."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from doubt_lock_in import simulated, wrong
from laser_physics import World
from one_estimate import every, one, value
from rlg_rig import SITE, as_row, material, without
from scipy import stats
from spoken import english_left

from bench.maths.allan_terms import NoiseTerm
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.systems.lock_in import result as laser_results
from bench.systems.lock_in.analysis import analyse, tables
from bench.systems.lock_in.compensation import COMPENSATORS, Compensated, Shown
from bench.systems.lock_in.estimators.random_walk import RandomWalk
from bench.systems.lock_in.figures import campaign_figures
from bench.systems.lock_in.records import LaserRecord, laser_records

SEED, SECONDS = 704, 3.2
SLOW_HZ, FAST_HZ = 20_000_000, 100_000_000
LIMIT = {"alignment_time": {"value": 60.0, "unit": "s"}}
GAIN = np.pi * 0.28 / (2.0 * 632.8e-9)  # of 28 cm, rad/rad
NOTHING = np.empty(0)
JUDGED = "global_constants"


def row_of(path_m: float, clock_Hz: int, number: int = 1, of: type[World] = World, **about: Any) -> Any:
    """A record of a laser that is as good as the one of 28 cm; ``of``: what is not so in its world."""
    wider = (0.28 / path_m) ** 2
    asked = {"lock_in_deg_s": 0.05 * wider, "quantum_deg_rth": 1.15e-4 * wider, "beta_deg": 90.0, "seconds": SECONDS}
    world = of(path_m=path_m, clock_Hz=clock_Hz, **asked | about)
    (row,) = simulated(SEED + number, world).material.rows
    return replace(row, window=replace(row.window, number=number))


@pytest.fixture(scope="module")
def rows() -> list[Any]:
    places = [(path_m, clock_Hz) for path_m in (0.15, 0.28) for clock_Hz in (SLOW_HZ, FAST_HZ)]
    return [row_of(*place, number) for number, place in enumerate(places, 1)]


@pytest.fixture(scope="module")
def whole(rows: list[Any]) -> Any:
    return analyse(material(*rows, limits=LIMIT))


def test_uncertainty_of_large_lock_in_counts_what_the_fit_neglects() -> None:
    """Jumps of 0.14 rad: the lock-in rate is off by 0.2 %, ten times what the scatter of the turnarounds says."""
    rate = one(analyse(material(row_of(0.15, FAST_HZ, lock_in_deg_s=0.35, seconds=1.6))), "lock_in_rate")
    assert abs(rate.value - 0.35) < 2.5 * rate.std_uncertainty
    assert rate.std_uncertainty < 0.005 * 0.35


def test_only_the_method_asked_for_is_judged(whole: Any, rows: list[Any]) -> None:
    judged = {entry.conditions["method"] for entry in whole.estimates if entry.verdict != "none"}
    assert judged == {JUDGED}
    assert {entry.verdict for entry in whole.estimates if entry.limit is not None} == {"pass"}
    other = analyse(material(rows[1], limits=LIMIT), "parabolas")  # 15 cm: 4,000 s before compensation
    assert [entry.verdict for entry in other.estimates if entry.limit is not None] == ["fail"]


def test_nothing_is_said_twice_and_figures_can_be_drawn(whole: Any) -> None:
    places = [(entry.quantity, json.dumps(entry.conditions, sort_keys=True)) for entry in whole.estimates]
    assert len(places) == len(set(places))
    assert all(len(series.x) < 2000 for figure in whole.figures for series in figure.series)
    assert all(np.isfinite(series.y).all() for figure in whole.figures for series in figure.series)
    assert len(whole.tables[3].rows) == 4 * (1 + len(COMPENSATORS))
    assert whole.missing == []
    assert english_left(whole) == set()


def test_gaps_are_not_bridged(rows: list[Any]) -> None:
    """Two blocks lost: three stretches, which is said, and the random walk does not notice."""
    alone, broken = (analyse(material(row)) for row in (rows[3], without(rows[3], 150, 300)))
    (held,) = broken.tables[4].rows
    assert held[7:10] == [3, 2, 0]
    assert len(broken.notes) == len(alone.notes) + 1
    for method in ("raw", *COMPENSATORS):
        before, after = (one(found, "angle_random_walk", method=method) for found in (alone, broken))
        assert after.value == pytest.approx(before.value, abs=4.0 * before.std_uncertainty)


def test_harm_is_said_aloud() -> None:
    """Backscatter phase 20 deg: parabolas make it worse, and the first note and the lead table say so."""
    analysis = analyse(material(row_of(0.28, SLOW_HZ, beta_deg=20.0)))
    assert value(analysis, "random_walk_ratio", method="parabolas") > 1.3
    assert "parabolas, 4 a side makes the gyroscope WORSE" in analysis.notes[0]
    assert "WORSE" in analysis.tables[0].rows[0][-1]
    assert any("Found here: 20 deg" in note for note in analysis.notes)
    assert any("equation that simulated lasers obey" in note for note in analysis.notes)
    assert english_left(analysis) == set()


@pytest.mark.parametrize(
    ("parts", "seconds", "clock_Hz", "said"),
    [
        ({"second_harmonic": 0.2}, 1.6, FAST_HZ, "deg of the phase at the turnaround only"),
        ({"scatter": lambda w, rng, count: np.zeros(count)}, 1.2, SLOW_HZ, "dynamic lock-in"),
        # 10 deg/s: 16 crossings a side in 1 of 13
        (
            {"scatter": lambda w, rng, count: 0.1 * (1.0 + World.scatter(w, rng, count)) - 1.0},
            2.4,
            FAST_HZ,
            "turnarounds could be compensated",
        ),
    ],
)
def test_what_the_model_does_not_have_is_told(
    whole: Any, parts: dict[str, Any], seconds: float, clock_Hz: int, said: str
) -> None:
    analysis = analyse(material(row_of(0.28, clock_Hz, of=wrong(**parts), seconds=seconds)))
    sentences, of_right = ([*each.notes, *(check.sentence for check in each.evidence)] for each in (analysis, whole))
    assert any(said in sentence for sentence in sentences)
    assert not any(said in sentence for sentence in of_right)
    if "second_harmonic" in parts:
        assert float(analysis.tables[2].rows[0][-1]) > 5.0


def test_what_cannot_be_told_from_zero_is_a_limit(rows: list[Any]) -> None:
    """A walk of 0 with an upper limit is no alignment in no time: 95 of 100 such normal walks are in the limit."""
    (record,) = laser_records(material(rows[1]))
    found = laser_results.laser_result(record)
    hidden = replace(found.walks[JUDGED], n_deg_rth=0.0, n_std_deg_rth=math.nan, n_upper_deg_rth=1.645e-3)
    found = replace(found, walks=dict(found.walks) | {JUDGED: hidden})
    comparison, alignment, _, walks, _ = tables([found], laser_results.requirement_of({"site": SITE}), JUDGED)
    limit = 2.776 * 1e-3 / found.walks["raw"].n_deg_rth  # four degrees of freedom
    assert float(comparison.rows[0][3][2:]) == pytest.approx(limit, rel=0.05)
    assert walks.rows[1][3] == "< 2.8"  # four degrees of freedom: k of 2.78, as the estimate has it
    assert [cell.startswith("<") for cell in alignment.rows[0][2:]] == [False, True, True, True]  # the last: by bias
    level_deg = 15.041067 * math.cos(math.radians(37.0)) * math.radians(0.05625)
    assert float(alignment.rows[0][3][2:]) > 3600.0 * (1.645e-3 / level_deg) ** 2
    draws = np.square(np.random.default_rng(1).normal(0.3, 0.2, 100_000))
    assert laser_results.squared(laser_results.Measured(0.3, 0.2)).std == pytest.approx(draws.std(), rel=0.02)


def test_a_combination_without_a_record_and_a_record_without_edges_are_missing(rows: list[Any]) -> None:
    empty = without(rows[0], *range(len(rows[0].samples)))
    analysis = analyse(material(empty, rows[1], rows[3]))
    assert any("record 1" in text and "B-RLG-001" in text for text in analysis.missing)
    missing = set(analyse(material(rows[0], rows[3])).missing)
    assert missing >= {f"path {path} cm with the clock of {MHz} MHz: no record" for path, MHz in ((15, 100), (28, 20))}


def test_flagged_records_are_not_used(rows: list[Any]) -> None:
    tripped = replace(rows[1], quality=Quality.TRIPPED)
    analysis = analyse(material(tripped, replace(rows[3], quality=Quality.LOST)))
    assert "record 2: flagged TRIPPED" in analysis.missing
    assert {entry.conditions.get("path_length_m") for entry in analysis.estimates} == {0.28}
    with pytest.raises(FitError, match=r"B-RLG-008.*TRIPPED"):
        analyse(material(tripped))
    with pytest.raises(FitError, match="B-RLG-001"):
        laser_records(material(replace(rows[0], quality=Quality.RETAKEN)))


def test_requirements_and_those_that_are_none() -> None:
    assert laser_results.requirement_of({"site": SITE}).error_deg == 0.05625  # without a limit one NATO mil
    stated = {"alignment_error": {"value": 0.1, "unit": "deg"}, "alignment_time": {"value": 90.0, "unit": "s"}}
    found = laser_results.requirement_of({"site": SITE, "limits": stated})
    assert (found.error_deg, found.time_s) == (0.1, 90.0)
    for name, limit in (("alignment_eror", 1.0), ("alignment_time", 1.0), ("alignment_error", 0.0)):
        with pytest.raises(FitError, match="B-RLG-004"):
            laser_results.requirement_of({"site": SITE, "limits": {name: {"value": limit, "unit": "deg"}}})
    with pytest.raises(FitError, match="B-RLG-005"):
        laser_results.requirement_of({"site": {"azimuth_deg": 20.0}})


def test_a_session_without_lasers_or_dither_and_wrong_lengths(rows: list[Any]) -> None:
    with pytest.raises(FitError, match=r"B-RLG-001.*path_length_m"):
        laser_records(material())
    for length in ("28 cm", 0.0, True):
        window = replace(rows[0].window, conditions={"path_length_m": length})
        with pytest.raises(FitError, match="B-RLG-006"):
            laser_records(material(replace(rows[0], window=window)))
    blind = wrong(told=lambda w, words, rng: [events[:, events[1] == 0] for events in words])
    with pytest.raises(FitError, match=r"B-RLG-007.*pick-off"):
        analyse(material(row_of(0.28, FAST_HZ, of=blind)))


def walk(n: float, std: float, *, upper: float = np.nan, chi2: float = 5.0, q: float = 1e-6) -> RandomWalk:
    return RandomWalk(n, std, upper, q, q / 10.0, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, chi2, 5)


def constants(kappa: float, kappa_std: float, beta: float, beta_std: float) -> Any:
    jumps = SimpleNamespace(dpsi_rad=np.zeros(3))  # so small that the fit's own shapes are right
    return SimpleNamespace(
        kappa_rad_s=kappa, kappa_std_rad_s=kappa_std, beta_rad=beta, beta_std_rad=beta_std, jumps=jumps
    )


def result(
    walks: dict[str, RandomWalk], fits: Any = (), *, path_m: float = 0.28, clock_Hz: float = 100e6,
    shown: Shown | None = None,
) -> laser_results.LaserResult:  # fmt: skip
    empty = Shown(np.empty((0, 8)), np.empty((0, 8)), {}, NOTHING, NOTHING)
    found = Compensated(2.5e-3, 2.0 * np.pi * 400.0, {}, shown or empty, list(fits), turnarounds=1000)
    found.used = dict.fromkeys(COMPENSATORS, 990)
    found.swing_rad = 2.0 * GAIN * np.deg2rad(100.0) / (2.0 * np.pi * 400.0)  # of 100 deg/s at 400 Hz, peak to peak
    row = as_row({}, np.arange(3), 1, {"path_length_m": path_m})
    events: Any = SimpleNamespace(lost_blocks=0, lost_edges=0, torn=0, dark=0)
    return laser_results.LaserResult(LaserRecord(row, lambda: events, path_m, None), clock_Hz, events, found, walks, {})


BOTH = {"raw": walk(3e-3, 9e-5), JUDGED: walk(6e-4, 3e-5), "parabolas": walk(3.3e-3, 9e-5)}


@pytest.mark.parametrize(("shown", "text"), [(True, "1.48 ± 0.29"), (False, "< 2.4")])
def test_the_alignment_error_by_bias_is_a_value_or_a_limit(shown: bool, text: str) -> None:
    """0.0175 deg/h at 37 deg is 0.0175 / 12.012 rad or 1.48 mil of 360/6400 deg, by hand; limits are no estimates."""
    laser = result(BOTH)
    bias = NoiseTerm("bias_instability", 0.0175, 0.00175, 0.0175, 0.00175, 0.0288, 100.0 * shown)
    laser = replace(laser, biases={"raw": bias, JUDGED: bias})
    requirement = laser_results.Requirement(360.0 / 6400.0, None, 37.0)
    (table,) = (one for one in tables([laser], requirement, JUDGED) if one.title == "Alignment time")
    assert table.rows[0][-1] == text
    found = [one for one in laser_results.record_estimates(laser, requirement, JUDGED) if "bias" in one.quantity]
    assert [one.quantity for one in found] == ["bias_instability", "bias_alignment_error"] * 2 * shown
    assert all(one.value == pytest.approx(0.08348, rel=1e-3) for one in found[1::2])


@pytest.mark.parametrize("shared", [0.0, 0.5, 0.95])
def test_the_ratio_of_outputs_that_scatter_together(shared: float) -> None:
    """Drawn: two walks of 3 and 5 % whose variances are so correlated."""
    rng = np.random.default_rng(8)
    first, other = rng.standard_normal((2, 200_000))
    together = shared * first + np.sqrt(1.0 - shared**2) * other
    drawn = np.std(0.2 * (1.0 + 0.05 * together) / (1.0 + 0.03 * first))
    ratio = replace(result(BOTH), shared={JUDGED: shared}).ratio(JUDGED)
    assert ratio.std == pytest.approx(drawn, rel=0.02)


@pytest.mark.parametrize("dof", [16, 60, 500])
def test_intervals_of_skewed_sizes_hold_what_they_say(dof: int) -> None:
    """Exact quantiles of chi-squared for a variance and its root, of F for ratios of two: 95 %, or a little more."""
    relative = np.sqrt(2.0 / dof)
    two = (stats.chi2(dof, scale=1.0 / dof), relative), (stats.f(dof, dof), np.sqrt(2.0) * relative)
    for variance, std in two:
        for power, least in ((1.0, 0.945), (0.5, 0.92)):
            reach = coverage_factor(laser_results.size_dof(1.0, power * std)) * power * std
            low, high = (1.0 + reach) ** (-1.0 / power), max(1.0 - reach, 1e-9) ** (-1.0 / power)
            assert least < variance.cdf(high) - variance.cdf(low) < 0.985


@pytest.mark.parametrize(("times", "worse"), [(0.97, False), (1.07, False), (1.11, True)])
def test_worse_is_beyond_the_uncertainty(times: float, worse: bool) -> None:
    """3 % each way: 1.96 times 0.044 is 0.09."""
    found = result({"raw": walk(3e-3, 9e-5), "parabolas": walk(times * 3e-3, times * 9e-5)})
    assert found.is_worse("parabolas") is worse


def test_uncertainty_of_a_walk() -> None:
    """As stated; from the upper limit where quantisation hides it; wider where the terms do not describe it."""
    assert laser_results.walk_std_deg_rth(walk(3e-3, 9e-5)) == 9e-5
    assert laser_results.walk_std_deg_rth(walk(0.0, np.nan, upper=3.29e-4)) == pytest.approx(2e-4)
    assert laser_results.misfit(walk(3e-3, 9e-5, chi2=14.0)) == 1.0  # 1.6 % by chance
    assert laser_results.walk_std_deg_rth(walk(3e-3, 9e-5, chi2=80.0)) == pytest.approx(4.0 * 9e-5)


def test_constants_of_stretches_are_averaged_by_weight_and_about_the_half_turn() -> None:
    kappa = GAIN * np.deg2rad(0.05)
    fits = [
        constants(1.02 * kappa, 0.01 * kappa, np.deg2rad(179.0), np.deg2rad(0.3)),
        constants(0.99 * kappa, 0.005 * kappa, np.deg2rad(-178.0), np.deg2rad(0.3)),
    ]
    found = result(BOTH, fits)
    rate, phase = found.lock_in_deg_s, found.backscatter_deg
    assert phase is not None
    assert rate.value == pytest.approx(0.05 * (1.02 + 4.0 * 0.99) / 5.0)
    assert rate.std == pytest.approx(0.05 * 0.01 / np.sqrt(5.0))
    assert phase.value == pytest.approx(-179.5)
    assert phase.std == pytest.approx(0.3 / np.sqrt(2.0))
    assert found.counted_dither_deg_s == pytest.approx(100.0)
    due = np.rad2deg(np.deg2rad(rate.value) / np.sqrt(GAIN * np.deg2rad(100.0))) * 60.0  # equation (6)
    assert found.expected_deg_rth == pytest.approx(due)


@pytest.mark.parametrize(("wave_rad", "share"), [(0.0, 0.0), (5e-3, 0.5 / np.sqrt(2.0))])
def test_what_is_left_is_told_from_noise(wave_rad: float, share: float) -> None:
    """RMS of the mean against the phase over that of the jumps, 10 mrad; noise of 3 mrad adds nothing."""
    rng = np.random.default_rng(706)
    psi0_rad = rng.uniform(-10.0, 10.0, 4800)
    left_rad = wave_rad * np.sin(psi0_rad) + 3e-3 * rng.normal(size=psi0_rad.size)
    jumps = {JUDGED: 1e-2 * np.sqrt(2.0) * np.sin(psi0_rad)}
    found = result(BOTH, shown=Shown(np.empty((0, 8)), np.empty((0, 8)), jumps, psi0_rad, left_rad))
    assert found.systematic_share == pytest.approx(share, abs=0.02)


def test_estimates_of_one_record() -> None:
    """3 % of a walk have 1 / (2 0.03^2) or 556 degrees of freedom, those of the time 139; hidden values have four."""
    found = laser_results.record_estimates(result(BOTH), laser_results.Requirement(0.05625, 60.0, 37.0), JUDGED)
    per_s = 3e-3 / 60.0 / (7.2921151e-5 * np.cos(np.deg2rad(37.0)) * 0.05625)  # earth rate in rad/s
    time, shorter = one(found, "alignment_time", method="raw"), one(found, "alignment_time_ratio", method=JUDGED)
    assert time.value == pytest.approx(per_s**2, rel=1e-5)
    assert time.std_uncertainty == pytest.approx(2.0 * 0.03 * time.value, rel=2e-3)
    assert value(found, "quantisation_noise", method="raw") == pytest.approx(3600.0 * 1e-6)
    assert shorter.value == pytest.approx(0.04)
    assert shorter.std_uncertainty == pytest.approx(2.0 * 0.04 * np.hypot(0.05, 0.03), rel=5e-3)
    assert every(found, "random_walk_ratio", method="raw") == []
    limited = [(entry.quantity, entry.conditions["method"]) for entry in found if entry.limit is not None]
    assert limited == [("alignment_time", JUDGED)]
    walk_behind = one(found, "angle_random_walk", method=JUDGED)
    assert (walk_behind.n, walk_behind.dropped) == (990, 10)
    assert one(found, "angle_random_walk", method="raw").dof == pytest.approx(555.6, rel=2e-3)
    assert time.dof == pytest.approx(138.9, rel=2e-3)
    ratio = one(found, "random_walk_ratio", method=JUDGED)
    assert ratio.dof == pytest.approx(0.5 / (0.05**2 + 0.03**2))
    assert shorter.dof == pytest.approx(0.125 / (0.05**2 + 0.03**2), rel=0.02)
    assert laser_results.size_dof(0.0, 1.0) == 4.0
    lead, alignment, *_ = tables([result(BOTH)], laser_results.Requirement(0.1125, None, 37.0), JUDGED)
    cells = dict(zip(lead.headers, lead.rows[0], strict=True))
    assert cells["global constants"] == f"0.200 ± {coverage_factor() * 0.2 * np.hypot(0.05, 0.03):.3f}"
    assert (cells["Fresnel, 16 a side"], cells["parabolas, 4 a side"][-6:]) == ("no result", " WORSE")
    seconds = [float(cell.split(" ")[0]) for cell in alignment.rows[0][2:4]]
    assert seconds == pytest.approx([0.25 * per_s**2, 0.04 * 0.25 * per_s**2], rel=0.02)  # of twice the error


def test_the_exponent_of_each_clock() -> None:
    results = [
        result({"raw": walk(size * path_m**-power, 0.02 * size * path_m**-power)}, path_m=path_m, clock_Hz=clock_Hz)
        for clock_Hz, size, power in ((20e6, 3e-4, 2.0), (100e6, 1e-4, 2.5))
        for path_m in (0.15, 0.28, 0.34)
    ]
    found = {one.conditions["clock_Hz"]: one for one in laser_results.exponent_estimates(results, JUDGED)}
    x = np.log([0.15, 0.28, 0.34])
    for clock_Hz, due in ((20e6, -2.0), (100e6, -2.5)):
        assert found[clock_Hz].value == pytest.approx(due)
        assert found[clock_Hz].std_uncertainty == pytest.approx(0.02 / np.sqrt(((x - x.mean()) ** 2).sum()))
        assert found[clock_Hz].conditions["method"] == "raw"


def test_figures_1_2_and_12_by_hand() -> None:
    """Paper: 0.005 deg/rt-h reach 1.04 mil in 10 min; half the path 5.66 times the walk, ten times the loss 3.16."""
    found = result(BOTH)
    first, second, third, *_ = campaign_figures([found], laser_results.Requirement(0.1125, None, 37.0), JUDGED)
    lines = {each.label: each for each in first.series}
    at = [np.exp(np.interp(np.log(t_s), np.log(each.x), np.log(each.y)))
          for each in (lines["0.005 deg/√h"], lines["28 cm, uncompensated"]) for t_s in (600.0, 150.0)]  # fmt: skip
    assert at[0] == pytest.approx(1.04, rel=0.005)
    assert at[1] == pytest.approx(2.0 * at[0], rel=1e-6)
    assert at[2] == pytest.approx(0.6 * at[0], rel=1e-2)  # 0.003 deg/rt-h
    by_ppm = {each.label: dict(zip(np.round(each.x, 6).tolist(), each.y, strict=True))
              for each in second.series if "ppm" in each.label}  # fmt: skip
    assert by_ppm["10 ppm"][30.0] == pytest.approx(1e-3)
    assert by_ppm["10 ppm"][15.0] == pytest.approx(5.657e-3, rel=1e-3)
    assert by_ppm["100 ppm"][30.0] == pytest.approx(3.162e-3, rel=1e-3)
    (before,) = (each for each in second.series if each.label == "uncompensated")
    assert (before.x, before.y) == ([pytest.approx(28.0)], [3e-3])
    assert before.high[0] == pytest.approx(3e-3 + coverage_factor() * 9e-5)
    (ratio,) = (each for each in third.series if each.label == "global constants")
    assert ratio.y == [pytest.approx(0.2)]
    assert ratio.high == [pytest.approx(0.2 * (1.0 + coverage_factor() * np.hypot(0.05, 0.03)))]
