"""Focusing against plain sums, the impulse response against closed forms, and what navigation errors do to it."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate, special

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.image import FLOOR_dB, focus_sums, image_chip, levels_dB, point_targets
from bench.systems.time_sync.estimators.sar.pulses import Pulses, at_places, finer, positions_at, sums_of
from bench.systems.time_sync.estimators.sar.response import Response, cut_of, cut_offsets, impulse_response
from sim_instruments.worlds.time_sync.world import Radar, echoes, scene

Array = NDArray[np.float64]
Keep = Callable[[str, object], None]

LIGHT_m_s = 299_792_458.0
SPEED_m_s = 250.0
RADAR = Radar()
PULSE_s: Array = (np.arange(10_000) - 4999.5) / 1000.0
TRACK_m: Array = np.stack([SPEED_m_s * PULSE_s, np.zeros(10_000), np.full(10_000, -3000.0)], axis=1)
TARGETS_m: Array = scene(Radar(aperture_s=-2.0 * PULSE_s[0]), TRACK_m[0], np.array([SPEED_m_s, 0.0, 0.0]))
MIDDLE_m: Array = TARGETS_m[0]
ALONG: Array = np.array([1.0, 0.0, 0.0])
SIGHT: Array = (MIDDLE_m - [0.0, 0.0, -3000.0]) / 45_000.0  # antenna to target at the middle
EDGE: Array = PULSE_s / 5.0  # -1 to 1 over the aperture
AZIMUTH_ZERO_m = LIGHT_m_s / 9.6e9 * 45_000.0 / (2.0 * 2500.0)
RANGE_ZERO_m = LIGHT_m_s / (2.0 * 50e6)
CELL_m = 0.25
NEAR_m: Array = MIDDLE_m + np.linspace(-3.0, 3.0, 61)[:, None] * ALONG
PIXELS_m: Array = np.concatenate([NEAR_m, MIDDLE_m + np.linspace(-32.0, 32.0, 61)[:, None] * SIGHT])
EPOCH_s: Array = np.arange(21) * 0.005
BETWEEN_s: Array = np.linspace(0.0, 0.1, 101)
CUBIC = np.array([[3.0, -1.0, 2.0], [250.0, 4.0, -6.0], [2.0, 5.0, -9.0], [70.0, -30.0, 11.0]])  # by power of time


@cache
def pulses(count: int = 1) -> Pulses:
    """Echoes of the scene's first targets, of amplitude 1."""
    gates = echoes(RADAR, TRACK_m, TARGETS_m[:count], np.ones(count))
    return Pulses(gates, RADAR.near_range_m, RADAR.spacing_m, RADAR.wavelength_m)


def spoilt(phase_rad: Array, weight: Array | float = 1.0) -> Response:
    """Response of the middle target with a phase error and a weight over the aperture."""
    one = pulses()
    gates = one.gates * (weight * np.exp(1j * phase_rad)).astype(np.complex64)[:, None]
    changed = Pulses(gates, one.near_range_m, one.spacing_m, one.wavelength_m)
    return impulse_response(changed, TRACK_m, MIDDLE_m)


def focused(positions_m: Array, count: int = 1, target: int = 0) -> Response:
    """Response of one target of the scene by positions that navigation gives."""
    return impulse_response(pulses(count), positions_m, TARGETS_m[target])


def by_sums(pixels_m: Array, positions_m: Array = TRACK_m) -> NDArray[np.complex128]:
    """Image of the middle target in double precision from ranges alone: no gates, no interpolation, no blocks."""
    out = np.empty(len(pixels_m), np.complex128)
    true_m = np.linalg.norm(TRACK_m - MIDDLE_m, axis=1)
    for index, pixel in enumerate(pixels_m):
        away_m = np.linalg.norm(positions_m - pixel, axis=1) - true_m
        pulse = np.sinc(away_m * 2.0 * 50e6 / LIGHT_m_s)
        out[index] = np.mean(pulse * np.exp(4j * np.pi * away_m * 9.6e9 / LIGHT_m_s))
    return out


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 215.0])
def test_targets_are_found_to_a_few_cells(heading_deg: float) -> None:
    radar, height_m, range_m = Radar(), 3000.0, 45_000.0
    turn = np.radians(heading_deg)
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    along_m = (np.arange(10_000) - 4999.5) * 0.25
    positions_m = along_m[:, None] * ahead + [500.0, -200.0, -height_m]
    middle_m = np.array([500.0, -200.0, 0.0]) + np.sqrt(range_m**2 - height_m**2) * right
    targets_m = np.stack([middle_m, middle_m + 40.0 * ahead + 15.0 * right, middle_m - 30.0 * ahead - 12.0 * right])
    gates = echoes(radar, positions_m, targets_m, np.array([1.0, 0.8, 0.6]))
    wavelength_m = 299_792_458.0 / radar.carrier_Hz
    found_m = point_targets(Pulses(gates, radar.near_range_m, radar.spacing_m, wavelength_m), positions_m)
    assert found_m.shape == (3, 3)
    assert np.abs((found_m - targets_m) @ ahead).max() < 1.0
    assert np.abs((found_m - targets_m) @ right).max() < 4.0


