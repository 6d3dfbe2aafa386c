"""What can be chosen at the simulated bench of the thermometers, and what it is otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

OPTIONS = {
    "spread": "each thermometer differs from the standard within its class, default on",
    "two_wire": "the leads of the last thermometer are joined in pairs at the scanner, default off",
}
NUMBERS = {
    "time_constants": ("divides the lags of the chamber's air and of the block, default 3", 1.0, 1000.0),
    "gradient_degC": ("from the reference to a thermometer, 77 degC from the room, sigma, default 0.02", 0.0, 5.0),
    "wander_degC": ("of the temperature between two places, sigma, default 0.012", 0.0, 5.0),
    "reference_degC": ("error of the reference probe against its certificate, drawn unless given", -100.0, 100.0),
    "alloy_ppm": ("change of the mean coefficient alpha of the last thermometer, default 0", -5e4, 5e4),
    "exchanged_s": ("time of the run from which the first two thermometers have changed places, never", 0.0, 1e7),
}
TEXTS: Mapping[str, tuple[str, tuple[str, ...]]] = {}


@dataclass(frozen=True)
class BlockOptions:
    """Options of one bench; names and meaning as in ``OPTIONS`` and ``NUMBERS``; None: see there."""

    spread: bool = True
    two_wire: bool = False
    time_constants: float = 3.0
    gradient_degC: float = 0.02
    wander_degC: float = 0.012
    reference_degC: float | None = None
    alloy_ppm: float = 0.0
    exchanged_s: float | None = None

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> BlockOptions:
        """Return checked options; what is not given is as by default."""
        return cls(**options)
