"""Response of the radar and its navigation to a point target: where its image stands and how sharp it is.

Shifts are image - surveyed target along the axes of the image. They come from the focused image alone: neither the true
antenna positions nor a time offset enter.

Windows of a cut, the same for sound and for spoilt images: the main lobe reaches from the peak to where an ideal
response has its first zeros (1.1288 cells on either side), the side lobes from there to 12 cells. Both ratios use them.
Windows that follow the image's own minima would call a side lobe that has grown into the main lobe no side lobe at all;
as long as it has not, both give the same peak ratio within 0.015 dB. A cell is the resolution (-3 dB) of the ideal
response.

A radar's phase history, samples of each pulse over frequency, as pulses that can be focused, and its scene.

The phases refer to the origin of the coordinates, which lies on level ground in the middle of the scene: a scatterer at
range R gives -4 pi f (R - R0) / c, R0 from the antenna to the origin. Coordinates are right-handed with z up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from bench.maths.arrays import Floats
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.image import (
    Axes,
    Chip,
    Complex128,
    chip_of,
    focus_sums,
    image_axes,
    peaks,
    stands_out,
    symmetric,
)
from bench.systems.time_sync.estimators.sar.pulses import Pulses, SPEED_OF_LIGHT_m_s, sums_of, turns

ZERO_CELLS = 1.0 / 0.885893  # first zero of sin(pi x) / (pi x), in units of its -3 dB width
REACH_CELLS = 12.0
SEARCH_m = (18.0, 12.0)  # azimuth and range on both sides of the surveyed place
_COARSE_PHASE_rad = 1.2  # over a block of pulses at the search's edge: costs 0.5 dB there
_STEPS_CELLS = (0.6, 0.15, 0.05)  # of the grids on which the peak is looked for


@dataclass(frozen=True)
class Cut:
    """Line through the peak of the image of a point target.

    Attributes:
        shift_m: of the peak, image - surveyed place.   offset_m: from the peak, (q,), evenly spaced.   value: complex
        image, (q,), raw.   resolution_m: full width where the power is half of the peak's.   pslr_dB, islr_dB: with the
        windows above.
    """

    shift_m: float
    offset_m: Floats
    value: Complex128
    resolution_m: float
    pslr_dB: float
    islr_dB: float


def cut_offsets(cell_m: float) -> Floats:
    """Places of a cut: as far as the side lobe window and a little, in steps of 0.05 cell."""
    half = round((REACH_CELLS + 0.25) / 0.05)
    return np.asarray(np.arange(-half, half + 1) * (0.05 * cell_m))


def cut_of(shift_m: float, offset_m: Floats, value: Complex128, cell_m: float) -> Cut:
    """Return a cut with its resolution, PSLR and ISLR.

    Args:    as of ``Cut``, which must reach 12 cells on both sides of its peak.   cell_m: resolution of the ideal.
    Raises:  FitError B-FIT-122 if the power does not fall to half on both sides of the peak.
    Source:  Carrara, Goodman, Majewski (1995), section 8.3; windows stated above.
    """
    power = CubicSpline(offset_m / cell_m, np.abs(value) ** 2)
    peak = float(power(0.0))
    half = power.solve(0.5 * peak, extrapolate=False)
    if not (np.any(half < 0) and np.any(half > 0)):
        raise FitError(
            "B-FIT-122",
            "the image is no response of a point target: its power does not fall to half on both sides of the peak",
            next_step="look at the image chip: navigation within the aperture, and what stands near the target",
        )
    width = float(half[half > 0].min() - half[half < 0].max())
    main = float(power.integrate(-ZERO_CELLS, ZERO_CELLS))
    whole = float(power.integrate(-REACH_CELLS, REACH_CELLS))
    return Cut(
        shift_m,
        offset_m,
        value,
        resolution_m=width * cell_m,
        pslr_dB=10.0 * float(np.log10(_highest_side(power) / peak)),
        islr_dB=10.0 * float(np.log10((whole - main) / main)),
    )


def _highest_side(power: CubicSpline) -> float:
    """Return highest power in the side lobes' window."""
    level = power.derivative().roots(extrapolate=False)
    inside = level[(np.abs(level) >= ZERO_CELLS) & (np.abs(level) <= REACH_CELLS)]
    return float(power(np.append(inside, [-ZERO_CELLS, ZERO_CELLS])).max())


