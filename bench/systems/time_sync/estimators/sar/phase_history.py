"""A radar's phase history, samples of each pulse over frequency, as pulses that can be focused, and its scene.

The phases refer to the origin of the coordinates, which lies on level ground in the middle of the scene: a scatterer at
range R gives -4 pi f (R - R0) / c, R0 from the antenna to the origin. Coordinates are right-handed with z up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.maths.arrays import Floats
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.image import (
    Axes,
    Chip,
    Complex128,
    chip_of,
    image_axes,
    peaks,
    stands_out,
    symmetric,
)
from bench.systems.time_sync.estimators.sar.pulses import Pulses, SPEED_OF_LIGHT_m_s, sums_of, turns
from bench.systems.time_sync.estimators.sar.response import Response, impulse_response

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
