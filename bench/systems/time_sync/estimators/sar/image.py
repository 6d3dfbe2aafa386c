"""Radar images: where point targets stand in the pulses, and pieces of an image about a point, by backprojection.

Azimuth is along the track that navigation gives (first pulse to last); range is along the line of sight from the middle
of the aperture to the point, at a right angle to the track (slant plane). Errors are estimate - truth. Where the
positions are ahead of the antenna along the track, the image moves ahead by as much; a velocity error along the line of
sight from the antenna to the target moves it by -(R0 / v) times that error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from bench.maths.arrays import Floats
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.pulses import Pulses, Sums, at_places, finer, sums_of, turns

Complex128 = NDArray[np.complex128]

_HALF_RANGE_m = 20.0  # of a chip
_CELLS = 0.4  # step of the grid of a chip, in resolution cells
_LEAST_SHARE = 0.3  # of the highest magnitude
APART_m = (6.0, 12.0)  # in azimuth and range: less is the same target or its side lobes
_NOISE_RATIO = 8.0  # of the highest magnitude over the median
_ELEMENTS_AT_ONCE = 1 << 15  # pulses times pixels that stay in the processor's cache
BLOCK_PHASE_rad = 0.07  # over a block of pulses at the edge of a cut or chip: costs 0.002 dB there
FLOOR_dB = -40.0
_PULSES_AT_ONCE, _MOST_TARGETS = 500, 3


def point_targets(pulses: Pulses, positions_m: Floats) -> Floats:
    """Return places of the strongest point targets on level ground to the right of the track, before any image is made.

    Pulses turned in phase for the middle of the scene leave each target a tone along the track, whose frequency says
    how far ahead of the middle it stands, in the gate of its range. A straight flight cannot tell level ground from any
    other height.

    Args:    pulses.   positions_m: (n, 3) antenna at the pulses, north, east, down, which is 0 at the ground.
    Returns: (k, 3), three at the most, strongest first; good to a resolution cell or two.
    Raises:  FitError B-SYNC-010 if no target stands out of the noise.
    Source:  deramped polar format of a spotlight, Carrara, Goodman, Majewski, Spotlight Synthetic Aperture Radar
             (1995), chapter 3.
    """
    track = positions_m[-1] - positions_m[0]
    ahead = track / np.linalg.norm(track)
    right = np.cross([0.0, 0.0, 1.0], ahead)
    right /= np.linalg.norm(right)
    middle, gates = positions_m.mean(axis=0), pulses.gates.shape[1]
    near_m = np.broadcast_to(np.asarray(pulses.near_range_m, np.float64), len(positions_m))
    range_m = float(np.median(near_m)) + 0.5 * gates * pulses.spacing_m
    offsets_m = (np.arange(gates) - gates // 2) * pulses.spacing_m

    def place(azimuth_m: float, out_m: float) -> Floats:
        level_m = np.sqrt(max((range_m + out_m) ** 2 - middle[2] ** 2, 0.0))
        point = middle + azimuth_m * ahead + level_m * right
        point[2] = 0.0
        return np.asarray(point)

    reference_m = np.linalg.norm(positions_m - place(0.0, 0.0), axis=1)
    aligned = np.empty(pulses.gates.shape, np.complex128)
    for begin in range(0, len(aligned), _PULSES_AT_ONCE):
        some = slice(begin, begin + _PULSES_AT_ONCE)
        at = (reference_m[some, None] + offsets_m - near_m[some, None]) / pulses.spacing_m
        turned = turns(2.0 * reference_m[some] / pulses.wavelength_m)[:, None]
        aligned[some] = at_places(finer(pulses.gates[some]), at) * turned
    aligned *= signal.windows.hann(len(aligned))[:, None].astype(np.float32)
    picture = np.abs(np.fft.fftshift(np.fft.fft(aligned, axis=0), axes=0))
    step_m = float(np.linalg.norm(track)) / (len(positions_m) - 1)
    azimuth_m = np.fft.fftshift(np.fft.fftfreq(len(aligned), step_m)) * 0.5 * pulses.wavelength_m * range_m
    stands_out(picture, len(aligned))
    return np.array([place(*peak) for peak in peaks(picture, azimuth_m, offsets_m, _MOST_TARGETS)])


def stands_out(picture: Floats, pulses: int) -> None:
    """Check that the highest place of an image is no noise. Raises: FitError B-SYNC-010 if it is."""
    highest, floor = float(picture.max()), float(np.median(picture))
    if not highest > _NOISE_RATIO * floor:
        raise FitError(
            "B-SYNC-010",
            f"no point target stands out of the {pulses} pulses of the radar: the highest place of the image is "
            f"{highest / floor if floor else 0.0:.1f} times the median, {_NOISE_RATIO:g} times are due",
            next_step="see that the radar looked at the reflectors, and that it was on during straight flight",
        )


def peaks(
    picture: Floats, azimuth_m: Floats, out_m: Floats, most: int, apart_m: tuple[float, float] = APART_m
) -> list[tuple[float, float]]:
    """Return azimuth and range of the highest places, none of them beside a higher one."""
    left = picture.copy()
    found: list[tuple[float, float]] = []
    highest = float(left.max())
    while len(found) < most:
        row, column = np.unravel_index(int(np.argmax(left)), left.shape)
        if left[row, column] < _LEAST_SHARE * highest:
            break
        found.append((float(azimuth_m[row]), float(out_m[column])))
        beside = np.abs(azimuth_m - azimuth_m[row]) < apart_m[0]
        left[np.outer(beside, np.abs(out_m - out_m[column]) < apart_m[1])] = 0.0
    return found


def focus_sums(sums: Sums, pixels_m: Floats) -> Complex128:
    """Image of points near the sums' reference point.

    Args:    sums: of the pulses.   pixels_m: (q, 3).
    Returns: (q,), unit of the gates.
    Source:  Carrara, Goodman, Majewski, Spotlight Synthetic Aperture Radar (1995), appendix on backprojection.
    """
    offset = np.asarray(pixels_m, np.float64) - sums.reference_m
    offset_2 = np.einsum("ij,ij->i", offset, offset)
    from_reference = sums.positions_m - sums.reference_m
    reference_2 = np.einsum("ij,ij->i", from_reference, from_reference)
    reference_m = np.sqrt(reference_2)
    total = np.zeros(len(offset), np.complex128)
    rows = max(1, _ELEMENTS_AT_ONCE // len(offset))
    for begin in range(0, len(sums.fine), rows):
        some = slice(begin, begin + rows)
        range_2 = np.add.outer(reference_2[some], offset_2)
        for axis in range(3):  # no matrix product: one of three columns is slower on several threads than on one
            range_2 -= np.multiply.outer(from_reference[some, axis], 2.0 * offset[:, axis])
        range_m = np.sqrt(range_2)
        values = at_places(sums.fine[some], (range_m - sums.near_range_m[some, None]) * (1.0 / sums.spacing_m))
        values *= turns((range_m - reference_m[some, None]) * (2.0 / sums.wavelength_m), values.dtype)
        total += values.sum(axis=0)
    return total / sums.pulses


@dataclass(frozen=True)
class Axes:
    """Directions and cells of an image about a point.

    Attributes:
        origin_m: the point, (3,).   azimuth, sight: unit vectors of azimuth and range, (3,).
        azimuth_cell_m, range_cell_m: resolution (-3 dB) of the ideal response.
        range_m: from the middle of the aperture.   wavelength_m: of the carrier.
    """

    origin_m: Floats
    azimuth: Floats
    sight: Floats
    azimuth_cell_m: float
    range_cell_m: float
    range_m: float
    wavelength_m: float

    def points(self, azimuth_m: Floats | float, range_m: Floats | float) -> Floats:
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

    azimuth_m: Floats
    range_m: Floats
    value: Complex128


def image_axes(pulses: Pulses, positions_m: Floats, target_m: Floats) -> Axes:
    """Axes and cells of the image about a point.

    Args:    pulses.   positions_m: (n, 3) antenna at the pulses as navigation knows it.   target_m: (3,) surveyed.
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


