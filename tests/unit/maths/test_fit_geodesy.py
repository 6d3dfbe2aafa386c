"""Conversion from latitude, longitude and height to the tangent frame, against published worked examples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.maths.geodesy import FLATTENING, SEMI_MAJOR_m, TangentFrame, body_to_level, geocentric_m, level_axes

# EPSG Guidance Note 7-2, sections 4.1.1 to 4.1.3: one point on WGS 84, in every form
LATITUDE_DEG = 53.0 + 48.0 / 60.0 + 33.820 / 3600.0
LONGITUDE_DEG = 2.0 + 7.0 / 60.0 + 46.380 / 3600.0
HEIGHT_m = 73.0
GEOCENTRIC_m = [3_771_793.968, 140_253.342, 5_124_304.349]
ORIGIN_DEG, ORIGIN_HEIGHT_m = (55.0, 5.0), 200.0
EAST_NORTH_UP_m = [-189_013.869, -128_642.040, -4_220.171]


def one(*values: float) -> list[np.ndarray]:
    return [np.array([value]) for value in values]


@pytest.mark.validates(
    "Earth-centred coordinates of the analysis",
    against="worked example of IOGP Report 373-7-2 (EPSG Guidance Note 7-2), method 9602",
)
def test_geocentric_coordinates_of_the_worked_example(record_property: Callable[[str, object], None]) -> None:
    found = geocentric_m(*one(LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_m))
    record_property("obtained", f"within {1e3 * np.abs(found[0] - GEOCENTRIC_m).max():.1f} mm, printed to 1 mm")
    assert found[0] == pytest.approx(GEOCENTRIC_m, abs=1e-3)


@pytest.mark.validates(
    "tangent plane of the analysis",
    against="worked example of IOGP Report 373-7-2 (EPSG Guidance Note 7-2), method 9837",
)
def test_tangent_positions_of_the_worked_example() -> None:
    # the example's origin stands 200 m above the ellipsoid, ours on it: 200 m further down
    north, east, down = TangentFrame(*ORIGIN_DEG).positions_m(*one(LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_m))[0]
    assert [east, north, -(down + ORIGIN_HEIGHT_m)] == pytest.approx(EAST_NORTH_UP_m, abs=1.5e-3)


def second_geodetic(x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
    """Bowring's way back (Survey Review 23, 1976), which knows nothing of the way there."""
    b_m = SEMI_MAJOR_m * (1.0 - FLATTENING)
    e2, second = FLATTENING * (2.0 - FLATTENING), (SEMI_MAJOR_m**2 - b_m**2) / b_m**2
    out_m = np.hypot(x_m, y_m)
    reduced = np.arctan2(z_m * SEMI_MAJOR_m, out_m * b_m)
    for _ in range(3):
        latitude = np.arctan2(
            z_m + second * b_m * np.sin(reduced) ** 3, out_m - e2 * SEMI_MAJOR_m * np.cos(reduced) ** 3
        )
        reduced = np.arctan2((1.0 - FLATTENING) * np.sin(latitude), np.cos(latitude))
    normal_m = SEMI_MAJOR_m / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    height_m = out_m * np.cos(latitude) + z_m * np.sin(latitude) - SEMI_MAJOR_m**2 / normal_m
    return float(np.degrees(latitude)), float(np.degrees(np.arctan2(y_m, x_m))), float(height_m)


@pytest.mark.parametrize(
    "place", [(37.5, 127.0, 3000.0), (-33.9, -70.1, 12_000.0), (0.0, 179.9, 0.0), (71.0, 8.0, 5e4)]
)
def test_second_method_finds_the_way_back(place: tuple[float, float, float]) -> None:
    back = second_geodetic(*geocentric_m(*one(*place))[0])
    assert back[:2] == pytest.approx(place[:2], abs=1e-12)
    assert back[2] == pytest.approx(place[2], abs=1e-8)


def test_level_frame_is_the_gradient_of_the_position() -> None:
    """North, east and down are where the position goes when latitude, longitude and height change."""
    place, step = (37.5, 127.0, 3000.0), 1e-5
    axes = level_axes(*one(*place[:2]))[0]
    for row, (index, sense) in enumerate(((0, 1.0), (1, 1.0), (2, -1.0))):
        high, low = list(place), list(place)
        high[index] += step
        low[index] -= step
        along = sense * (geocentric_m(*one(*high))[0] - geocentric_m(*one(*low))[0])
        assert axes[row] == pytest.approx(along / np.linalg.norm(along), abs=2e-8 if index < 2 else 1e-4)


def test_level_frame_ahead_is_turned_by_the_way_on_the_ellipsoid() -> None:
    """A kilometre north the level frame has pitched by the way over the meridian's radius of curvature."""
    tangent = TangentFrame(37.5, 127.0)
    north_m = tangent.positions_m(*one(37.51, 127.0, 0.0))[0, 0]
    turned = tangent.from_level(*one(37.51, 127.0))[0]
    assert np.degrees(Rotation.from_matrix(turned).as_rotvec()) == pytest.approx([0.0, -0.01, 0.0], abs=1e-12)
    assert north_m / np.radians(0.01) == pytest.approx(6_359_100.0, rel=2e-4)  # radius of the meridian at 37.5 deg


def test_attitude_by_another_program() -> None:
    rng = np.random.default_rng(8)
    angles = rng.uniform([-180.0, -89.0, 0.0], [180.0, 89.0, 360.0], (50, 3))
    expected = Rotation.from_euler("ZYX", angles[:, ::-1], degrees=True).as_matrix()
    assert body_to_level(*angles.T) == pytest.approx(expected, abs=1e-12)
    assert body_to_level(*one(0.0, 0.0, 90.0))[0] @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
