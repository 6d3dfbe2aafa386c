"""Bias, stability and repeatability of a simulated unit at rest; what the paper's table 2 prints, for all axes."""

from __future__ import annotations

import numpy as np
import pytest
from imu_material import SITE, Rig, Unit, earth_rate, to_local, values
from spoken import english_left

from bench.analysis import build_results
from bench.systems.gnc.bias import analyse

SEED = 607
POSE = (20.0, 0.0, 0.0)
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "x 1"}


@pytest.fixture(scope="module")
def whole():
    rig = Rig(SEED, Unit(gyro_S=np.eye(3), accel_S=np.eye(3)))
    rig.rest(180.0, POSE, item="bias", up="+z")
    rig.rest(180.0, POSE, item="flip", up="+z")
    rig.rest(180.0, (20.0, 0.0, 180.0), item="flip", up="-z")
    rig.rest(3600.0, POSE, item="stability", up="+z")
    for number in range(6):
        rig.t_s += 600.0
        rig.rest(600.0, POSE, item="repeatability", up="+z", repeat_index=number)
    return analyse(rig.material("imu_bias", limits={"gyro_bias_stability": {"value": 10.0, "unit": "deg/h"}}))


def test_the_gyro_bias_is_free_of_the_earth_rate(whole) -> None:
    seen = to_local(*POSE, "x").T @ earth_rate() * 3600.0
    assert np.abs(seen[:2]).max() > 5.0  # deg/h: what would be taken for bias
    expected = 3600.0 * Unit().gyro_bias_deg_s
    np.testing.assert_allclose(values(whole.estimates, "gyro_bias"), expected, atol=4.5 * 18.0 / 180.0**0.5)


def test_the_flip_gives_the_bias_of_the_axes_it_reverses(whole) -> None:
    found = {one["conditions"]["axis"]: one for one in whole.estimates if one["quantity"] == "accel_bias"}
    assert set(found) == {"y", "z"}
    for axis, number in (("y", 1), ("z", 2)):
        assert found[axis]["value"] == pytest.approx(-Unit().accel_bias_g[number], abs=5e-5)
    assert any("The flip was about x" in note for note in whole.notes)


def test_stability_is_that_of_360_means_and_not_of_samples(whole) -> None:
    """White noise of 0.3 deg/sqrt(h) makes 0.3 * 60 / sqrt(10 s) deg/h; 0.1 mg/sqrt(Hz) makes 0.032 mg."""
    gyro = [one for one in whole.estimates if one["quantity"] == "gyro_bias_stability"]
    assert [one["n"] for one in gyro] == [360] * 3
    for one in gyro:
        assert one["value"] == pytest.approx(18.0 / 10.0**0.5, rel=0.2)
        assert one["limit"] == pytest.approx(10.0)
        assert one["verdict"] == "pass"
        assert 0.02 < one["std_uncertainty"] / one["value"] < 0.06
    accel = values(whole.estimates, "accel_bias_stability")
    np.testing.assert_allclose(accel, 0.1 / 10.0**0.5, rtol=0.2)


def test_repeatability_is_reported_and_never_judged(whole) -> None:
    found = [one for one in whole.estimates if one["quantity"].endswith("_bias_repeatability")]
    assert len(found) == 6
    assert {one["verdict"] for one in found} == {"none"}
    gyro = values(whole.estimates, "gyro_bias_repeatability")
    assert np.all((gyro > 0.1) & (gyro < 18.0 / 600.0**0.5 * 2.5))


def test_tables_2_and_3(whole) -> None:
    assert english_left(whole) == set()
    titles = [one.title for one in whole.tables]
    table_2 = whole.tables[titles.index("Table 2: stability and repeatability")]
    assert table_2.headers == ["quantity", "x", "y", "z"]
    assert "not tested" not in str(table_2.rows)
    table_3 = {row[0]: row for row in whole.tables[titles.index("Table 3: specification of the module")].rows}
    assert table_3["gyro: bias stability, 1 sigma"][-1] == "PASS"
    assert table_3["gyro: bias stability, 1 sigma"][3] == "10"
    assert " ± " in table_3["gyro: bias stability, 1 sigma"][2]
    assert [row[-1] for row in table_3.values()].count("PASS") == 2
    assert table_3["overload"][-1] == "not tested"
    assert not any("repeatability" in name and row[-1] != "not tested" for name, row in table_3.items())
    assert whole.missing == []
    build_results("one", whole, {}, PROVENANCE)


def test_windows_without_gaps_and_a_short_hour_give_no_result() -> None:
    rig = Rig(SEED)
    rig.rest(120.0, POSE, item="stability", up="+z")
    for _ in range(6):
        rig.rest(61.0, POSE, item="repeatability", up="+z")
    analysis = analyse(rig.material("imu_bias"))
    assert analysis.estimates == []
    assert sum("B-FIT-092" in one for one in analysis.missing) == 6
    assert sum("B-FIT-093" in one for one in analysis.missing) == 6
    assert {"bias: no record", "flip: no record"} <= set(analysis.missing)
    assert "not tested" in str(analysis.tables[1].rows)


def test_gravity_of_the_site_is_not_needed_for_a_bias() -> None:
    rig = Rig(SEED)
    rig.rest(61.0, POSE, item="bias", up="+z")
    site = {name: SITE[name] for name in ("latitude_deg", "azimuth_deg")}
    analysis = analyse(rig.material("imu_bias", site=site))
    assert [one["quantity"] for one in analysis.estimates] == ["gyro_bias"] * 3