def _position(time_s: Array) -> Array:
    return np.vander(time_s, 4, increasing=True) @ CUBIC


def _velocity(time_s: Array) -> Array:
    return np.vander(time_s, 3, increasing=True) @ (CUBIC[1:] * [[1.0], [2.0], [3.0]])


def test_a_cubic_path_is_met_exactly_by_each_lane_for_itself() -> None:
    lanes, velocities = (np.stack([of(EPOCH_s), 2.0 * of(EPOCH_s)], axis=1) for of in (_position, _velocity))
    found = positions_at(BETWEEN_s, EPOCH_s, lanes, velocities)
    assert found.shape == (101, 2, 3)
    assert np.abs(found - _position(BETWEEN_s)[:, None] * [[1.0], [2.0]]).max() < 1e-12
    one = positions_at(BETWEEN_s, EPOCH_s, lanes[:, 0], velocities[:, 0])
    assert np.abs(one - _position(BETWEEN_s)).max() < 1e-12


@pytest.mark.parametrize("pulses", [[-0.001, 0.02], [0.05, 0.1001], [], "backwards"])
def test_pulses_outside_the_solution_are_refused(pulses: list[float] | str) -> None:
    epochs, at_s = (EPOCH_s[::-1], [0.05]) if pulses == "backwards" else (EPOCH_s, pulses)
    with pytest.raises(FitError, match="B-FIT-124"):
        positions_at(np.array(at_s), epochs, _position(epochs), _velocity(epochs))


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.75])
def test_a_step_of_acceleration_within_an_interval_costs_no_more_than_stated(share: float) -> None:
    """0.1 g within 5 ms: position and velocity at the ends as integrated by hand."""
    step_m_s2, interval_s = 0.981, 0.005
    after = np.linspace(0.0, interval_s, 501)
    truth = 0.5 * step_m_s2 * np.clip(after - share * interval_s, 0.0, None) ** 2
    position = np.array([[0.0, 0.0, 0.0], [truth[-1], 0.0, 0.0]])
    velocity = np.array([[0.0, 0.0, 0.0], [step_m_s2 * interval_s * (1.0 - share), 0.0, 0.0]])
    found = positions_at(after, np.array([0.0, interval_s]), position, velocity)[:, 0]
    assert np.abs(found - truth).max() <= step_m_s2 * interval_s**2 / 62.0


@pytest.mark.parametrize("bent_m", [0.0, 1.0])
def test_gates_and_backprojection_give_the_image_of_the_plain_sums(bent_m: float) -> None:
    """By pulses one by one to -66 dB of the peak; by blocks of pulses the same."""
    track_m = TRACK_m + bent_m * np.outer(EDGE**2, [0.0, 3.0, -2.0])
    image = focus_sums(sums_of(pulses(), track_m, np.mean(PIXELS_m, axis=0), 0.0), PIXELS_m)
    assert np.abs(image - by_sums(PIXELS_m, track_m)).max() < 5e-4
    if not bent_m:
        sums = sums_of(pulses(), TRACK_m, MIDDLE_m, 2.4)
        assert len(sums.fine) < 1100
        assert np.abs(focus_sums(sums, PIXELS_m) - image).max() < 5e-5


