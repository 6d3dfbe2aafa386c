"""Where point targets stand in the pulses of a radar that flies straight, before any image is made of them.

Pulses turned in phase for the middle of the scene leave each target a tone along the track, whose frequency says how
far ahead of the middle it stands, in the gate of its range.

Source: deramped polar format of a spotlight, Carrara, Goodman, Majewski, Spotlight Synthetic Aperture Radar (1995),
chapter 3; level ground assumed, which a straight flight cannot tell from any other height.
"""

from __future__ import annotations

import numpy as np
from scipy import signal

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.pulses import Array, Pulses, at_places, finer, turns

_LEAST_SHARE = 0.3  # of the highest magnitude
_APART = (6.0, 12.0)  # metres in azimuth and range: less is the same target or its side lobes
_NOISE_RATIO = 8.0  # of the highest magnitude over the median


def point_targets(pulses: Pulses, positions_m: Array, ground_down_m: float = 0.0, most: int = 3) -> Array:
    """Places of the strongest point targets on level ground to the right of the track.

    Args:    pulses.   positions_m: (n, 3) antenna at the pulses, north, east, down.   ground_down_m: of the ground.
             most: targets at most.
    Returns: (k, 3), strongest first; good to a resolution cell or two.
    Raises:  FitError B-SYNC-010 if no target stands out of the noise.
    Source:  see the head of this file.
    """
    track = positions_m[-1] - positions_m[0]
    ahead = track / np.linalg.norm(track)
    right = np.cross([0.0, 0.0, 1.0], ahead)
    right /= np.linalg.norm(right)
    middle, gates = positions_m.mean(axis=0), pulses.gates.shape[1]
    near_m = np.broadcast_to(np.asarray(pulses.near_range_m, np.float64), len(positions_m))
    range_m = float(np.median(near_m)) + 0.5 * gates * pulses.spacing_m
    offsets_m = (np.arange(gates) - gates // 2) * pulses.spacing_m

    def place(azimuth_m: float, out_m: float) -> Array:
        down_m = ground_down_m - middle[2]
        level_m = np.sqrt(max((range_m + out_m) ** 2 - down_m**2, 0.0))
        found = middle + azimuth_m * ahead + level_m * right
        found[2] = ground_down_m
        return np.asarray(found)

    reference_m = np.linalg.norm(positions_m - place(0.0, 0.0), axis=1)
    at = (reference_m[:, None] + offsets_m - near_m[:, None]) / pulses.spacing_m
    aligned = at_places(finer(pulses.gates), at) * turns(2.0 * reference_m / pulses.wavelength_m)[:, None]
    aligned *= signal.windows.hann(len(aligned))[:, None].astype(np.float32)
    picture = np.abs(np.fft.fftshift(np.fft.fft(aligned, axis=0), axes=0))
    step_m = float(np.linalg.norm(track)) / (len(positions_m) - 1)
    azimuth_m = np.fft.fftshift(np.fft.fftfreq(len(aligned), step_m)) * 0.5 * pulses.wavelength_m * range_m
    highest, floor = float(picture.max()), float(np.median(picture))
    if not highest > _NOISE_RATIO * floor:
        raise FitError(
            "B-SYNC-010",
            f"no point target stands out of the {len(aligned)} pulses of the radar: the highest place of the image is "
            f"{highest / floor if floor else 0.0:.1f} times the median, {_NOISE_RATIO:g} times are due",
            next_step="see that the radar looked at the reflectors, and that it was on during straight flight",
        )
    return np.array([place(*one) for one in _peaks(picture, azimuth_m, offsets_m, most)])


def _peaks(picture: Array, azimuth_m: Array, out_m: Array, most: int) -> list[tuple[float, float]]:
    """Azimuth and range of the highest places, none of them beside a higher one."""
    left = picture.copy()
    found: list[tuple[float, float]] = []
    highest = float(left.max())
    while len(found) < most:
        row, column = np.unravel_index(int(np.argmax(left)), left.shape)
        if left[row, column] < _LEAST_SHARE * highest:
            break
        found.append((float(azimuth_m[row]), float(out_m[column])))
        beside = np.abs(azimuth_m - azimuth_m[row]) < _APART[0]
        left[np.outer(beside, np.abs(out_m - out_m[column]) < _APART[1])] = 0.0
    return found
