"""Impulse response: the ideal one against closed forms, figures of its cuts, and what navigation errors do to it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from sar_rig import (
    ALONG,
    EDGE,
    RADAR,
    SIGHT,
    MIDDLE_m,
    PULSE_s,
    SPEED_m_s,
    TRACK_m,
    focused,
    identity_shift_m,
    pulses,
    spoilt,
)
from scipy import integrate, special

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.image import FLOOR_dB, image_chip, levels_dB
from bench.systems.time_sync.estimators.sar.pulses import Pulses
from bench.systems.time_sync.estimators.sar.response import Cut, cut_figures, cut_offsets, impulse_response
from sim_instruments.worlds.time_sync.radar import echoes

AZIMUTH_ZERO_m = 299_792_458.0 / 9.6e9 * 45_000.0 / (2.0 * 2500.0)
RANGE_ZERO_m = 299_792_458.0 / (2.0 * 50e6)
CELL_m = 0.25


def _sinc_islr_dB() -> float:
    """Energy of sinc^2 beyond its first zeros and within 12 widths of 0.8859, against that of the main lobe."""
    main = integrate.quad(lambda x: np.sinc(x) ** 2, 0.0, 1.0)[0]
    side = integrate.quad(lambda x: np.sinc(x) ** 2, 1.0, 12.0 * 0.885893, limit=200)[0]
    return float(10.0 * np.log10(side / main))


@pytest.mark.validates(
    "resolution and side lobes of a focused target along the track",
    against="closed form of an unweighted aperture: 0.2490 m, -13.26 dB, integrated ratio by quadrature",
)
def test_the_ideal_azimuth_response_is_that_of_the_closed_form(record_property: Callable[[str, object], None]) -> None:
    response = focused(TRACK_m)
    record_property(
        "obtained", f"{response.azimuth_resolution_m:.4f} m, {response.pslr_dB:.2f} dB, {response.islr_dB:.2f} dB"
    )
    assert response.azimuth_resolution_m == pytest.approx(0.885893 * AZIMUTH_ZERO_m, rel=1e-3)
    assert response.azimuth_resolution_m == pytest.approx(0.2490, rel=0.01)
    assert response.pslr_dB == pytest.approx(-13.2615, abs=0.02)  # highest side lobe of sinc^2
    assert response.islr_dB == pytest.approx(_sinc_islr_dB(), abs=0.03)
    assert response.peak == pytest.approx(1.0, abs=2e-4)
    assert abs(response.azimuth_shift_m) < 1e-4
    assert abs(response.range_shift_m) < 1e-3
    assert np.diff(response.azimuth_cut.offset_m).max() <= 0.06 * 0.249
    cut = response.azimuth_cut
    assert np.abs(np.abs(cut.value) - np.abs(np.sinc(cut.offset_m / AZIMUTH_ZERO_m))).max() < 1e-3


@pytest.mark.validates(
    "response of a focused target in range",
    against="closed form of the band times the Fresnel integral of the aperture",
)
def test_the_ideal_range_response_is_that_of_the_closed_form() -> None:
    """Along the line of sight an image also defocuses in azimuth: mean of exp(-j k r theta^2 / 2) over the aperture."""
    response = focused(TRACK_m)
    assert response.range_resolution_m == pytest.approx(2.656, rel=0.01)
    cut = response.range_cut
    bend = np.sqrt(4.0 * 9.6e9 / 299_792_458.0 * np.abs(cut.offset_m)) * 1250.0 / 45_000.0
    bend[bend == 0.0] = 1e-9
    sine, cosine = special.fresnel(bend)
    expected = np.abs(np.sinc(cut.offset_m / RANGE_ZERO_m)) * np.hypot(sine, cosine) / bend
    assert np.abs(np.abs(cut.value) - expected).max() < 1e-3
    assert response.range_pslr_dB == pytest.approx(-13.43, abs=0.03)


@pytest.mark.parametrize("ahead_m", [2.5, -2.5, 15.0, -15.0, -3.425])
def test_the_image_moves_with_the_estimate_along_the_track(ahead_m: float) -> None:
    """Ahead of the antenna = image ahead; -3.425 m is 13.7 ms of lag, no whole number of samples."""
    response = focused(TRACK_m + ahead_m * ALONG)
    assert response.azimuth_shift_m == pytest.approx(ahead_m, abs=1e-4)
    assert response.range_shift_m == pytest.approx(0.0, abs=1e-3)
    assert response.pslr_dB == pytest.approx(-13.26, abs=0.02)


@pytest.mark.parametrize("error_m_s", [0.02, -0.02, 0.05])
def test_a_line_of_sight_velocity_error_moves_the_image_by_range_over_speed(error_m_s: float) -> None:
    response = focused(TRACK_m + np.outer(error_m_s * PULSE_s, SIGHT))
    assert response.azimuth_shift_m == pytest.approx(-45_000.0 / SPEED_m_s * error_m_s, abs=2e-3)


def test_lag_and_velocity_error_together_obey_the_identity_not_the_lag_alone() -> None:
    """10 ms of lag with 1.2 mm/s to the side: -2.5 m and -0.22 m."""
    error = np.outer(np.full(len(PULSE_s), -2.5), ALONG) + np.outer(0.4 + 0.0012 * PULSE_s, SIGHT)
    error = error + np.outer(5e-5 * PULSE_s**2, [0.3, 1.0, -0.4])
    response = focused(TRACK_m + error)
    assert response.azimuth_shift_m == pytest.approx(-2.716, abs=2e-3)
    expected = identity_shift_m(error)
    assert response.azimuth_shift_m == pytest.approx(expected, abs=2e-3)
    assert response.range_shift_m == pytest.approx(0.4, abs=0.05)


def test_a_constant_sideways_error_moves_the_image_in_range_alone() -> None:
    response = focused(TRACK_m + 3.0 * SIGHT)
    assert response.range_shift_m == pytest.approx(3.0, abs=2e-3)
    assert response.azimuth_shift_m == pytest.approx(0.0, abs=1e-3)


@pytest.mark.validates(
    "peak and side lobes of a response with a quadratic phase error",
    against="Fresnel integral of scipy",
)
@pytest.mark.parametrize("edge_rad", [np.pi / 4, np.pi / 2, 3 * np.pi / 4])
def test_a_quadratic_phase_error_does_what_the_fresnel_integral_says(edge_rad: float) -> None:
    response = spoilt(edge_rad * EDGE**2)
    place = response.azimuth_cut.offset_m / AZIMUTH_ZERO_m

    def _closed(u: np.ndarray) -> np.ndarray:
        """|mean over -1..1 of exp(j (edge x^2 + pi u x))| by completing the square."""
        scale = np.sqrt(2.0 * edge_rad / np.pi)
        middle = np.pi * u / (2.0 * edge_rad)
        high, low = special.fresnel(scale * (1.0 + middle)), special.fresnel(scale * (middle - 1.0))
        return np.hypot(high[0] - low[0], high[1] - low[1]) / (2.0 * scale)

    # the peak moves in range, where the focus is a little better: 2 pi r theta^2 / lambda of the error at the edge
    edge_rad -= 2.0 * np.pi * response.range_shift_m * (1250.0 / 45_000.0) ** 2 * 9.6e9 / 299_792_458.0
    assert np.abs(np.abs(response.azimuth_cut.value) - _closed(place)).max() < 2e-3


@pytest.mark.validates(
    "broadening of a response by quadratic phase errors",
    against="Cumming and Wong (2005), figure 3.14",
)
def test_quadratic_phase_errors_broaden_a_weighted_response_as_published() -> None:
    """Cumming and Wong (2005), figure 3.14: Kaiser window 2.5; 0.27, 0.41, 0.55 pi at the edge for 2, 5, 10 %."""
    weight = np.kaiser(len(EDGE), 2.5)
    sound = spoilt(0.0 * EDGE, weight).azimuth_resolution_m
    for share, broader in ((0.27, 0.02), (0.41, 0.05), (0.55, 0.10)):
        found = spoilt(share * np.pi * EDGE**2, weight).azimuth_resolution_m / sound - 1.0
        assert found == pytest.approx(broader, abs=0.003)


@pytest.mark.validates(
    "echoes of a response with a sinusoidal phase error",
    against="paired echoes of Klauder et al. (1960), Bessel functions of scipy",
)
def test_a_sinusoidal_phase_error_makes_paired_echoes() -> None:
    """Klauder et al. (1960): amplitude a, n cycles over the aperture: echoes J1(a) / J0(a) at n zeros' distance."""
    response = spoilt(0.6 * np.sin(2.0 * np.pi * 4.0 * EDGE))
    assert response.peak == pytest.approx(special.j0(0.6), abs=0.01)
    assert response.pslr_dB == pytest.approx(20.0 * np.log10(special.j1(0.6) / special.j0(0.6)), abs=0.35)
    cut = response.azimuth_cut
    outside = np.abs(cut.offset_m) > 1.2 * AZIMUTH_ZERO_m
    highest = cut.offset_m[outside][np.abs(cut.value[outside]).argmax()]
    assert abs(highest) == pytest.approx(8.0 * AZIMUTH_ZERO_m, abs=0.06)


