"""What the data of a north finder cannot show: whatever turns the signal as another azimuth would.

The sizes are those of one standard uncertainty of noise where the noise decides, and said as such.
Source: FOG paper (digital north finding), equations (1) to (14): the phase of one sine is all that is known of north.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.assumptions import Assumption

_EARTH_DEG_H = 15.041  # rate of the Earth's rotation
_AZIMUTHS = ("azimuth", "azimuth_error", "azimuth_rms_error")


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted, by its section "campaign"."""
    site = campaign.get("site") or {}
    latitude_deg = float(site.get("latitude_deg", 0.0))
    mark_deg = float(site.get("azimuth_std_deg", 0.0))
    return [
        _magnetic(latitude_deg), *_poses(latitude_deg, mark_deg, float(site.get("tilt_std_deg", 0.0))), *_of_bench(),
        Assumption(
            "scale_factor",
            "The sine is the Earth's rotation: no scale factor of the gyroscope enters, amplitudes are in volt.",
            "Any scale factor, and one that drifts from set to set.",
            f"None on the azimuth; the Earth's horizontal rate of {_horizontal_deg_h(latitude_deg):.2f} deg/h at the "
            "stated latitude is not checked against the amplitude.",
            "A rate table that turns the gyroscope about its sensing axis by a known rate.",
            ("scale",),
        ),
    ]  # fmt: skip


def _horizontal_deg_h(latitude_deg: float) -> float:
    return _EARTH_DEG_H * math.cos(math.radians(latitude_deg))


def _magnetic(latitude_deg: float) -> Assumption:
    rate = _horizontal_deg_h(latitude_deg)
    return Assumption(
        "magnetic_effect",
        "Nothing but the Earth's rotation goes once per turn of the table.",
        f"At a place to be found any size across north: 1 % of the signal is {0.01 * rate:.2f} deg/h. At the mark what "
        "is the same at all heads, or below the noise of their errors.",
        "A magnetic effect of 1 % of the Earth's signal turns the azimuth by 0.57 deg, one of 10 % by 5.7 deg.",
        "The same place by another gyroscope or with the gyroscope turned over; a coil or a shield about it.",
        (*_AZIMUTHS, "index_placement", "scale"),
    )


def _poses(latitude_deg: float, mark_deg: float, tilt_deg: float) -> list[Assumption]:
    tangent = abs(math.tan(math.radians(latitude_deg)))
    stated = f"{mark_deg:g} deg" if mark_deg else "not stated"
    return [
        Assumption(
            "azimuth_of_mark",
            f"The azimuth of the mark is as stated (standard uncertainty: {stated}).",
            "Below four standard uncertainties of the mean difference of least_squares and likelihood; without samples "
            "any size.",
            "It turns all azimuths of the calibrated methods one to one; the errors at known azimuths stay 0.",
            "A second surveyed mark, or a gyroscope whose azimuth is known from elsewhere.",
            (*_AZIMUTHS, "index_placement"),
        ),
        Assumption(
            "latitude",
            f"The latitude of the site is {latitude_deg:g} deg.",
            "Any size: it enters the correction of the tilt alone.",
            f"A tilt of 1 mrad about north turns north by {math.degrees(1e-3 * tangent):.3g} deg at this latitude; a "
            f"latitude that is 1 deg off changes that by "
            f"{math.degrees(1e-3 * math.radians(1.0)) * (1.0 + tangent**2):.2g} deg.",
            "A map; the azimuth of one place found twice, with the table tilted by a known angle between.",
            _AZIMUTHS,
        ),
        Assumption(
            "axis_of_table",
            "The level shows the tilt of the rotation axis"
            + (f" to {tilt_deg:g} deg." if tilt_deg else "; its uncertainty is not stated."),
            "A zero of the level that turns with the bench shows as errors once per turn of the head, where there are "
            "four heads; one that is new at the place to be found does not show.",
            f"0.1 mrad turns the azimuth by {math.degrees(1e-4 * tangent):.2g} deg.",
            "The level read at two positions of the table half a turn apart.",
            _AZIMUTHS,
        ),
    ]


def _of_bench() -> list[Assumption]:
    return [
        Assumption(
            "zero_of_table",
            "The sensing axis points along the stated azimuth where the encoder shows zero.",
            "Below four standard uncertainties of the mean difference of least_squares and likelihood; without samples "
            "any size.",
            "It turns the azimuth by likelihood one to one, not that of the calibrated methods.",
            "A mirror on the housing of the gyroscope, sighted from the mark.",
            ("azimuth", "azimuth_error", "azimuth_rms_error", "index_placement"),
        ),
        Assumption(
            "dividing_head",
            "The head stands where it is said, and the bench does not move between the sets of one place.",
            "Errors of the known azimuths below the noise of their means; after the last test any size.",
            "The error at a known azimuth is that of the head as well, one to one.",
            "A repeat of the calibration behind the tests; an autocollimator at the head.",
            (*_AZIMUTHS, "index_placement", "scale"),
        ),
        Assumption(
            "delay_of_lock_ins",
            "Reference and delay of the lock-ins are the same after the bench was carried.",
            "Below five standard uncertainties of the difference of least_squares and likelihood there; without "
            "samples any size.",
            "1 ms at one turn per second is 0.36 deg of azimuth by the calibrated methods, not by likelihood.",
            "A calibration at the mark behind the search.",
            _AZIMUTHS,
        ),
    ]
