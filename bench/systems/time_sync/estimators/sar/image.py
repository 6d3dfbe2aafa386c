"""Axes and pieces of a radar image about a surveyed point.

Azimuth is along the track that navigation gives (first pulse to last); range is along the line of sight from the middle
of the aperture to the point, at a right angle to the track (slant plane).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.focus import Complex128, focus_sums
from bench.systems.time_sync.estimators.sar.pulses import Array, Pulses, Sums, sums_of

BLOCK_PHASE_rad = 0.07  # over a block of pulses at the edge of a cut or chip: costs 0.002 dB there
FLOOR_dB = -80.0


@dataclass(frozen=True)
class Axes:
    """Directions and cells of an image about a point.

    Attributes:
        origin_m: the point, (3,).   azimuth, sight: unit vectors of azimuth and range, (3,).
        azimuth_cell_m, range_cell_m: resolution (-3 dB) of the ideal response.
        range_m: from the middle of the aperture.   wavelength_m: of the carrier.
    """

    origin_m: Array
    azimuth: Array
    sight: Array
    azimuth_cell_m: float
    range_cell_m: float
    range_m: float
    wavelength_m: float

    def points(self, azimuth_m: Array | float, range_m: Array | float) -> Array:
        """Return points (..., 3) at offsets from the origin."""
        out = np.multiply.outer(azimuth_m, self.azimuth) + np.multiply.outer(range_m, self.sight)
        return np.asarray(self.origin_m + out)

    def block_m(self, reach_m: float, phase_rad: float = BLOCK_PHASE_rad) -> float:
        """Return length of a block of pulses over which a point `reach_m` away in azimuth turns by `phase_rad`."""
        return phase_rad * self.wavelength_m * self.range_m / (4.0 * np.pi * reach_m)


@dataclass(frozen=True)
class Chip:
    """Piece of an image.

    Attributes:
        azimuth_m: offsets, (a,).   range_m: offsets, (r,).   value: complex image, (a, r).
    """

    azimuth_m: Array
    range_m: Array
    value: Complex128


def image_axes(pulses: Pulses, positions_m: Array, target_m: Array) -> Axes:
    """Axes and cells of the image about a point.

    Args:    pulses.   positions_m: (n, 3) antenna at the pulses as navigation knows it.   target_m: (3,) surveyed.
    Returns: Axes.
    Raises:  FitError B-FIT-120 if pulses and positions do not belong together or the antenna does not move.
    Source:  cells 0.8859 lambda / (2 (sin theta_last - sin theta_first)) and 0.8859 c / 2B of unweighted spectra.
    """
    _check(pulses, positions_m)
    track = positions_m[-1] - positions_m[0]
    azimuth = track / np.linalg.norm(track)
    sight = target_m - positions_m.mean(axis=0)
    across = sight - (sight @ azimuth) * azimuth
    ends = positions_m[[0, -1]] - target_m
    sines = ends @ azimuth / np.linalg.norm(ends, axis=1)
    lit = abs(sines[1] - sines[0]) * len(positions_m) / (len(positions_m) - 1)
    return Axes(
        origin_m=np.asarray(target_m, np.float64),
        azimuth=azimuth,
        sight=across / np.linalg.norm(across),
        azimuth_cell_m=float(0.885893 * pulses.wavelength_m / (2.0 * lit)),
        range_cell_m=pulses.range_cell_m,
        range_m=float(np.linalg.norm(sight)),
        wavelength_m=pulses.wavelength_m,
    )


def chip_of(sums: Sums, axes: Axes, azimuth_m: Array, range_m: Array) -> Chip:
    """Image on a grid of offsets from the axes' origin.

    Args:    sums: of pulses, about a point in the grid.   axes.   azimuth_m: (a,).   range_m: (r,).
    Returns: Chip.
    Source:  as `bench.systems.time_sync.estimators.sar.focus.focus_sums`.
    """
    along, out = np.meshgrid(azimuth_m, range_m, indexing="ij")
    value = focus_sums(sums, axes.points(along.ravel(), out.ravel()))
    return Chip(azimuth_m, range_m, value.reshape(along.shape))


def image_chip(
    pulses: Pulses,
    positions_m: Array,
    target_m: Array,
    half_azimuth_m: float = 12.0,
    half_range_m: float = 20.0,
    cells: float = 0.4,
) -> Chip:
    """Image about a surveyed point, as in the paper's figures 9 and 13.

    Args:    pulses.   positions_m: (n, 3).   target_m: (3,) middle of the chip.   half_azimuth_m, half_range_m: of the
             chip.   cells: step of the grid in resolution cells.
    Returns: Chip; offsets count from the target.
    Raises:  FitError B-FIT-120 if pulses and positions do not belong together or the antenna does not move.
    Source:  as `bench.systems.time_sync.estimators.sar.focus.focus_sums`.
    """
    axes = image_axes(pulses, positions_m, target_m)
    block_m = axes.block_m(half_azimuth_m, 4 * BLOCK_PHASE_rad)
    sums = sums_of(pulses, positions_m, axes.origin_m, block_m, coarse=True)
    along = symmetric(half_azimuth_m, cells * axes.azimuth_cell_m)
    return chip_of(sums, axes, along, symmetric(half_range_m, cells * axes.range_cell_m))


def symmetric(half_m: float, step_m: float) -> Array:
    """Return offsets at multiples of the step, as far as `half_m` on both sides of 0."""
    count = int(np.floor(half_m / step_m + 1e-9))
    return np.asarray(np.arange(-count, count + 1) * step_m)


def _check(pulses: Pulses, positions_m: Array) -> None:
    finite = np.isfinite(positions_m).all()
    if positions_m.shape == (len(pulses.gates), 3) and finite and np.ptp(positions_m, axis=0).any():
        return
    raise FitError(
        "B-FIT-120",
        f"{len(pulses.gates)} pulses cannot be focused with positions of shape {positions_m.shape}"
        + (" that never change" if finite else ", some of which are not numbers"),
        next_step="give one position (north, east, down) of the moving antenna for each pulse",
    )


def levels_dB(value: Complex128 | Array, reference: float, floor_dB: float = FLOOR_dB) -> Array:
    """Levels of a cut or a piece of an image: the paper's figures 8, 9, 12 and 13.

    Args:    value: of any shape, complex or its magnitude.   reference: magnitude that is 0 dB, > 0.   floor_dB: what
             is lower is drawn there.
    Returns: decibels, of the shape of ``value``.
    Source:  20 log10 of the magnitude.
    """
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(value) / reference, 10.0 ** (floor_dB / 20.0))))