def test_a_window_of_gates_that_follows_the_range_changes_nothing() -> None:
    """The radar may open its gates later in the middle of the aperture."""
    one = pulses()
    later = np.where(np.abs(EDGE) < 0.5, 4, 0)
    gates = np.stack([np.roll(gate, -shift) for gate, shift in zip(one.gates, later, strict=True)])
    gates[later > 0, -4:] = 0.0
    followed = Pulses(gates, RADAR.near_range_m + 2.5 * later, 2.5, one.wavelength_m)
    expected, found = (focus_sums(sums_of(each, TRACK_m, MIDDLE_m, 2.4), NEAR_m) for each in (one, followed))
    assert np.abs(found - expected).max() < 1e-3


@pytest.mark.parametrize("centre", [28.0, 31.37, 35.5])
def test_values_between_gates_are_those_of_the_band_limited_pulse(centre: float) -> None:
    """5/6 of the gates' band is filled, as by 50 MHz in gates of 2.5 m."""
    band = 2.0 * 50e6 / 299_792_458.0 * 2.5
    gates = np.sinc((np.arange(64) - centre) * band).astype(np.complex64)[None]
    place = np.linspace(12.0, 51.0, 1234)[None]
    found = at_places(finer(gates * np.complex64(1j)), place)
    assert np.abs(found - 1j * np.sinc((place - centre) * band)).max() < 1e-3
    beyond = at_places(finer(np.ones((2, 64), np.complex64)), np.array([[-0.3, 63.2], [-400.0, 1e5]]))
    assert not beyond.any()


@pytest.mark.validates(
    "resolution and side lobes of a focused target along the track",
    against="closed form of an unweighted aperture: 0.2490 m, -13.26 dB, integrated ratio by quadrature",
)
def test_the_ideal_azimuth_response_is_that_of_the_closed_form(record_property: Keep) -> None:
    """The integrated ratio: sinc^2 beyond its first zeros and within 12 widths of 0.8859 against its main lobe."""
    main = integrate.quad(lambda x: np.sinc(x) ** 2, 0.0, 1.0)[0]
    side = integrate.quad(lambda x: np.sinc(x) ** 2, 1.0, 12.0 * 0.885893, limit=200)[0]
    response = focused(TRACK_m)
    cut = response.azimuth
    record_property("obtained", f"{cut.resolution_m:.4f} m, {cut.pslr_dB:.2f} dB, {cut.islr_dB:.2f} dB")
    assert cut.resolution_m == pytest.approx(0.885893 * AZIMUTH_ZERO_m, rel=1e-3)
    assert cut.resolution_m == pytest.approx(0.2490, rel=0.01)
    assert cut.pslr_dB == pytest.approx(-13.2615, abs=0.02)  # highest side lobe of sinc^2
    assert cut.islr_dB == pytest.approx(10.0 * np.log10(side / main), abs=0.03)
    assert response.peak == pytest.approx(1.0, abs=2e-4)
    assert abs(cut.shift_m) < 1e-4
    assert abs(response.range.shift_m) < 1e-3
    assert np.diff(cut.offset_m).max() <= 0.06 * 0.249
    assert np.abs(np.abs(cut.value) - np.abs(np.sinc(cut.offset_m / AZIMUTH_ZERO_m))).max() < 1e-3


@pytest.mark.validates(
    "response of a focused target in range",
    against="closed form of the band times the Fresnel integral of the aperture",
)
def test_the_ideal_range_response_is_that_of_the_closed_form() -> None:
    """Along the line of sight an image also defocuses in azimuth: mean of exp(-j k r theta^2 / 2) over the aperture."""
    response = focused(TRACK_m)
    assert response.range.resolution_m == pytest.approx(2.656, rel=0.01)
    cut = response.range
    bend = np.sqrt(4.0 * 9.6e9 / 299_792_458.0 * np.abs(cut.offset_m)) * 1250.0 / 45_000.0
    bend[bend == 0.0] = 1e-9
    sine, cosine = special.fresnel(bend)
    expected = np.abs(np.sinc(cut.offset_m / RANGE_ZERO_m)) * np.hypot(sine, cosine) / bend
    assert np.abs(np.abs(cut.value) - expected).max() < 1e-3
    assert response.range.pslr_dB == pytest.approx(-13.43, abs=0.03)