def test_a_cubic_phase_error_raises_the_side_lobe_of_one_side() -> None:
    response = spoilt(np.pi / 2 * EDGE**3)
    cut = np.abs(response.azimuth_cut.value)
    side = np.abs(response.azimuth_cut.offset_m) > 1.2 * AZIMUTH_ZERO_m
    ahead = response.azimuth_cut.offset_m > 0
    assert cut[side & ahead].max() > 1.5 * cut[side & ~ahead].max()
    assert response.pslr_dB > -9.0
    assert response.azimuth_resolution_m / 0.249 < 1.02


def test_several_targets_are_measured_each_for_itself() -> None:
    for shift_m in (0.0, -8.2):
        for target in range(3):
            response = focused(TRACK_m + shift_m * ALONG, 3, target)
            assert response.azimuth_shift_m == pytest.approx(shift_m, abs=1e-3)
            assert response.pslr_dB == pytest.approx(-13.26, abs=0.02)
            assert response.islr_dB == pytest.approx(-10.12, abs=0.02)


@pytest.mark.parametrize(("azimuth_m", "range_m"), [(30.0, 12.0), (60.0, 0.0)])
def test_a_neighbour_as_near_as_stated_changes_little(azimuth_m: float, range_m: float) -> None:
    neighbour = MIDDLE_m + azimuth_m * ALONG + range_m * SIGHT
    seen = echoes(RADAR, TRACK_m, np.array([MIDDLE_m, neighbour]), np.ones(2))
    together = Pulses(seen.gates, seen.near_range_m, seen.spacing_m, RADAR.wavelength_m)
    response, alone = impulse_response(together, TRACK_m, MIDDLE_m), focused(TRACK_m)
    for name in ("pslr_dB", "islr_dB", "range_pslr_dB", "range_islr_dB"):
        assert getattr(response, name) == pytest.approx(getattr(alone, name), abs=0.02)


