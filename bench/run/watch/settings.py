"""Settings of supplies and tables that these measure themselves: voltages of outputs that are on, rates of axes.

Followed step by step; what a step sets counts from its beginning.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from bench.model.ports import Effect, Instrument, drivers_of
from bench.plan import PlannedCall
from bench.run.steps.setpoints import VOLTAGE_WITHIN

LEAST_VOLTAGE_V = 0.1  # what a supply reads back of itself beside its share, and of 0 V
RATE_WITHIN = 0.01  # of the demand: tables hold 1e-4, so this is no noise
LEAST_RATE_DEG_S = 0.05


@dataclass(frozen=True)
class Setting:
    """One set value and how it is measured: ``name`` voltage (V) or rate (deg/s), ``of`` the role with rail or axis."""

    name: str
    role: str
    of: str
    value: float
    tolerance: float
    unit: str
    measure: Callable[[], float]


class Settings:
    """The settings of one run, by role and rail or axis."""

    def __init__(self, instruments: Mapping[str, Instrument]) -> None:
        self._instruments = instruments
        self._actions = drivers_of(instruments)
        self._voltages_V: dict[str, dict[int | None, float]] = {}
        self._on: set[str] = set()
        self._rates_deg_s: dict[str, dict[int, float]] = {}

    def called(self, step: PlannedCall) -> None:
        """Take a step of the plan."""
        actions = self._actions.get(step.role, {})
        if "measure_voltage" in actions:
            self._supply(step)
        if "measure_rate" in actions and step.name in actions:
            self._table(step, actions[step.name].effect)

    def set_now(self, *, holding: bool) -> list[Setting]:
        """Return what is set now; no axis while the run stands still, because tables are brought to rest then."""
        voltages = [
            self._setting("voltage", role, rail, volts, max(VOLTAGE_WITHIN * abs(volts), LEAST_VOLTAGE_V), "V")
            for role in sorted(self._on)
            for rail, volts in self._voltages_V.get(role, {}).items()
        ]
        rates = [
            self._setting("rate", role, axis, rate, max(RATE_WITHIN * abs(rate), LEAST_RATE_DEG_S), "deg/s")
            for role, axes in sorted(self._rates_deg_s.items())
            for axis, rate in axes.items()
        ]
        return voltages if holding else [*voltages, *rates]

    def _supply(self, step: PlannedCall) -> None:
        voltage_V, rail = step.quantity("voltage"), step.arguments.get("rail")
        if voltage_V is not None:
            self._voltages_V.setdefault(step.role, {})[rail if isinstance(rail, int) else None] = voltage_V
        elif step.name == "output_on":
            self._on.add(step.role)
        elif step.name == "output_off":
            self._on.discard(step.role)

    def _table(self, step: PlannedCall, effect: Effect) -> None:
        rate_deg_s, axes = step.quantity("rate"), self._rates_deg_s.setdefault(step.role, {})
        if effect is Effect.MOTION_OFF:
            axes.clear()
        elif step.axis is not None and step.name == "spin" and rate_deg_s is not None:
            axes[step.axis] = rate_deg_s
        elif step.axis is not None and (effect is Effect.MOTION_ON or step.name == "stop"):
            axes.pop(step.axis, None)

    def _setting(self, name: str, role: str, part: int | None, value: float, tolerance: float, unit: str) -> Setting:
        measure = getattr(self._instruments[role], f"measure_{name}")
        of = role if part is None else f"{role} {'rail' if name == 'voltage' else 'axis'} {part}"
        arguments = () if part is None else (part,)
        return Setting(name, role, of, value, tolerance, unit, partial(measure, *arguments))