@pytest.mark.parametrize(
    ("error_m", "azimuth_m", "range_m", "within_m"),
    [
        *((ahead_m * ALONG, ahead_m, 0.0, 1e-4) for ahead_m in (2.5, -2.5, 15.0, -15.0)),
        (-3.425 * ALONG, -3.425, 0.0, 1e-4),  # 13.7 ms of lag, no whole number of samples
        *((np.outer(speed * PULSE_s, SIGHT), -180.0 * speed, None, 2e-3) for speed in (0.02, -0.02, 0.05)),
        (3.0 * SIGHT, 0.0, 3.0, 1e-3),
    ],
)
def test_the_image_moves_with_the_estimate(
    error_m: Array, azimuth_m: float, range_m: float | None, within_m: float
) -> None:
    """Ahead of the antenna = image ahead; a velocity along the line of sight by range over speed; sideways in range."""
    response = focused(TRACK_m + error_m)
    assert response.azimuth.shift_m == pytest.approx(azimuth_m, abs=within_m)
    if range_m is not None:
        assert response.range.shift_m == pytest.approx(range_m, abs=2e-3 if range_m else 1e-3)
    if range_m == 0.0:
        assert response.azimuth.pslr_dB == pytest.approx(-13.26, abs=0.02)


@pytest.mark.validates(
    "peak and side lobes of a response with a quadratic phase error",
    against="Fresnel integral of scipy",
)
@pytest.mark.parametrize("edge_rad", [np.pi / 4, np.pi / 2, 3 * np.pi / 4])
def test_a_quadratic_phase_error_does_what_the_fresnel_integral_says(edge_rad: float) -> None:
    response = spoilt(edge_rad * EDGE**2)
    place = response.azimuth.offset_m / AZIMUTH_ZERO_m

    def _closed(u: np.ndarray) -> np.ndarray:
        """|mean over -1..1 of exp(j (edge x^2 + pi u x))| by completing the square."""
        scale = np.sqrt(2.0 * edge_rad / np.pi)
        middle = np.pi * u / (2.0 * edge_rad)
        high, low = special.fresnel(scale * (1.0 + middle)), special.fresnel(scale * (middle - 1.0))
        return np.hypot(high[0] - low[0], high[1] - low[1]) / (2.0 * scale)

    # the peak moves in range, where the focus is a little better: 2 pi r theta^2 / lambda of the error at the edge
    edge_rad -= 2.0 * np.pi * response.range.shift_m * (1250.0 / 45_000.0) ** 2 * 9.6e9 / 299_792_458.0
    assert np.abs(np.abs(response.azimuth.value) - _closed(place)).max() < 2e-3


@pytest.mark.validates(
    "broadening of a response by quadratic phase errors",
    against="Cumming and Wong (2005), figure 3.14",
)
def test_quadratic_phase_errors_broaden_a_weighted_response_as_published() -> None:
    """Cumming and Wong (2005), figure 3.14: Kaiser window 2.5; 0.27, 0.41, 0.55 pi at the edge for 2, 5, 10 %."""
    weight = np.kaiser(len(EDGE), 2.5)
    sound = spoilt(0.0 * EDGE, weight).azimuth.resolution_m
    for share, broader in ((0.27, 0.02), (0.41, 0.05), (0.55, 0.10)):
        found = spoilt(share * np.pi * EDGE**2, weight).azimuth.resolution_m / sound - 1.0
        assert found == pytest.approx(broader, abs=0.003)


@pytest.mark.validates(
    "echoes of a response with a sinusoidal phase error",
    against="paired echoes of Klauder et al. (1960), Bessel functions of scipy",
)
def test_a_sinusoidal_phase_error_makes_paired_echoes() -> None:
    """Klauder et al. (1960): amplitude a, n cycles over the aperture: echoes J1(a) / J0(a) at n zeros' distance."""
    response = spoilt(0.6 * np.sin(2.0 * np.pi * 4.0 * EDGE))
    assert response.peak == pytest.approx(special.j0(0.6), abs=0.01)
    assert response.azimuth.pslr_dB == pytest.approx(20.0 * np.log10(special.j1(0.6) / special.j0(0.6)), abs=0.35)
    cut = response.azimuth
    outside = np.abs(cut.offset_m) > 1.2 * AZIMUTH_ZERO_m
    highest = cut.offset_m[outside][np.abs(cut.value[outside]).argmax()]
    assert abs(highest) == pytest.approx(8.0 * AZIMUTH_ZERO_m, abs=0.06)


