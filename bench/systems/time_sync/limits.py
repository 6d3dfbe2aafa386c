"""What is required of a time offset, and what the sequence states of both units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from bench.model.errors import FitError
from bench.model.units import parse_quantity
from bench.systems.time_sync.estimators.kalman.setup import ImuDensities
from bench.systems.time_sync.estimators.kalman.trials import EgiSpread

UNCERTAINTY, DIFFERENCE = "time_offset_uncertainty", "stamps_difference"
SPECIFIED: Mapping[str, tuple[str, float]] = {UNCERTAINTY: ("s", 2e-3), DIFFERENCE: ("s", 5e-3)}


@dataclass(frozen=True)
class Demands:
    """``uncertainty_s``: largest expanded uncertainty (95 %) of the offset.   ``difference_s``: between filter and
    receive stamps.
    """

    uncertainty_s: float
    difference_s: float


@dataclass(frozen=True)
class Latency:
    """From the validity of a sample to the first byte of its frame at the least; ``std_s`` is of either."""

    egi_s: float
    imu_s: float
    std_s: float


def demands_of(campaign: Mapping[str, Any]) -> Demands:
    """Limits of the campaign, those of ``SPECIFIED`` where it states none.

    Raises: FitError B-SYNC-005 for a limit that no time offset has, in a wrong unit or not above zero.
    """
    found = {name: value for name, (_, value) in SPECIFIED.items()}
    for name, stated in (campaign.get("limits") or {}).items():
        if name not in SPECIFIED:
            raise _unusable(name, "a time offset has no such limit")
        try:
            found[name] = parse_quantity(f"{float(stated['value'])!r} {stated['unit']}", SPECIFIED[name][0])
        except (KeyError, TypeError, ValueError) as error:
            raise _unusable(name, str(error)) from error
        if not found[name] > 0.0:
            raise _unusable(name, f"{found[name]:g} s is not above zero")
    return Demands(found[UNCERTAINTY], found[DIFFERENCE])


def latency_of(campaign: Mapping[str, Any]) -> Latency | None:
    """What the makers state of both latencies, None if the campaign says nothing.

    Raises: FitError B-SYNC-006 if it is incomplete or negative.
    """
    stated = campaign.get("latency")
    if stated is None:
        return None
    try:
        found = Latency(*(float(stated[name]) for name in ("egi_s", "imu_s", "std_s")))
    except (KeyError, TypeError, ValueError) as error:
        raise _unstated("latency", f"{error!r}") from error
    if not all(math.isfinite(one) and one >= 0.0 for one in (found.egi_s, found.imu_s, found.std_s)):
        raise _unstated("latency", f"{stated}")
    return found


def densities_of(campaign: Mapping[str, Any]) -> ImuDensities:
    """Errors of the inertial unit as its data sheet states them; of the paper's Table 2 if the campaign says nothing.

    Raises: FitError B-SYNC-006 if the section is incomplete or a value is not above zero.
    """
    stated = campaign.get("inertial")
    if stated is None:
        return ImuDensities()
    try:
        found = ImuDensities(
            accel_bias_ug=1e6 * float(stated["accel_bias_g"]),
            velocity_walk_ug=1e6 * float(stated["velocity_walk_g_rtHz"]),
            gyro_bias_deg_h=3600.0 * float(stated["gyro_bias_deg_s"]),
            angle_walk_deg_rt_h=float(stated["angle_walk_deg_rth"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise _unstated("inertial", f"{error!r}") from error
    values = (found.accel_bias_ug, found.velocity_walk_ug, found.gyro_bias_deg_h, found.angle_walk_deg_rt_h)
    if not all(math.isfinite(one) and one > 0.0 for one in values):
        raise _unstated("inertial", f"{dict(stated)}")
    return found


def spread_of(campaign: Mapping[str, Any], position_sigma_m: float) -> EgiSpread:
    """Errors of the EGI: the position as it states it in its frames, the rest as the campaign states them.

    Those of a navigation-grade unit with GPS (``EgiSpread``) if the campaign says nothing.
    Raises: FitError B-SYNC-006 if the section is incomplete or a value is not above zero.
    """
    found = EgiSpread(position_m=position_sigma_m) if position_sigma_m > 0.0 else EgiSpread()
    stated = campaign.get("egi")
    if stated is None:
        return found
    names = ("velocity_m_s", "level_deg", "heading_deg", "wander_s", "heading_wander_s")
    try:
        values = {name: float(stated[name]) for name in names}
    except (KeyError, TypeError, ValueError) as error:
        raise _unstated("egi", f"{error!r}") from error
    if not all(math.isfinite(one) and one > 0.0 for one in values.values()):
        raise _unstated("egi", f"{dict(stated)}")
    return replace(found, **values)


def _unusable(name: str, why: str) -> FitError:
    return FitError(
        "B-SYNC-005",
        f"limit {name!r}: {why}",
        where="manifest: campaign.limits",
        next_step=f"use one of: {', '.join(SPECIFIED)}, a time above zero",
    )


def _unstated(section: str, why: str) -> FitError:
    return FitError(
        "B-SYNC-006",
        f"the section {section!r} of the unit under test is incomplete or no number above zero: {why}",
        where=f"manifest: campaign.{section}",
        next_step="state all of its entries in the sequence, or leave the section out",
    )
