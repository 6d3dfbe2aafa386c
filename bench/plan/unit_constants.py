"""What the analysis is told of the unit under test and of the place where the bench stands."""

from __future__ import annotations

from typing import Any

from bench.model.declaration import stated
from bench.model.systems import systems
from bench.model.units import read_quantity
from bench.plan.language.sequence import Sequence, Site


def unit_constants(model: Sequence, serial: str) -> dict[str, Any]:
    """Return entries of the manifest's section "campaign", in base units; what is not stated is left out."""
    found: dict[str, Any] = {}
    if model.uut is not None:
        found["uut"] = {"model": model.uut.model, "serial": serial}
        for system in systems():
            if system.unit is not None and isinstance(model.uut, system.unit):
                found |= system.unit.constants(model.uut)
        if model.uut.limits:
            found["limits"] = {name: _limit(text) for name, text in model.uut.limits.items()}
    if model.site is not None:
        found["site"] = _site(model.site)
    return found


def _limit(text: str) -> dict[str, Any]:
    value, unit = read_quantity(text) or (0.0, "")
    return {"value": value, "unit": unit}


def _site(site: Site) -> dict[str, float]:
    constants = {
        "latitude_deg": site.latitude,
        "longitude_deg": site.longitude,
        "height_m": site.height,
        "gravity_m_s2": site.gravity,
        "azimuth_deg": site.azimuth,
        "azimuth_std_deg": site.azimuth_uncertainty,
        "tilt_std_deg": site.tilt,
    }
    return stated(constants)
