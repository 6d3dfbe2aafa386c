"""Attitude on the table and the Earth's rate in it, against scipy's rotations and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from imu_fit_simulation import EARTH_DEG_S, body_to_local, local_rate_deg_s
from scipy.spatial.transform import Rotation

from bench.systems.gnc.estimators import earth_rate as er
from bench.systems.gnc.estimators.earth_rate import Pose, Site


def test_attitude_against_scipy() -> None:
    rng = np.random.default_rng(3)
    for mounting in "xyz":
        for _ in range(20):
            pose = Pose(*rng.uniform(-180.0, 180.0, 3), mounting)
            azimuth = rng.uniform(0.0, 360.0)
            assert er.attitude(pose, Site(0.0, azimuth)) == pytest.approx(body_to_local(pose, azimuth).as_matrix())
    # by hand: at azimuth 90 the inner axis points East, then the middle axis North; at azimuth 0 the inner axis North
    assert er.attitude(Pose(), Site(0.0, 90.0)) == pytest.approx(np.eye(3))
    assert er.attitude(Pose(), Site(0.0, 0.0)) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert er.attitude(Pose(outer_deg=90.0), Site(0.0, 90.0)) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert er.attitude(Pose(middle_deg=-90.0), Site(0.0, 90.0)) @ [1, 0, 0] == pytest.approx([0, 0, 1])
    assert er.mounting_matrix("y") @ [1, 2, 3] == pytest.approx([2, 3, 1])
    assert er.mounting_matrix("z") @ [1, 2, 3] == pytest.approx([3, 1, 2])


@pytest.mark.validates(
    "Earth's rate in the body: level, pole, along the Earth's axis",
    against="closed forms with one turn in a sidereal day of 86164.1 s",
)
def test_closed_forms() -> None:
    assert er.earth_rate_local_deg_s(34.2) == pytest.approx(local_rate_deg_s(34.2), rel=1e-6)
    level = er.earth_rate_body_deg_s(Pose(), Site(34.2, 30.0))  # x has azimuth 30, y is 90 degrees to its left
    cosine = 360.0 / 86164.1 * np.cos(np.radians(34.2))
    assert level[0] == pytest.approx(cosine * np.cos(np.radians(30.0)), rel=1e-6)
    assert level[1] == pytest.approx(cosine * np.cos(np.radians(300.0)), rel=1e-6)
    for mounting, place in (("x", 0), ("y", 1), ("z", 2)):
        along = er.earth_rate_body_deg_s(Pose(90.0, -34.2, 77.0, mounting), Site(34.2, 90.0))
        assert along == pytest.approx(EARTH_DEG_S * np.eye(3)[place], rel=1e-6, abs=1e-12)
    pole = er.earth_rate_body_deg_s(Pose(inner_deg=90.0), Site(90.0, 0.0))
    assert pole == pytest.approx([0, EARTH_DEG_S, 0], abs=1e-9)
    most = er.earth_rate_body_deg_s(Pose(), Site(34.2, 0.0))[0]  # more than the 10 deg/h of the paper's table 3
    assert 3600.0 * most == pytest.approx(12.44, abs=0.01)


def test_covariance_by_trials() -> None:
    """Latitude, azimuth and three small angles drawn; rotation of the unit by scipy."""
    site, pose = Site(34.2, 50.0, 0.1, 0.5, 0.2), Pose(10.0, 20.0, 30.0, "z")
    rng = np.random.default_rng(4)
    seen = []
    for _ in range(4000):
        tilt = Rotation.from_rotvec(rng.normal(size=3) * 0.2, degrees=True)
        body = body_to_local(pose, 50.0 + 0.5 * rng.normal()) * tilt
        seen.append(body.inv().apply(local_rate_deg_s(34.2 + 0.1 * rng.normal())))
    spread, stated = np.cov(np.transpose(seen)), er.earth_rate_covariance(pose, site)
    size = np.sqrt(np.outer(stated.diagonal(), stated.diagonal()))
    assert np.abs((spread - stated) / size).max() < 0.07
    assert np.all(er.earth_rate_covariance(pose, Site(34.2, 50.0)) == 0.0)


def test_specific_force_and_axis_of_turn() -> None:
    assert er.up_in_body(Pose()) == pytest.approx([0, 0, 1])
    assert er.up_in_body(Pose(middle_deg=-90.0, mounting="y")) == pytest.approx([0, 1, 0])
    assert er.turn_axis_in_body(Pose(5.0, 6.0, 7.0, "z"), "inner") == pytest.approx([0, 0, 1])
    assert er.turn_axis_in_body(Pose(5.0, 90.0, 7.0, "x"), "outer") == pytest.approx([-1, 0, 0])
    with pytest.raises(ValueError, match="none of inner, outer"):
        er.turn_axis_in_body(Pose(), "middle")
