"""Limits of a time offset, and statements of the sequence on both units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from bench.analysis import Document, stated_limits
from bench.model.errors import FitError
from bench.systems.time_sync import declaration
from bench.systems.time_sync.estimators.kalman.setup import EgiSpread, ImuDensities

UNCERTAINTY, DIFFERENCE = "time_offset_uncertainty", "stamps_difference"
SPECIFIED_s: Mapping[str, float] = {UNCERTAINTY: 2e-3, DIFFERENCE: 5e-3}


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


def demands_of(campaign: Document) -> Demands:
    """Return limits of the campaign, those of ``SPECIFIED_s`` where it states none.

    Raises: FitError B-SYNC-005 for a limit that no time offset has, in a wrong unit or not above zero.
    """
    declared = declaration.DECLARATION.analysis("time_sync")
    limits = {
        **SPECIFIED_s,
        **stated_limits(campaign, declared.limits, "B-SYNC-005", "a time offset has no such limit"),
    }
    return Demands(limits[UNCERTAINTY], limits[DIFFERENCE])


def latency_of(campaign: Document) -> Latency | None:
    """Return what the makers state of both latencies, None if the campaign says nothing.

    Raises: FitError B-SYNC-006 if it is incomplete or negative.
    """
    stated = _stated(campaign, "latency", declaration.Latency.in_manifest, zero=True)
    return None if stated is None else Latency(**stated)


def densities_of(campaign: Document) -> ImuDensities:
    """Errors of the inertial unit as its data sheet states them; of the paper's Table 2 if the campaign says nothing.

    Raises: FitError B-SYNC-006 if the section is incomplete or a value is not above zero.
    """
    stated = _stated(campaign, "inertial", declaration.Inertial.in_manifest)
    if stated is None:
        return ImuDensities()
    return ImuDensities(
        accel_bias_ug=1e6 * stated["accel_bias_g"],
        velocity_walk_ug=1e6 * stated["velocity_walk_g_rtHz"],
        gyro_bias_deg_h=3600.0 * stated["gyro_bias_deg_s"],
        angle_walk_deg_rt_h=stated["angle_walk_deg_rth"],
    )


def spread_of(campaign: Document, position_sigma_m: float) -> EgiSpread:
    """Errors of the EGI: the position as it states it in its frames, the rest as the campaign states them.

    Those of a navigation-grade unit with GPS (``EgiSpread``) if the campaign says nothing.
    Raises: FitError B-SYNC-006 if the section is incomplete or a value is not above zero.
    """
    spread = EgiSpread(position_m=position_sigma_m) if position_sigma_m > 0.0 else EgiSpread()
    names = ("velocity_m_s", "level_deg", "heading_deg", "wander_s", "heading_wander_s")
    return replace(spread, **(_stated(campaign, "egi", names) or {}))


def _stated(campaign: Document, section: str, names: Sequence[str], *, zero: bool = False) -> dict[str, float] | None:
    """Return the figures of a section, None without it; all must be there and above zero, or ``zero`` if it may be."""
    stated = campaign.get(section)
    if stated is None:
        return None
    try:
        figures = {name: float(stated[name]) for name in names}
    except (KeyError, TypeError, ValueError) as error:
        raise _unstated(section, f"{error!r}") from error
    if not all(math.isfinite(figure) and (figure > 0.0 or (zero and figure == 0.0)) for figure in figures.values()):
        raise _unstated(section, f"{dict(stated)}")
    return figures


def _unstated(section: str, why: str) -> FitError:
    return FitError(
        "B-SYNC-006",
        f"the section {section!r} of the unit under test is incomplete or no number above zero: {why}",
        where=f"manifest: campaign.{section}",
        next_step="state all of its entries in the sequence, or leave the section out",
    )
