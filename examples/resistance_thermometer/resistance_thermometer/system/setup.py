"""What the session's manifest states: the thermometers, and what the certificates say of the bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.model.errors import FitError

from resistance_thermometer.system.estimators.iec60751 import CLASSES, Curve, Tolerance

REFERENCE, SCANNER, METER, CHAMBER = "reference_probe", "scanner", "meter", "chamber"
_EXPANDED = 2.0  # certificates state 95 %


@dataclass(frozen=True)
class Thermometer:
    """One thermometer of the campaign."""

    serial: str
    channel: int
    tolerance_class: str
    nominal_ohm: float
    self_heating_degC: float

    @property
    def tolerance(self) -> Tolerance:
        """Largest deviation of its class."""
        return CLASSES[self.tolerance_class]


@dataclass(frozen=True)
class Ohmmeter:
    """Standard uncertainty of an instrument on the range that is used: of the reading, and of its zero."""

    relative: float
    floor_ohm: float


@dataclass(frozen=True)
class Setup:
    """Thermometers, reference and bench; uncertainties are standard uncertainties."""

    thermometers: Sequence[Thermometer]
    reference_r0_ohm: float
    reference_curve: Curve
    reference_std_degC: float
    meter: Ohmmeter
    scanner: Ohmmeter
    uniformity_std_degC: float
    stability_std_degC: float
    air_std_degC: float


def setup_of(campaign: Mapping[str, Any], standards: Mapping[str, Mapping[str, Any]]) -> Setup:
    """Return what the analysis needs of the manifest.

    Raises: FitError RT-SET-001 if the sequence names no thermometers, RT-SET-002 for a value that the register lacks.
    """
    thermometers = [Thermometer(**entry) for entry in campaign.get("thermometers", ())]
    if not thermometers:
        raise FitError(
            "RT-SET-001",
            "the sequence names no thermometers",
            where="manifest: campaign.thermometers",
            next_step="list them under 'uut: {thermometers: [...]}', each with serial, channel and tolerance_class",
        )
    known = _Register(standards)
    curve = Curve(a=known.value(REFERENCE, "a", "1/degC"), b=known.value(REFERENCE, "b", "1/degC2"))
    return Setup(
        thermometers=thermometers,
        reference_r0_ohm=known.value(REFERENCE, "r0", "ohm"),
        reference_curve=curve,
        reference_std_degC=known.std(REFERENCE, "uncertainty", "degC"),
        meter=known.ohmmeter(METER),
        scanner=known.ohmmeter(SCANNER),
        uniformity_std_degC=known.std(CHAMBER, "uniformity", "degC"),
        stability_std_degC=known.std(CHAMBER, "stability", "degC"),
        air_std_degC=known.std(CHAMBER, "air_uncertainty", "degC"),
    )


class _Register:
    """The register of standards, read by name."""

    def __init__(self, standards: Mapping[str, Mapping[str, Any]]) -> None:
        self._standards = standards

    def value(self, role: str, name: str, unit: str) -> float:
        entry = self._standards.get(role, {}).get("stated", {}).get(name)
        if entry is None or entry["unit"] != unit:
            raise FitError(
                "RT-SET-002",
                f"the register does not state {name!r} of {role}, in {unit}",
                where="manifest: standards",
                next_step=f"write '{name}' under 'stated' of the standard of {role} in the station file",
            )
        return float(entry["value"])

    def std(self, role: str, name: str, unit: str) -> float:
        return self.value(role, name, unit) / _EXPANDED

    def ohmmeter(self, role: str) -> Ohmmeter:
        return Ohmmeter(self.std(role, "resistance_relative", "1"), self.std(role, "resistance_floor", "ohm"))
