"""Track and height of a flight against positions that were made on the ellipsoid, and none of a table at rest."""

from __future__ import annotations

import numpy as np
import pytest
from time_sync_material import geodetic

from bench.analysis import Figure, Floats, Series
from bench.maths.geodesy import TangentFrame
from bench.systems.time_sync.filtering import trajectory_figures
from bench.systems.time_sync.records import Stream
from bench.systems.time_sync.samples import EgiSamples

FRAME = TangentFrame(37.5, 126.95)
T_s = 7.0 + 0.02 * np.arange(25_000)  # 500 s at 50 Hz
SPEED_m_s, HEIGHT_m = 250.0, 3000.0


def samples(p: Floats) -> EgiSamples:
    shape = (len(p), 3, 3)
    return EgiSamples(T_s[: len(p)], p, np.zeros_like(p), np.broadcast_to(np.eye(3), shape), FRAME, 1.0)


def flight() -> EgiSamples:
    """North at one height over the ellipsoid, along a meridian: 125 km, which leaves the tangent plane by 1.2 km."""
    along_deg = np.degrees(SPEED_m_s * (T_s - T_s[0]) / 6_360_000.0)
    return samples(FRAME.positions_m(37.5 + along_deg, np.full(T_s.size, 126.95), np.full(T_s.size, HEIGHT_m)))


def part(figure: Figure, label: str) -> Series:
    (found,) = [one for one in figure.series if one.label == label]
    return found


def test_a_height_is_that_over_the_ellipsoid_and_not_that_over_the_plane() -> None:
    egi = flight()
    track, height = trajectory_figures(egi, None)
    assert -egi.p[-1, 2] - HEIGHT_m == pytest.approx(-1228.0, abs=5.0)  # d^2 / 2R
    assert np.abs(np.array(part(height, "height").y) - HEIGHT_m).max() < 1e-3
    assert track.equal
    assert track.x_label, track.y_label == ("east, km", "north, km")


@pytest.mark.parametrize("point_m", [(0.0, 0.0, 0.0), (60_000.0, -80_000.0, -2500.0), (-9e4, 4e4, 300.0)])
def test_heights_are_those_of_another_way_down_to_the_ellipsoid(point_m: tuple[float, float, float]) -> None:
    point = np.array([point_m])
    assert FRAME.heights_m(point) == pytest.approx(geodetic(point)[2], abs=1e-5)


def test_times_start_end_and_the_image_stand_on_the_track() -> None:
    pulses = np.linspace(T_s[0] + 490.0, T_s[-1], 100)
    radar = Stream(pulses, np.arange(100), np.arange(100), {})
    track, _ = trajectory_figures(flight(), radar)
    marks = np.array(part(track, "each 60 s").y)
    assert marks == pytest.approx(1e-3 * SPEED_m_s * 60.0 * np.arange(1, 9), rel=2e-3)
    assert part(track, "start").y == [pytest.approx(0.0, abs=1e-9)]
    assert part(track, "end").y[0] == pytest.approx(125.0, rel=3e-3)
    imaged = np.array(part(track, "radar image").y)
    assert (imaged[-1] - imaged[0]) == pytest.approx(1e-3 * SPEED_m_s * 10.0, rel=5e-3)
    assert "from 490 s on" in track.caption


def test_a_table_in_a_laboratory_flies_nowhere() -> None:
    noise_m = np.random.default_rng(3).normal(0.0, 1.0, (T_s.size, 3))
    assert trajectory_figures(samples(noise_m), None) == []