@dataclass(frozen=True)
class Response:
    """Response to a point target by its cuts in azimuth and range.

    Attributes: peak: magnitude; 1 for a target of amplitude 1 in perfect focus.
    """

    azimuth: Cut
    range: Cut
    peak: float

    @property
    def cuts(self) -> dict[str, Cut]:
        """Return both by their directions."""
        return {"azimuth": self.azimuth, "range": self.range}


def impulse_response(
    pulses: Pulses, positions_m: Floats, target_m: Floats, search_m: tuple[float, float] = SEARCH_m
) -> Response:
    """Response to one target, from its focused image.

    Another target of its strength must stand outside the search; 30 m away in azimuth and 12 m in range, or 60 m in
    azimuth alone, it changes the ratios by less than 0.02 dB. In range alone it stands in the range cut.

    Args:    pulses: of the aperture.   positions_m: (n, 3) antenna at the pulses as navigation knows it.
             target_m: (3,) surveyed.   search_m: half widths in azimuth and range in which the image is looked for.
    Raises:  FitError B-FIT-120 (positions are not those of the pulses), B-FIT-121 (highest place at the search's edge),
             B-FIT-122 (no response of a point target).
    Source:  quantities of the paper's figures 8, 10, 12 and 14; windows stated above.
    """
    axes = image_axes(pulses, positions_m, target_m)
    azimuth_m, range_m = _peak(pulses, positions_m, axes, search_m)
    along, out = cut_offsets(axes.azimuth_cell_m), cut_offsets(axes.range_cell_m)
    sums = sums_of(pulses, positions_m, axes.points(azimuth_m, range_m), axes.block_m(along[-1]))
    azimuth = focus_sums(sums, axes.points(azimuth_m + along, range_m + 0 * along))
    across = focus_sums(sums, axes.points(azimuth_m + 0 * out, range_m + out))
    return Response(
        cut_of(azimuth_m, along, azimuth, axes.azimuth_cell_m),
        cut_of(range_m, out, across, axes.range_cell_m),
        peak=float(np.abs(azimuth[len(along) // 2])),
    )


def _peak(pulses: Pulses, positions_m: Floats, axes: Axes, search_m: tuple[float, float]) -> tuple[float, float]:
    """Return offsets of the image's highest place: grids of smaller and smaller steps, then a paraboloid."""
    sums = sums_of(pulses, positions_m, axes.origin_m, axes.block_m(search_m[0], _COARSE_PHASE_rad), coarse=True)
    steps = _STEPS_CELLS[0] * np.array([axes.azimuth_cell_m, axes.range_cell_m])
    offsets_m = _highest(chip_of(sums, axes, symmetric(search_m[0], steps[0]), symmetric(search_m[1], steps[1])))
    if np.any(np.abs(offsets_m) > np.asarray(search_m) - 1.5 * steps):
        raise FitError(
            "B-FIT-121",
            f"the highest place of the image is at the edge of the search: {offsets_m[0]:+.1f} m in azimuth, "
            f"{offsets_m[1]:+.1f} m in range of {search_m[0]:.1f} m and {search_m[1]:.1f} m",
            next_step="look where the target and the navigation solution really are, or search farther",
        )
    sums = sums_of(pulses, positions_m, axes.points(*offsets_m), axes.block_m(axes.azimuth_cell_m * 4))
    for cells in _STEPS_CELLS[1:]:
        steps = cells * np.array([axes.azimuth_cell_m, axes.range_cell_m])
        chip = chip_of(
            sums, axes, offsets_m[0] + np.arange(-4, 5) * steps[0], offsets_m[1] + np.arange(-4, 5) * steps[1]
        )
        offsets_m = _highest(chip)
    around = np.arange(-1, 2)
    chip = chip_of(sums, axes, offsets_m[0] + around * steps[0], offsets_m[1] + around * steps[1])
    vertex = offsets_m + _vertex(np.abs(chip.value) ** 2) * steps
    return float(vertex[0]), float(vertex[1])


def _highest(chip: Chip) -> Floats:
    row, column = np.unravel_index(int(np.argmax(np.abs(chip.value))), chip.value.shape)
    return np.array([chip.azimuth_m[row], chip.range_m[column]])


def _vertex(power: Floats) -> Floats:
    """Return highest place, in steps from the middle, of the paraboloid through 3 by 3 values (least squares)."""
    x, y = (axis.ravel() for axis in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij"))
    design = np.stack([np.ones(9), x, y, x * x, x * y, y * y], axis=1)
    _, slope_x, slope_y, xx, xy, yy = np.linalg.lstsq(design, power.ravel())[0]
    return np.linalg.solve([[2 * xx, xy], [xy, 2 * yy]], [-slope_x, -slope_y])


WIDEST_deg = 10.0  # that the antenna goes about the scene: an image takes its track for nearly straight
_FEWEST = 16  # pulses, and samples of each
_FINER = 1.2  # gates over samples at the least: what lies between two gates is found by a kernel that needs it
_INSIDE = 0.9  # of what pulses and samples tell apart
_STEP_CELLS = 0.6  # of the picture of the scene: a peak between two pixels loses 1.2 dB
_APART_CELLS = 12.0  # as far as the side lobes of a response count
_SEARCH_CELLS = 3.0
_MOST = 3  # targets


@dataclass(frozen=True)
class Scene:
    """Picture of the ground about the origin, and the responses of its strongest points.

    Attributes:
        axes: of the picture; its range is along the ground, away from the radar.   chip: complex image.
        targets_m: (k, 3) where the strongest points stand, strongest first.   responses: of each, None for what is no
        point.   cells_m: resolution of the ideal response in azimuth and range.   background: root mean square of the
        magnitude beside them, unit of the samples.   angle_deg: that the antenna went about the scene.   cosine: of
        its elevation, slant range over range along the ground.
    """

    axes: Axes
    chip: Chip
    targets_m: Floats
    responses: tuple[Response | None, ...]
    cells_m: tuple[float, float]
    background: float
    angle_deg: float
    cosine: float


def compressed(samples: Complex128, positions_m: Floats, first_Hz: float, last_Hz: float) -> Pulses:
    """Return range-compressed pulses of a phase history.

    Args:    samples: (n, k) of pulses, at k even frequencies.   positions_m: (n, 3) antenna.   first_Hz, last_Hz: of
             the samples, the last above the first.
    Returns: Pulses with gates about the range of the origin, as wide as the spacing of the frequencies tells apart.
    Raises:  FitError B-SYNC-013 for fewer than 16 pulses or samples.
    Source:  Carrara, Goodman, Majewski, Spotlight Synthetic Aperture Radar (1995), section 2.6 (dechirped samples).
    """
    count, length = samples.shape
    if min(count, length) < _FEWEST:
        raise _no_history(f"it has {count} whole pulses of {length} samples, {_FEWEST} of either are the least")
    step_Hz = (last_Hz - first_Hz) / (length - 1)
    wavelength_m = SPEED_OF_LIGHT_m_s / (0.5 * (first_Hz + last_Hz))
    gates = 1 << int(np.ceil(np.log2(_FINER * length)))
    at = np.arange(gates) - gates // 2
    profiles = np.fft.fftshift(np.fft.ifft(samples, gates, axis=1), axes=1) * (gates / length)
    origin_m = np.linalg.norm(positions_m, axis=1)
    carried = turns(-0.5 * (length - 1) / gates * at) * turns(-2.0 * origin_m / wavelength_m)[:, None]
    spacing_m = SPEED_OF_LIGHT_m_s / (2.0 * gates * step_Hz)
    return Pulses(profiles * carried, origin_m + at[0] * spacing_m, spacing_m, wavelength_m, length * step_Hz)


def scene_of(pulses: Pulses, positions_m: Floats) -> Scene:
    """Return the picture of the ground and its strongest points.

    Args:    pulses: as ``compressed`` makes them.   positions_m: (n, 3) antenna, z up, origin on the ground.
    Raises:  FitError B-FIT-120 (the antenna does not move), B-SYNC-010 (no point stands out), B-SYNC-013 (the antenna
             goes more than 10 deg about the scene, or is not above and beside it).
    Source:  backprojection as `bench.systems.time_sync.estimators.sar.image.focus_sums`.
    """
    slant = image_axes(pulses, positions_m, np.zeros(3))
    level = slant.sight * [1.0, 1.0, 0.0]
    cosine = float(np.linalg.norm(level))
    ends = positions_m[[0, -1]] / np.linalg.norm(positions_m[[0, -1]], axis=1)[:, None]
    angle_deg = float(np.degrees(np.arccos(np.clip(ends[0] @ ends[1], -1.0, 1.0))))
    if angle_deg > WIDEST_deg or not 0.1 < cosine < 1.0:
        raise _no_history(
            f"the antenna goes {angle_deg:.2f} deg about the origin, {np.degrees(np.arccos(min(cosine, 1.0))):.1f} deg "
            f"above the ground; {WIDEST_deg:g} deg at most and an antenna above and beside the scene are due"
        )
    axes = replace(slant, sight=level / cosine)
    chip = _picture(pulses, positions_m, axes, cosine)
    magnitude = np.abs(chip.value)
    stands_out(magnitude, len(positions_m))
    cells_m = slant.azimuth_cell_m, slant.range_cell_m
    apart_m = _APART_CELLS * cells_m[0], _APART_CELLS * cells_m[1] / cosine
    found = peaks(magnitude, chip.azimuth_m, chip.range_m, _MOST, apart_m)
    targets_m = np.array([axes.points(*peak) for peak in found])
    search_m = _SEARCH_CELLS * cells_m[0], _SEARCH_CELLS * cells_m[1]
    responses = tuple(_response(pulses, positions_m, target_m, search_m) for target_m in targets_m)
    background = float(np.median(magnitude)) / np.sqrt(np.log(2.0))  # Rayleigh: half of it lies below
    return Scene(axes, chip, targets_m, responses, cells_m, float(background), angle_deg, cosine)


def _picture(pulses: Pulses, positions_m: Floats, axes: Axes, cosine: float) -> Chip:
    """Return the image of the ground about the origin, as far as it is told apart in range and along the track."""
    out_m = 0.5 * _INSIDE * pulses.gates.shape[1] * pulses.spacing_m / cosine
    step_m = float(np.linalg.norm(positions_m[-1] - positions_m[0])) / (len(positions_m) - 1)
    along_m = min(0.25 * _INSIDE * pulses.wavelength_m * axes.range_m / step_m, out_m)
    sums = sums_of(pulses, positions_m, axes.origin_m, 0.0)
    along = symmetric(along_m, _STEP_CELLS * axes.azimuth_cell_m)
    return chip_of(sums, axes, along, symmetric(out_m, _STEP_CELLS * axes.range_cell_m / cosine))


def _response(pulses: Pulses, positions_m: Floats, target_m: Floats, search_m: tuple[float, float]) -> Response | None:
    try:
        return impulse_response(pulses, positions_m, target_m, search_m)
    except FitError as error:
        if error.code not in ("B-FIT-121", "B-FIT-122"):
            raise
        return None


def _no_history(why: str) -> FitError:
    return FitError(
        "B-SYNC-013",
        f"the log is no phase history that an image can be made of: {why}",
        next_step="see the section on phase histories of docs/importing.md; import a part of a long one",
    )
