"""What a sequence says of the thermometers in the chamber: the section ``thermometers`` of ``uut``."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any, Literal

from bench.model.declaration import UnitSections
from bench.model.units import quantity
from bench.model.yamlio import StrictModel
from pydantic import Field, StringConstraints, field_validator


class Thermometer(StrictModel):
    """One thermometer, as its data sheet declares it, and where it is connected."""

    serial: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,39}$")]
    channel: int = Field(ge=101, le=310, description="of the scanner; with four wires 1 to 10 of a slot")
    tolerance_class: Literal["A", "B"] = Field(description="of IEC 60751")
    nominal: Annotated[float, *quantity("ohm", 1.0, 10_000.0)] = Field(100.0, description="resistance at 0 degC")
    self_heating: Annotated[float, *quantity("degC", 0.0, 1.0)] = Field(
        description="in the chamber's air, at the current of the scanner's range"
    )


class Thermometers(UnitSections):
    """Sections of ``uut``."""

    thermometers: list[Thermometer] = Field(default_factory=list, description="resistance thermometers in the chamber")

    @field_validator("thermometers")
    @classmethod
    def _each_once(cls, thermometers: list[Thermometer]) -> list[Thermometer]:
        for name in ("serial", "channel"):
            twice = [key for key, count in Counter(getattr(item, name) for item in thermometers).items() if count > 1]
            if twice:
                raise ValueError(f"{name} {twice[0]!r} is stated twice")
        return thermometers

    def constants(self) -> dict[str, Any]:
        """Return the entry of the manifest's section "campaign"; nothing if there are no thermometers."""
        entries = [
            {
                "serial": thermometer.serial,
                "channel": thermometer.channel,
                "tolerance_class": thermometer.tolerance_class,
                "nominal_ohm": thermometer.nominal,
                "self_heating_degC": thermometer.self_heating,
            }
            for thermometer in self.thermometers
        ]
        return {"thermometers": entries} if entries else {}