def test_lost_pulses_leave_the_image_where_it_is() -> None:
    """1 % of the pulses, and 100 ms of them, are missing: the rest stand where navigation says."""
    kept = np.random.default_rng(8).random(len(PULSE_s)) > 0.01
    kept[3000:3100] = False
    one = pulses()
    gappy = Pulses(one.gates[kept], one.near_range_m, one.spacing_m, one.wavelength_m)
    response = impulse_response(gappy, TRACK_m[kept] - 2.5 * ALONG, MIDDLE_m)
    assert response.azimuth_shift_m == pytest.approx(-2.5, abs=1e-3)
    assert response.pslr_dB == pytest.approx(-13.26, abs=0.5)


def test_the_chip_shows_the_target_where_the_response_says() -> None:
    chip = image_chip(pulses(), TRACK_m - 7.5 * ALONG, MIDDLE_m)
    row, column = np.unravel_index(np.abs(chip.value).argmax(), chip.value.shape)
    assert chip.value.shape == (len(chip.azimuth_m), len(chip.range_m))
    assert chip.azimuth_m[row] == pytest.approx(-7.5, abs=0.06)
    assert chip.range_m[column] == pytest.approx(0.0, abs=0.6)
    assert 0.8 < np.abs(chip.value).max() < 1.01


