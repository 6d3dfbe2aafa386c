"""Coloured errors of simulated EGIs (embedded GPS/INS): what their own filters leave, at 50 Hz."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_instruments.seeds import generator
from sim_instruments.worlds.time_sync.flight.earth import LATITUDE_DEG
from sim_instruments.worlds.time_sync.flight.egi_filter import EgiClass, EgiErrorFilter
from sim_instruments.worlds.time_sync.flight.path import FlightPath

__all__ = ["EgiClass", "EgiErrorStepper", "EgiErrors", "egi_error_runs"]

Float = NDArray[np.float64]


@dataclass(frozen=True)
class EgiErrors:
    """Errors (estimate minus truth) of R units at m samples, the first at 0 s.

    ``t_s`` (m,).   ``dp`` (m, R, 3): m.   ``dv`` (m, R, 3): m/s, north, east, down.   ``dphi`` (m, R, 3): rad, the
    rotation vector in the tangent plane that turns the true attitude into the estimated one.
    """

    t_s: Float
    dp: Float
    dv: Float
    dphi: Float


class EgiErrorStepper:
    """One unit sample by sample: the numbers of ``egi_error_runs`` for its run, bit for bit on the same path.

    The path may be extended between two steps from the time of the last sample on.

    Args:
        begin_s: time of the path when sample 0 is valid; 60 s of flight on the path lie behind it.
    """

    def __init__(
        self,
        path: FlightPath,
        seed: int,
        run: int = 0,
        sensor: EgiClass | None = None,
        begin_s: float = 0.0,
        latitude_deg: float = LATITUDE_DEG,
    ) -> None:
        self._filter = EgiErrorFilter(path, begin_s, [_lane(seed, run)], sensor or EgiClass(), latitude_deg)

    def step(self) -> tuple[Float, Float, Float]:
        """Errors of the next sample, 0 first: position (3,) m, velocity (3,) m/s, attitude (3,) rad."""
        errors = self._filter.advance(1)[0, 0]
        return errors[:3], errors[3:6], errors[6:9]

    @property
    def position_sigma_m(self) -> float:
        """What the unit itself believes of its horizontal position at the last sample: root mean of north and east."""
        covariance = self._filter.covariance
        return float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))


def egi_error_runs(
    path: FlightPath,
    duration_s: float,
    runs: int,
    seed: int,
    sensor: EgiClass | None = None,
    latitude_deg: float = LATITUDE_DEG,
) -> EgiErrors:
    """Errors of ``runs`` units on the same flight, 50 a second from 0 s to ``duration_s``, both included.

    Run r is the same whatever the number of runs and the duration.
    """
    sensor = sensor or EgiClass()
    lanes = [_lane(seed, run) for run in range(runs)]
    inner = EgiErrorFilter(path, 0.0, lanes, sensor, latitude_deg)
    m = round(duration_s * sensor.rate_Hz) + 1
    errors = [np.empty((m, runs, 3)) for _ in range(3)]
    for first in range(0, m, sensor.rate_Hz):
        newest = inner.advance(min(sensor.rate_Hz, m - first))
        for column, kind in enumerate(errors):
            kind[first : first + sensor.rate_Hz] = newest[..., 3 * column : 3 * column + 3]
    return EgiErrors(np.arange(m) / sensor.rate_Hz, *errors)


def _lane(seed: int, run: int) -> np.random.Generator:
    return generator(seed, "flight egi", run)
