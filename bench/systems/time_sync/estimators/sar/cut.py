"""What a cut through a point target's image says: resolution, peak and integrated side lobe ratios.

Windows, the same for sound and for spoilt images: the main lobe reaches from the peak to where an ideal response has
its first zeros (1.1288 cells on either side), the side lobes from there to 12 cells. Both ratios use them. Windows that
follow the image's own minima would call a side lobe that has grown into the main lobe no side lobe at all; as long as
it has not, both give the same peak ratio within 0.015 dB. A cell is the resolution (-3 dB) of the ideal response.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.focus import Complex128
from bench.systems.time_sync.estimators.sar.pulses import Array

ZERO_CELLS = 1.0 / 0.885893  # first zero of sin(pi x) / (pi x), in units of its -3 dB width
REACH_CELLS = 12.0


@dataclass(frozen=True)
class Cut:
    """Line through the image of a point target.

    Attributes:
        offset_m: from the peak, (q,), evenly spaced.   value: complex image, (q,).   cell_m: resolution of the ideal.
    """

    offset_m: Array
    value: Complex128
    cell_m: float


@dataclass(frozen=True)
class CutFigures:
    """Figures of a cut.

    Attributes:
        resolution_m: full width where the power is half of the peak's.   pslr_dB, islr_dB: with the windows above.
    """

    resolution_m: float
    pslr_dB: float
    islr_dB: float


def cut_offsets(cell_m: float) -> Array:
    """Places of a cut: as far as the side lobe window and a little, in steps of 0.05 cell."""
    half = round((REACH_CELLS + 0.25) / 0.05)
    return np.asarray(np.arange(-half, half + 1) * (0.05 * cell_m))


def cut_figures(cut: Cut) -> CutFigures:
    """Resolution, PSLR and ISLR of a cut through a peak.

    Args:    cut: that reaches 12 cells on both sides of its peak, which is at offset 0.
    Returns: CutFigures.
    Raises:  FitError B-FIT-122 if the power does not fall to half on both sides of the peak.
    Source:  Carrara, Goodman, Majewski (1995), section 8.3; windows stated above.
    """
    x = cut.offset_m / cut.cell_m
    power = CubicSpline(x, np.abs(cut.value) ** 2)
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
    return CutFigures(
        resolution_m=width * cut.cell_m,
        pslr_dB=10.0 * float(np.log10(_highest_side(power) / peak)),
        islr_dB=10.0 * float(np.log10((whole - main) / main)),
    )


def _highest_side(power: CubicSpline) -> float:
    """Return highest power in the side lobes' window."""
    level = power.derivative().roots(extrapolate=False)
    inside = level[(np.abs(level) >= ZERO_CELLS) & (np.abs(level) <= REACH_CELLS)]
    return float(power(np.append(inside, [-ZERO_CELLS, ZERO_CELLS])).max())
