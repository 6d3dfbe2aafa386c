"""Columns of an imported log of an inertial unit: accelerometers and gyros as arrays, stretches by label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Floats, Material
from bench.model.errors import FitError
from bench.systems.gnc.rows import AXES


@dataclass(frozen=True)
class ImuLog:
    """``accel``, ``gyro`` (n, 3): as read, in ``accel_unit`` and ``gyro_unit`` ("1": counts); gyro None without one.

    ``gravity``: in m/s2.   ``t_s`` (n,).   ``rate_Hz``: mean rate.   ``segments``: as the mapping names them.
    """

    t_s: Floats
    accel: Floats
    accel_unit: str
    gyro: Floats | None
    gyro_unit: str
    gravity: float
    rate_Hz: float
    segments: tuple[Mapping[str, Any], ...]

    def rows(self, segment: Mapping[str, Any]) -> slice:
        """Return rows of a segment; its last one is included."""
        return slice(int(segment["first"]), int(segment["last"]) + 1)


def imu_log(material: Material) -> ImuLog:
    """Return the log of a session.

    Raises: FitError B-GNC-006 if it has no accelerometer of three axes, no gravity or values that are missing.
    """
    t_s = material.series.get("t_s")
    accel, accel_unit = _triad(material, "accelerometer")
    if t_s is None or accel is None:
        raise _unusable("there is no imported log with accelerometers of three axes")
    gyro, gyro_unit = _triad(material, "gyro")
    whole = np.isfinite(accel).all() and (gyro is None or np.isfinite(gyro).all())
    if len(t_s) < 2 or not whole:
        raise _unusable("a value is missing in the columns of the sensors")
    if not t_s[-1] > t_s[0]:
        raise _unusable("all rows of the log have the same time")
    site = material.campaign.get("site") or {}
    if not site.get("gravity_m_s2"):
        raise _unusable("the mapping does not state the gravity of the site")
    return ImuLog(
        t_s=t_s,
        accel=accel,
        accel_unit=accel_unit,
        gyro=gyro,
        gyro_unit=gyro_unit,
        gravity=float(site["gravity_m_s2"]),
        rate_Hz=float(material.campaign.get("rate_Hz") or (len(t_s) - 1) / (t_s[-1] - t_s[0])),
        segments=tuple(material.campaign.get("segments") or ()),
    )


def _triad(material: Material, role: str) -> tuple[Floats | None, str]:
    columns = {
        str(column.get("axis")): column for column in material.campaign.get("columns", ()) if column.get("role") == role
    }
    if set(columns) != set(AXES):
        return None, ""
    triad = np.column_stack([material.series[str(columns[axis]["name"])] for axis in AXES])
    return triad, str(columns["x"]["unit"])


def _unusable(why: str) -> FitError:
    return FitError(
        "B-GNC-006",
        why,
        next_step="map time, three accelerometers and the gravity of the site (docs/importing.md)",
    )
