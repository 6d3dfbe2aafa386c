"""Numbers that a reader of a ring laser's report sees, from results made by hand, each against its own definition."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rlg_rig import as_row
from scipy import stats

from bench.maths.verdict import coverage_factor
from bench.systems.lock_in.compensation import COMPENSATORS, Compensated, Shown
from bench.systems.lock_in.estimators.random_walk import RandomWalk
from bench.systems.lock_in.estimators.steadiness import BiasInstability
from bench.systems.lock_in.figures import campaign_figures
from bench.systems.lock_in.records import LaserRecord
from bench.systems.lock_in.report import tables
from bench.systems.lock_in.result import (
    LaserResult,
    Requirement,
    exponent_estimates,
    misfit,
    record_estimates,
    size_dof,
    walk_std_deg_rth,
)

GAIN = np.pi * 0.28 / (2.0 * 632.8e-9)  # of 28 cm, rad/rad
NOTHING = np.empty(0)


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
) -> LaserResult:  # fmt: skip
    empty = Shown(np.empty((0, 8)), np.empty((0, 8)), {}, NOTHING, NOTHING)
    found = Compensated(2.5e-3, 2.0 * np.pi * 400.0, {}, shown or empty, list(fits), turnarounds=1000)
    found.used = dict.fromkeys(COMPENSATORS, 990)
    found.swing_rad = 2.0 * GAIN * np.deg2rad(100.0) / (2.0 * np.pi * 400.0)  # of 100 deg/s at 400 Hz, peak to peak
    row = as_row({}, np.arange(3), 1, {"path_length_m": path_m})
    events: Any = SimpleNamespace(lost_blocks=0, lost_edges=0, torn=0, dark=0)
    return LaserResult(LaserRecord(row, path_m, None), clock_Hz, events, found, walks, {})


BOTH = {"raw": walk(3e-3, 9e-5), "global_constants": walk(6e-4, 3e-5), "parabolas": walk(3.3e-3, 9e-5)}


@pytest.mark.parametrize(("shown", "text"), [(True, "1.48 ± 0.29"), (False, "< 2.4")])
def test_the_alignment_error_by_bias_is_a_value_or_a_limit(shown: bool, text: str) -> None:
    """0.0175 deg/h at 37 deg is 0.0175 / 12.012 rad or 1.48 mil of 360/6400 deg, by hand; limits are no estimates."""
    laser = result(BOTH)
    bias = BiasInstability(0.0175, 0.00175, 0.0288, shown)
    laser = replace(laser, biases={"raw": bias, "global_constants": bias})
    requirement = Requirement(360.0 / 6400.0, None, 37.0)
    (table,) = (one for one in tables([laser], requirement, "global_constants") if one.title == "Alignment time")
    assert table.rows[0][-1] == text
    found = [one for one in record_estimates(laser, requirement, "global_constants") if "bias" in one["quantity"]]
    assert [one["quantity"] for one in found] == ["bias_instability", "bias_alignment_error"] * 2 * shown
    assert all(one["value"] == pytest.approx(0.08348, rel=1e-3) for one in found[1::2])


def test_ratio_of_two_walks() -> None:
    one = result(BOTH)
    ratio = one.ratio("global_constants")
    assert ratio is not None
    assert ratio.value == pytest.approx(0.2)
    assert ratio.std == pytest.approx(0.2 * np.hypot(0.05, 0.03))  # relative uncertainties of both
    assert one.ratio("fresnel") is None


@pytest.mark.parametrize("shared", [0.0, 0.5, 0.95])
def test_the_ratio_of_outputs_that_scatter_together(shared: float) -> None:
    """Drawn: two walks of 3 and 5 % whose variances are so correlated."""
    rng = np.random.default_rng(8)
    first, other = rng.standard_normal((2, 200_000))
    together = shared * first + np.sqrt(1.0 - shared**2) * other
    drawn = np.std(0.2 * (1.0 + 0.05 * together) / (1.0 + 0.03 * first))
    ratio = replace(result(BOTH), shared={"global_constants": shared}).ratio("global_constants")
    assert ratio is not None
    assert ratio.std == pytest.approx(drawn, rel=0.02)


@pytest.mark.parametrize("dof", [16, 60, 500])
def test_intervals_of_skewed_sizes_hold_what_they_say(dof: int) -> None:
    """Exact quantiles of chi-squared for a variance and its root, of F for ratios of two: 95 %, or a little more."""
    relative = np.sqrt(2.0 / dof)
    two = (stats.chi2(dof, scale=1.0 / dof), relative), (stats.f(dof, dof), np.sqrt(2.0) * relative)
    for variance, std in two:
        for power, least in ((1.0, 0.945), (0.5, 0.92)):
            reach = coverage_factor(size_dof(1.0, power * std)) * power * std
            low, high = (1.0 + reach) ** (-1.0 / power), max(1.0 - reach, 1e-9) ** (-1.0 / power)
            assert least < variance.cdf(high) - variance.cdf(low) < 0.985


def test_the_degrees_of_freedom_of_each_size() -> None:
    """3 % of a walk are 1 / (2 0.03^2) or 556, of the time 139; a value that quantisation hides has four."""
    found = estimates_of(result(BOTH))
    dof = {quantity: found[quantity, "raw"]["dof"] for quantity in ("angle_random_walk", "alignment_time")}
    assert dof == pytest.approx({"angle_random_walk": 555.6, "alignment_time": 138.9}, rel=2e-3)
    judged = "global_constants"
    assert found["random_walk_ratio", judged]["dof"] == pytest.approx(0.5 / (0.05**2 + 0.03**2))
    assert found["alignment_time_ratio", judged]["dof"] == pytest.approx(0.125 / (0.05**2 + 0.03**2), rel=0.02)
    assert size_dof(0.0, 1.0) == 4.0


@pytest.mark.parametrize(("times", "worse"), [(0.97, False), (1.07, False), (1.11, True)])
def test_worse_is_beyond_the_uncertainty(times: float, worse: bool) -> None:
    """3 % each way: 1.96 times 0.044 is 0.09."""
    one = result({"raw": walk(3e-3, 9e-5), "parabolas": walk(times * 3e-3, times * 9e-5)})
    assert one.is_worse("parabolas") is worse


def test_uncertainty_of_a_walk() -> None:
    """As stated; from the upper limit where quantisation hides it; wider where the terms do not describe it."""
    assert walk_std_deg_rth(walk(3e-3, 9e-5)) == 9e-5
    assert walk_std_deg_rth(walk(0.0, np.nan, upper=3.29e-4)) == pytest.approx(2e-4)
    assert misfit(walk(3e-3, 9e-5, chi2=14.0)) == 1.0  # 1.6 % by chance
    assert walk_std_deg_rth(walk(3e-3, 9e-5, chi2=80.0)) == pytest.approx(4.0 * 9e-5)


def test_constants_of_stretches_are_averaged_by_weight_and_about_the_half_turn() -> None:
    kappa = GAIN * np.deg2rad(0.05)
    fits = [
        constants(1.02 * kappa, 0.01 * kappa, np.deg2rad(179.0), np.deg2rad(0.3)),
        constants(0.99 * kappa, 0.005 * kappa, np.deg2rad(-178.0), np.deg2rad(0.3)),
    ]
    one = result(BOTH, fits)
    rate, phase = one.lock_in_deg_s, one.backscatter_deg
    assert rate is not None
    assert phase is not None
    assert rate.value == pytest.approx(0.05 * (1.02 + 4.0 * 0.99) / 5.0)
    assert rate.std == pytest.approx(0.05 * 0.01 / np.sqrt(5.0))
    assert phase.value == pytest.approx(-179.5)
    assert phase.std == pytest.approx(0.3 / np.sqrt(2.0))
    assert one.counted_dither_deg_s == pytest.approx(100.0)
    due = np.rad2deg(np.deg2rad(rate.value) / np.sqrt(GAIN * np.deg2rad(100.0))) * 60.0  # equation (6)
    assert one.expected_deg_rth == pytest.approx(due)


@pytest.mark.parametrize(("wave_rad", "share"), [(0.0, 0.0), (5e-3, 0.5 / np.sqrt(2.0))])
def test_what_is_left_is_told_from_noise(wave_rad: float, share: float) -> None:
    """RMS of the mean against the phase over that of the jumps, 10 mrad; noise of 3 mrad adds nothing."""
    rng = np.random.default_rng(706)
    psi0_rad = rng.uniform(-10.0, 10.0, 4800)
    left_rad = wave_rad * np.sin(psi0_rad) + 3e-3 * rng.normal(size=psi0_rad.size)
    jumps = {"global_constants": 1e-2 * np.sqrt(2.0) * np.sin(psi0_rad)}
    one = result(BOTH, shown=Shown(np.empty((0, 8)), np.empty((0, 8)), jumps, psi0_rad, left_rad))
    assert one.systematic_share == pytest.approx(share, abs=0.02)


def estimates_of(one: LaserResult, judged: str = "global_constants") -> dict[tuple[str, str], dict[str, Any]]:
    found = record_estimates(one, Requirement(0.05625, 60.0, 37.0), judged)
    return {(each["quantity"], each["conditions"].get("method", "")): each for each in found}


def test_estimates_of_one_record() -> None:
    found = estimates_of(result(BOTH))
    judged = "global_constants"
    per_s = 3e-3 / 60.0 / (7.2921151e-5 * np.cos(np.deg2rad(37.0)) * 0.05625)  # earth rate in rad/s
    time = found["alignment_time", "raw"]
    assert time["value"] == pytest.approx(per_s**2, rel=1e-5)
    assert time["std_uncertainty"] == pytest.approx(2.0 * 0.03 * time["value"], rel=2e-3)
    assert found["quantisation_noise", "raw"]["value"] == pytest.approx(3600.0 * 1e-6)
    shorter = found["alignment_time_ratio", judged]
    assert shorter["value"] == pytest.approx(0.04)
    assert shorter["std_uncertainty"] == pytest.approx(2.0 * 0.04 * np.hypot(0.05, 0.03), rel=5e-3)
    assert ("random_walk_ratio", "raw") not in found
    assert {place for place, one in found.items() if one["limit"] is not None} == {("alignment_time", judged)}
    assert found["angle_random_walk", judged]["n"] == 990
    assert found["angle_random_walk", judged]["dropped"] == 10


def test_the_exponent_of_each_clock() -> None:
    results = [
        result({"raw": walk(size * path_m**-power, 0.02 * size * path_m**-power)}, path_m=path_m, clock_Hz=clock_Hz)
        for clock_Hz, size, power in ((20e6, 3e-4, 2.0), (100e6, 1e-4, 2.5))
        for path_m in (0.15, 0.28, 0.34)
    ]
    found = {one["conditions"]["clock_Hz"]: one for one in exponent_estimates(results, "global_constants")}
    x = np.log([0.15, 0.28, 0.34])
    for clock_Hz, due in ((20e6, -2.0), (100e6, -2.5)):
        assert found[clock_Hz]["value"] == pytest.approx(due)
        assert found[clock_Hz]["std_uncertainty"] == pytest.approx(0.02 / np.sqrt(((x - x.mean()) ** 2).sum()))
        assert found[clock_Hz]["conditions"]["method"] == "raw"


def test_tables_say_what_the_estimates_say() -> None:
    kappa = GAIN * np.deg2rad(0.05)
    one = result(BOTH, [constants(kappa, 0.01 * kappa, np.deg2rad(40.0), np.deg2rad(0.5))])
    lead, alignment, laser, walks, _ = tables([one], Requirement(0.1125, None, 37.0), "global_constants")
    (row,) = lead.rows
    assert row[:3] == ["28", "100", "40.0"]
    cells = dict(zip(lead.headers, row, strict=True))
    reach = coverage_factor() * 0.2 * np.hypot(0.05, 0.03)
    assert cells["global constants"] == f"0.200 ± {reach:.3f}"
    assert cells["Fresnel, 16 a side"] == "no result"
    assert cells["parabolas, 4 a side"].endswith(" WORSE")
    assert "(2 NATO mil" in alignment.caption
    seconds = 0.25 * (3e-3 / 60.0 / (7.2921151e-5 * np.cos(np.deg2rad(37.0)) * 0.05625)) ** 2
    assert float(alignment.rows[0][2].split(" ")[0]) == pytest.approx(seconds, rel=0.01)
    assert float(alignment.rows[0][3].split(" ")[0]) == pytest.approx(0.04 * seconds, rel=0.02)
    assert laser.rows[0][2] == "50.00 ± 0.98"  # mdeg/s
    assert laser.rows[0][5] == "100.00"
    assert walks.rows[0][3].startswith("3.00 ± ")  # 1e-3 deg/h^0.5
    assert walks.rows[0][4].startswith("3.60 ± ")  # 1e-3 arcsec


def test_figures_1_2_and_12_by_hand() -> None:
    """Paper: 0.005 deg/rt-h reach 1.04 mil in 10 min; half the path 5.66 times the walk, ten times the loss 3.16."""
    one = result(BOTH)
    first, second, third, *_ = campaign_figures([one], Requirement(0.1125, None, 37.0), "global_constants")
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
