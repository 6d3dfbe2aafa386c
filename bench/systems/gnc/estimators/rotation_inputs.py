"""Everything the calibration of gyroscopes by turns depends on, as one vector with a covariance.

Source: JCGM 102:2011 section 6.2 (input quantities and their covariance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.systems.gnc.estimators.earth_rate import Site, earth_rate_local_deg_s, table_to_local
from bench.systems.gnc.estimators.turning import Turn

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Declared:
    """Standard uncertainties: ``turn_std_deg`` of each turn, ``tilt_std_deg`` of the axis of turn against the body axis
    (each of two directions, common to forth and back), ``resolution_deg_s`` step of the output, ``drift_deg_s`` by
    which the bias wanders from record to record, ``time_std`` of all durations together, relative.
    """

    turn_std_deg: float = 0.0
    tilt_std_deg: float = 0.0
    resolution_deg_s: float = 0.0
    drift_deg_s: float = 0.0
    time_std: float = 0.0


@dataclass(frozen=True)
class Inputs:
    """Per part of a record: ``integral`` (r, 3) deg, ``known`` (r, 3) deg, ``seen`` (r, 3, 3) s, ``duration_s`` and
    ``rest_s`` (r,), ``record`` (r,) number of the record it belongs to.   ``local`` (2,): latitude and azimuth in
    degrees; ``seen`` is zero where there is no Earth's rate to compensate.
    """

    integral: Array
    known: Array
    seen: Array
    duration_s: Array
    rest_s: Array
    record: NDArray[np.intp]
    local: Array

    @staticmethod
    def of(records: Sequence[Sequence[Turn]], site: Site | None) -> Inputs:
        """From the parts of each record; without a site the Earth's rate is left in."""
        turns = [turn for parts in records for turn in parts]
        return Inputs(
            integral=np.stack([turn.integral for turn in turns]),
            known=np.stack([turn.known for turn in turns]),
            seen=np.stack([turn.seen for turn in turns]) * (site is not None),
            duration_s=np.array([turn.duration_s for turn in turns]),
            rest_s=np.array([turn.rest_s for turn in turns]),
            record=np.repeat(np.arange(len(records)), [len(parts) for parts in records]),
            local=np.array([site.latitude_deg, site.azimuth_deg] if site else [0.0, 0.0]),
        )

    @property
    def earth(self) -> Array:
        """Integral of the Earth's rate over each record in body axes, (r, 3), deg."""
        site = Site(float(self.local[0]), float(self.local[1]))
        return np.asarray(self.seen @ (table_to_local(site).T @ earth_rate_local_deg_s(site.latitude_deg)))

    @property
    def vector(self) -> Array:
        """Integrals, relative error of each turn, tilt (3 each) of the turns about x, y, z, latitude and azimuth."""
        return np.concatenate([self.integral.ravel(), np.zeros(len(self.known) + 9), self.local])

    def at(self, vector: Array) -> Inputs:
        """Return the same with the values of a vector."""
        count = len(self.known)
        turn, tilt = vector[3 * count : 4 * count], vector[4 * count : 4 * count + 9].reshape(3, 3)
        about = tilt[np.argmax(np.abs(self.known), axis=1)]
        known = self.known * (1.0 + turn[:, None])
        one, two = known[:, [1, 2, 0]], known[:, [2, 0, 1]]  # numpy's cross takes longer than the fit
        known = known + about[:, [1, 2, 0]] * two - about[:, [2, 0, 1]] * one
        return replace(self, integral=vector[: 3 * count].reshape(count, 3), known=known, local=vector[-2:])

    def covariance(self, declared: Declared, site: Site | None, density: Array, common: Array) -> Array:
        """Of ``vector``: white noise ``density`` (3, 3) deg^2/s, ``common`` (3, 3) (deg/s)^2 to all rests."""
        count, length = len(self.known), self.duration_s
        covariance = np.zeros((4 * count + 11,) * 2)
        together = np.outer(length, length) * (self.record[:, None] == self.record)
        covariance[: 3 * count, : 3 * count] = (
            np.kron(np.diag(length), density)
            + np.kron(np.outer(self.rest_s, self.rest_s), common)
            + np.kron(together, np.eye(3) * declared.drift_deg_s**2)
        )
        size = np.linalg.norm(self.known, axis=1)
        turn = np.where(size > 0.0, declared.turn_std_deg / np.where(size > 0.0, size, 1.0), 0.0)
        rest = [*turn, *[np.radians(declared.tilt_std_deg)] * 9]
        rest += [site.latitude_std_deg, site.azimuth_std_deg] if site else [0.0, 0.0]
        covariance[range(3 * count, 4 * count + 11), range(3 * count, 4 * count + 11)] = np.square(rest)
        return covariance
