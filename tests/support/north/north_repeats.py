"""North from repeats: the mean of phasors, never of angles, and its scatter across their direction.

Source: K. V. Mardia, P. E. Jupp, Directional Statistics, sections 1.3 and 2.2 (why angles are not averaged); JCGM
100:2008 sections 4.2 and G.3 (mean of repeats and Student's t).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bench.maths.arrays import Floats
from bench.systems.north.estimators.phasors import Complex, angle_deg, half_width_deg

FEWEST = 2


@dataclass(frozen=True)
class MeanNorth:
    """Mean of repeats, arrays of the shape of one repeat, (...).

    Attributes:
        phi_deg: -180 (excluded) to 180.   std_deg: of the mean, ``dof`` = repeats - 1 degrees of freedom.
        scatter_deg: standard deviation of one repeat.   phasor: mean phasor.   repeats: their number.
    """

    phi_deg: Floats
    std_deg: Floats
    dof: float
    scatter_deg: Floats
    phasor: Complex
    repeats: int

    @property
    def amplitude(self) -> Floats:
        """Length of the mean phasor."""
        return np.asarray(np.abs(self.phasor))

    def half_width_deg(self, probability: float = 0.95) -> Floats:
        """Half the interval that covers phi with this probability, degrees; Student's t for few repeats."""
        return half_width_deg(self.std_deg, self.dof, probability)


def average_north(phasors: ArrayLike) -> MeanNorth:
    """Mean direction of repeated phasors of one azimuth.

    Args:    phasors: of any method, (repeats, ...), at least two repeats; NaN makes its column NaN.
    Returns: MeanNorth; the scatter is of the components across the mean, so changes of amplitude do not enter.
    Raises:  ValueError for fewer than two repeats.
    Source:  see the head of this file.
    """
    each = np.asarray(phasors, np.complex128)
    repeats = len(each) if each.ndim else 1
    if repeats < FEWEST:
        raise ValueError(f"{repeats} repeat of a north finding has no scatter (at least {FEWEST})")
    mean = each.mean(0)
    length = np.abs(mean)
    with np.errstate(divide="ignore", invalid="ignore"):
        across = (each * np.conj(mean)).imag / length**2
        scatter_deg = np.rad2deg(np.sqrt(np.square(across).sum(0) / (repeats - 1)))
    return MeanNorth(
        phi_deg=angle_deg(mean),
        std_deg=np.asarray(scatter_deg / np.sqrt(repeats)),
        dof=repeats - 1.0,
        scatter_deg=np.asarray(scatter_deg),
        phasor=mean,
        repeats=repeats,
    )