def test_positions_that_are_not_the_pulses_are_refused() -> None:
    still, gap = np.repeat(TRACK_m[:1], len(TRACK_m), axis=0), TRACK_m.copy()
    gap[17] = np.nan
    for positions in (TRACK_m[:-1], still, gap):
        with pytest.raises(FitError) as caught:
            impulse_response(pulses(), positions, MIDDLE_m)
        assert caught.value.code == "B-FIT-120"


def test_an_image_at_the_edge_of_the_search_is_refused() -> None:
    with pytest.raises(FitError) as caught:
        focused(TRACK_m + 20.0 * ALONG)
    assert caught.value.code == "B-FIT-121"
    assert "+17." in str(caught.value) or "+18." in str(caught.value)
    found = impulse_response(pulses(), TRACK_m + 20.0 * ALONG, MIDDLE_m, (30.0, 12.0))
    assert found.azimuth_shift_m == pytest.approx(20.0, abs=1e-3)


def test_what_is_no_point_target_is_refused() -> None:
    offset = np.linspace(-3.1, 3.1, 401)
    with pytest.raises(FitError) as caught:
        cut_figures(Cut(offset, np.ones(401, np.complex128), 0.249))
    assert caught.value.code == "B-FIT-122"


def test_a_hann_weighted_line_has_its_known_figures() -> None:
    """Spectrum weighted by a Hann window: 1.44 bins wide instead of 0.89 (Harris 1978, table 1)."""
    x_m = cut_offsets(CELL_m)
    u = 0.885893 * x_m / CELL_m
    value = np.sinc(u) + 0.5 * np.sinc(u - 1.0) + 0.5 * np.sinc(u + 1.0)
    found = cut_figures(Cut(x_m, value.astype(np.complex128), CELL_m))
    assert found.resolution_m / CELL_m == pytest.approx(1.44 / 0.8859, rel=0.01)
    # the windows stay those of the unweighted response: what the main lobe has outside counts as side lobe
    assert found.pslr_dB == pytest.approx(20.0 * np.log10(0.5), abs=0.1)  # (sinc(0) / 2 at the first zero)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_power_that_falls_on_one_side_only_is_no_response(side: float) -> None:
    x_m = cut_offsets(CELL_m)
    value = np.where(side * x_m > 0.0, np.exp(-np.abs(x_m) / CELL_m), 1.0).astype(np.complex128)
    with pytest.raises(FitError) as caught:
        cut_figures(Cut(x_m, value, CELL_m))
    assert caught.value.code == "B-FIT-122"


def test_levels_are_decibels_against_a_reference_down_to_a_floor() -> None:
    value = np.array([[2.0, 0.2j], [0.0, -2e-3]], np.complex128)
    assert levels_dB(value, 2.0) == pytest.approx(np.array([[0.0, -20.0], [FLOOR_dB, -60.0]]))
    assert levels_dB(np.abs(value), 20.0, -30.0) == pytest.approx(np.array([[-20.0, -30.0], [-30.0, -30.0]]))
