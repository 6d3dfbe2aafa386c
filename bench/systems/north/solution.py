"""North as it was found: azimuths of all sets by every method, their errors where the azimuth is known, their means.

Calibration, test and search are different sets: an error is never evaluated on the noise that calibrated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Floats
from bench.systems.north.estimators.eight_samples import IndexCalibration
from bench.systems.north.estimators.likelihood import LikelihoodNorth
from bench.systems.north.estimators.phasors import tilt_std_deg, wrapped_deg
from bench.systems.north.sets import SEARCH, TEST, NorthSet

Flags = NDArray[np.bool_]
LEAST_SQUARES, LIKELIHOOD, QUADRANT, LITERAL = "least_squares", "likelihood", "quadrant", "literal"
METHODS: tuple[str, ...] = (LEAST_SQUARES, LIKELIHOOD, QUADRANT, LITERAL)


@dataclass(frozen=True)
class Azimuths:
    """Headings of the sensing axis at encoder zero by one method.

    ``azimuth_deg``: (n,) for n sets, (-180, 180], NaN where there is none.   ``noise_deg``: standard uncertainty of one
    of them by noise, with ``dof`` degrees of freedom.   ``common_deg``: what all of them share, by the calibration,
    with ``common_dof``.   ``calibration``: its variance over that of the noise of one set by least squares, as the
    calibration was planned; 0 where the method's own errors say more than noise does.
    """

    azimuth_deg: Floats
    noise_deg: float
    dof: float
    common_deg: float = 0.0
    common_dof: float = math.inf
    calibration: float = 0.0

    def dof_of_mean(self, n: int) -> float:
        """Effective degrees of freedom of a mean of ``n``. Source: JCGM 100:2008, equation (G.2b)."""
        if self.common_dof == self.dof:  # both of one estimate of the noise
            return self.dof
        parts = ((self.noise_deg / math.sqrt(n), self.dof), (self.common_deg, self.common_dof))
        whole = sum(std**2 for std, _ in parts) ** 2
        share = sum(std**4 / dof for std, dof in parts)
        return whole / share if share > 0.0 else math.inf


@dataclass(frozen=True)
class Site:
    """Where the bench stands; ``azimuth_deg`` of the sensing axis at encoder zero with the dividing head at 0.

    ``azimuth_std_deg``, ``tilt_std_deg``: standard uncertainties, 0 where nobody states them.
    """

    latitude_deg: float
    azimuth_deg: float
    azimuth_std_deg: float = 0.0
    tilt_std_deg: float = 0.0


@dataclass(frozen=True)
class Mean:
    """Phasor mean over ``n`` repeats of a heading by one method, degrees; errors NaN where the azimuth is not known."""

    item: str
    place: str
    head_deg: float
    parameters: str
    azimuth_deg: float
    std_deg: float
    error_deg: float
    error_std_deg: float
    n: int
    dropped: int
    dof: float


@dataclass
class Solution:
    """Everything found of ``sets``, (n,) arrays beside them.

    ``known_deg``: stated azimuth, NaN for a search.   ``tilt_deg``: correction that was added.   ``good``: eight
    samples that can be used.   ``u1_V``, ``u2_V``: (n, 4), as a table that turns counter-clockwise would give them.
    ``calibrations``: by sense of rotation.   ``raw``: fits of the waveforms.   ``failures``: of the literal formulas,
    by name, (n,) counts.   ``swing_deg``: RMS of the table about a steady rotation: where its period fits the turn, the
    index passes early or late by as much, and otherwise after each start.   ``unsteady``: the amplitude changes
    between index positions, so that the noise of least squares is that across the signal alone.
    """

    sets: Sequence[NorthSet]
    site: Site
    known_deg: Floats
    tilt_deg: Floats
    good: Flags
    u1_V: Floats
    u2_V: Floats
    raw: Sequence[LikelihoodNorth | None] = ()
    swing_deg: float = 0.0
    unsteady: bool = False
    calibrations: Mapping[int, IndexCalibration] = field(default_factory=dict)
    by_method: dict[str, Azimuths] = field(default_factory=dict)
    failures: Mapping[str, Floats] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)

    def of(self, item: str) -> Flags:
        """(n,) sets of an item."""
        return np.array([north_set.item == item for north_set in self.sets])

    def with_parameters(self, kind: str) -> Flags:
        """(n,) sets with parameters of a kind."""
        return np.array([north_set.parameters == kind for north_set in self.sets])

    @property
    def kinds(self) -> list[str]:
        """Kinds of parameters of the tests, in their order; [""] where the sequence names none."""
        return list(dict.fromkeys(north_set.parameters for north_set in self.sets if north_set.item == TEST)) or [""]

    @property
    def sense(self) -> NDArray[np.int64]:
        """(n,) +1 counter-clockwise, -1 clockwise."""
        return np.array([north_set.sense for north_set in self.sets])

    @property
    def bound_deg(self) -> Floats:
        """(n,) Cramer-Rao bound of each set by the samples of its records, degrees, NaN without them."""
        return np.array([math.nan if waveform is None else float(waveform.bound_deg) for waveform in self.raw])

    @property
    def placed_deg(self) -> float:
        """Standard uncertainty of the index placement beside noise: azimuth of the mark, tilt, swing, degrees."""
        return math.hypot(self.site.azimuth_std_deg, self.tilted_deg, self.swing_deg)

    @property
    def tilted_deg(self) -> float:
        """Standard uncertainty of an azimuth by that of the tilt, degrees."""
        return tilt_std_deg(1e3 * math.radians(self.site.tilt_std_deg), self.site.latitude_deg)

    def error_deg(self, method: str) -> Floats:
        """(n,) azimuth minus stated azimuth of the tests, folded into (-180, 180], NaN elsewhere."""
        error_deg = np.asarray(wrapped_deg(self.by_method[method].azimuth_deg - self.known_deg))
        return np.where(self.of(TEST), error_deg, math.nan)

    def means(self, method: str) -> list[Mean]:
        """Tests and searches by this method, repeats of a heading together, in their order."""
        groups = dict.fromkeys(north_set.group for north_set in self.sets if north_set.item in (TEST, SEARCH))
        return [mean for group in groups if (mean := self._mean(method, *group)) is not None]

    def _mean(self, method: str, item: str, place: str, head_deg: float, parameters: str) -> Mean | None:
        group = item, place, head_deg, parameters
        own = np.array([north_set.group == group for north_set in self.sets])
        azimuths = self.by_method[method]
        azimuth_deg = azimuths.azimuth_deg[own & np.isfinite(azimuths.azimuth_deg)]
        if not azimuth_deg.size:
            return None
        mean_deg = float(np.rad2deg(np.angle(np.mean(np.exp(1j * np.deg2rad(azimuth_deg))))))
        swing_deg = 0.0 if method == LIKELIHOOD else self.swing_deg * math.sqrt(2.0 if self.calibrations else 1.0)
        own_deg = math.hypot(
            azimuths.noise_deg / math.sqrt(azimuth_deg.size), azimuths.common_deg, self.tilted_deg, swing_deg
        )
        known_deg = float(self.known_deg[own][0])
        # what the mark calibrates carries its uncertainty; an error against the mark does so where it does not
        by_mark, beside_mark = (self.site.azimuth_std_deg, 0.0) if method != LIKELIHOOD and self.calibrations else (
            0.0, self.site.azimuth_std_deg)  # fmt: skip
        return Mean(
            item=item,
            place=place,
            head_deg=head_deg,
            parameters=parameters,
            azimuth_deg=mean_deg,
            std_deg=math.hypot(own_deg, by_mark),
            error_deg=float(wrapped_deg(mean_deg - known_deg)),
            error_std_deg=math.hypot(own_deg, beside_mark),
            n=azimuth_deg.size,
            dropped=int(own.sum()) - azimuth_deg.size,
            dof=azimuths.dof_of_mean(azimuth_deg.size),
        )

    def rms_deg(self, method: str) -> float:
        """Root mean square of the errors of single sets at the known azimuths, degrees; NaN without any."""
        error_deg = self.error_deg(method)
        seen = error_deg[np.isfinite(error_deg)]
        return float(np.sqrt(np.mean(seen**2))) if seen.size else math.nan