def test_several_targets_are_measured_each_for_itself() -> None:
    for shift_m in (0.0, -8.2):
        for target in range(3):
            response = focused(TRACK_m + shift_m * ALONG, 3, target)
            assert response.azimuth.shift_m == pytest.approx(shift_m, abs=1e-3)
            assert response.azimuth.pslr_dB == pytest.approx(-13.26, abs=0.02)
            assert response.azimuth.islr_dB == pytest.approx(-10.12, abs=0.02)


def test_lost_pulses_leave_the_image_where_it_is() -> None:
    """1 % of the pulses, and 100 ms of them, are missing: the rest stand where navigation says."""
    kept = np.random.default_rng(8).random(len(PULSE_s)) > 0.01
    kept[3000:3100] = False
    one = pulses()
    gappy = Pulses(one.gates[kept], one.near_range_m, one.spacing_m, one.wavelength_m)
    response = impulse_response(gappy, TRACK_m[kept] - 2.5 * ALONG, MIDDLE_m)
    assert response.azimuth.shift_m == pytest.approx(-2.5, abs=1e-3)
    assert response.azimuth.pslr_dB == pytest.approx(-13.26, abs=0.5)


def test_the_chip_shows_the_target_where_the_response_says() -> None:
    chip = image_chip(pulses(), TRACK_m - 7.5 * ALONG, MIDDLE_m)
    row, column = np.unravel_index(np.abs(chip.value).argmax(), chip.value.shape)
    assert chip.value.shape == (len(chip.azimuth_m), len(chip.range_m))
    assert chip.azimuth_m[row] == pytest.approx(-7.5, abs=0.06)
    assert chip.range_m[column] == pytest.approx(0.0, abs=0.6)
    assert 0.8 < np.abs(chip.value).max() < 1.01


def test_positions_that_are_not_the_pulses_and_an_image_at_the_edge_of_the_search_are_refused() -> None:
    still, gap, far_m = np.repeat(TRACK_m[:1], len(TRACK_m), axis=0), TRACK_m.copy(), TRACK_m + 20.0 * ALONG
    gap[17] = np.nan
    for positions in (TRACK_m[:-1], still, gap):
        with pytest.raises(FitError, match="B-FIT-120"):
            impulse_response(pulses(), positions, MIDDLE_m)
    with pytest.raises(FitError, match=r"B-FIT-121.*\+1[78]\."):
        focused(far_m)
    found = impulse_response(pulses(), far_m, MIDDLE_m, (30.0, 12.0))
    assert found.azimuth.shift_m == pytest.approx(20.0, abs=1e-3)


def test_a_hann_weighted_line_has_its_known_figures() -> None:
    """Spectrum weighted by a Hann window: 1.44 bins wide instead of 0.89 (Harris 1978, table 1)."""
    x_m = cut_offsets(CELL_m)
    u = 0.885893 * x_m / CELL_m
    value = np.sinc(u) + 0.5 * np.sinc(u - 1.0) + 0.5 * np.sinc(u + 1.0)
    found = cut_of(0.0, x_m, value.astype(np.complex128), CELL_m)
    assert found.resolution_m / CELL_m == pytest.approx(1.44 / 0.8859, rel=0.01)
    # the windows stay those of the unweighted response: what the main lobe has outside counts as side lobe
    assert found.pslr_dB == pytest.approx(20.0 * np.log10(0.5), abs=0.1)  # (sinc(0) / 2 at the first zero)


def one_sided(side: float) -> Array:
    x_m = cut_offsets(CELL_m)
    return np.where(side * x_m > 0.0, np.exp(-np.abs(x_m) / CELL_m), 1.0)


@pytest.mark.parametrize("value", [np.ones(len(cut_offsets(CELL_m))), one_sided(-1.0), one_sided(1.0)])
def test_what_is_no_point_target_is_refused(value: Array) -> None:
    """Of the same power everywhere, or falling on one side only."""
    with pytest.raises(FitError, match="B-FIT-122"):
        cut_of(0.0, cut_offsets(CELL_m), value.astype(np.complex128), CELL_m)


def test_levels_are_decibels_against_a_reference_down_to_a_floor() -> None:
    value = np.array([[2.0, 0.2j], [0.0, -0.02244]], np.complex128)
    assert levels_dB(value, 2.0) == pytest.approx(np.array([[0.0, -20.0], [FLOOR_dB, -39.0]]), abs=1e-3)
    assert levels_dB(np.abs(value), 20.0) == pytest.approx(np.array([[-20.0, FLOOR_dB], [FLOOR_dB, FLOOR_dB]]))