def chip_of(sums: Sums, axes: Axes, azimuth_m: Floats, range_m: Floats) -> Chip:
    """Image on a grid of offsets from the axes' origin.

    Args:    sums: of pulses, about a point in the grid.   axes.   azimuth_m: (a,).   range_m: (r,).
    Source:  as `bench.systems.time_sync.estimators.sar.image.focus_sums`.
    """
    along, out = np.meshgrid(azimuth_m, range_m, indexing="ij")
    value = focus_sums(sums, axes.points(along.ravel(), out.ravel()))
    return Chip(azimuth_m, range_m, value.reshape(along.shape))


def image_chip(
    pulses: Pulses,
    positions_m: Floats,
    target_m: Floats,
    half_azimuth_m: float = 12.0,
) -> Chip:
    """Image about a surveyed point, as in the paper's figures 9 and 13.

    Args:    pulses.   positions_m: (n, 3).   target_m: (3,) middle of the chip.   half_azimuth_m: of the chip.
    Returns: Chip; offsets count from the target.
    Raises:  FitError B-FIT-120 if pulses and positions do not belong together or the antenna does not move.
    Source:  as `bench.systems.time_sync.estimators.sar.image.focus_sums`.
    """
    axes = image_axes(pulses, positions_m, target_m)
    block_m = axes.block_m(half_azimuth_m, 4 * BLOCK_PHASE_rad)
    sums = sums_of(pulses, positions_m, axes.origin_m, block_m, coarse=True)
    along = symmetric(half_azimuth_m, _CELLS * axes.azimuth_cell_m)
    return chip_of(sums, axes, along, symmetric(_HALF_RANGE_m, _CELLS * axes.range_cell_m))


def symmetric(half_m: float, step_m: float) -> Floats:
    """Return offsets at multiples of the step, as far as `half_m` on both sides of 0."""
    count = int(np.floor(half_m / step_m + 1e-9))
    return np.asarray(np.arange(-count, count + 1) * step_m)


def _check(pulses: Pulses, positions_m: Floats) -> None:
    finite = np.isfinite(positions_m).all()
    if positions_m.shape == (len(pulses.gates), 3) and finite and np.ptp(positions_m, axis=0).any():
        return
    raise FitError(
        "B-FIT-120",
        f"{len(pulses.gates)} pulses cannot be focused with positions of shape {positions_m.shape}"
        + (" that never change" if finite else ", some of which are not numbers"),
        next_step="give one position (north, east, down) of the moving antenna for each pulse",
    )


def levels_dB(value: Complex128 | Floats, reference: float) -> Floats:
    """Levels of a cut or a piece of an image: the paper's figures 8, 9, 12 and 13.

    Args:    value: of any shape, complex or its magnitude.   reference: magnitude that is 0 dB, > 0.
    Returns: decibels, of the shape of ``value``; what is below ``FLOOR_dB`` stands there.
    Source:  20 log10 of the magnitude.
    """
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(value) / reference, 10.0 ** (FLOOR_dB / 20.0))))
