"""The world of the thermometers' bench: a block in the chamber with four thermometers and a reference probe."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bench.model.clock import NS, Clock
from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.terminals import Source
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import World

from resistance_thermometer.world.options import BlockOptions
from resistance_thermometer.world.probe import ALPHA, DELTA, Element

CHANNELS = (101, 102, 103, 104)
CLASS_B = 104  # the others are made to class A
LEAD_OHM = 1.5
REFERENCE = Element(100.0123, ALPHA + 1.3e-6, DELTA - 0.004)  # what its certificate says
REFERENCE_SIGMA_DEGC = 0.01  # of its calibration
ROOM_DEGC, FAR_DEGC = 23.0, 77.0
_SPREAD = {"A": (150e-6, 200e-6, 0.003), "B": (300e-6, 500e-6, 0.01)}  # R0, alpha relative, delta; one sigma
_PERIODS_S = (4310.0, 1730.0, 613.0)  # of the wander; none is a multiple of another


class BlockWorld(World):
    """One simulated bench.

    Args: clock, seed: as of every world.   options: checked ones; the others are as by default.
    """

    ports = ()

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        self.block_options = BlockOptions.of(options)
        thermal = Thermal(self.block_options.time_constants)
        super().__init__(clock=clock, seed=seed, unit=None, thermal=thermal, options=options)
        self.elements = {channel: self._element(channel) for channel in CHANNELS}
        self._gradients = {
            channel: float(self.rng("gradient", channel).normal(0.0, self.block_options.gradient_degC)) / FAR_DEGC
            for channel in CHANNELS
        }
        drawn_degC = float(self.rng("reference probe").normal(0.0, REFERENCE_SIGMA_DEGC))
        given_degC = self.block_options.reference_degC
        self._reference_degC = drawn_degC if given_degC is None else given_degC
        for channel in CHANNELS:
            self.terminals.connect(self._source(channel), "scanner", channel)
        self.terminals.connect(Source(resistance_ohm=self._reference_ohm, lead_ohm=LEAD_OHM), "meter")

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        """Return R0 of every thermometer, and its deviation at the first record of each set-point."""
        found = [_entry("r0", "ohm", self.elements[channel].r0_ohm, {"channel": channel}) for channel in CHANNELS]
        seen = set()
        for window in windows:
            setpoint_degC = window.conditions["temperature_degC"]
            if setpoint_degC not in seen:
                middle_degC = float(self.thermal.unit_degC((window.t_start_ns + window.t_end_ns) // 2))
                found += [self._deviation(channel, setpoint_degC, middle_degC) for channel in CHANNELS]
            seen.add(setpoint_degC)
        return found

    def _deviation(self, channel: int, setpoint_degC: float, t_degC: float) -> dict[str, Any]:
        nominal = Element(100.0)
        slope = (nominal.ohm(t_degC + 0.5) - nominal.ohm(t_degC - 0.5)) / 1.0
        excess_ohm = self.elements[channel].ohm(t_degC) - nominal.ohm(t_degC)
        conditions = {"channel": channel, "temperature_degC": setpoint_degC}
        return _entry("deviation", "degC", excess_ohm / slope, conditions)

    def _element(self, channel: int) -> Element:
        r0, alpha, delta = _SPREAD["B" if channel == CLASS_B else "A"]
        draws = self.rng("element", channel).normal(size=3) * (1.0 if self.block_options.spread else 0.0)
        alloy = 1e-6 * self.block_options.alloy_ppm if channel == CHANNELS[-1] else 0.0
        return Element(
            r0_ohm=100.0 * (1.0 + r0 * float(draws[0])),
            alpha=ALPHA * (1.0 + alpha * float(draws[1]) + alloy),
            delta=DELTA + delta * float(draws[2]),
        )

    def _source(self, channel: int) -> Source:
        """Return what hangs at a channel: four leads, or two that are joined at the scanner and so count in full."""
        if self.block_options.two_wire and channel == CHANNELS[-1]:
            return Source(resistance_ohm=lambda t_ns: self._element_ohm(channel, t_ns) + 2.0 * LEAD_OHM)
        return Source(resistance_ohm=lambda t_ns: self._element_ohm(channel, t_ns), lead_ohm=LEAD_OHM)

    def _element_ohm(self, channel: int, t_ns: int) -> float:
        block_degC = float(self.thermal.unit_degC(t_ns))
        t_degC = block_degC + self._gradients[channel] * (block_degC - ROOM_DEGC) + self._wander(channel)(t_ns)
        return self.elements[self._in_place_of(channel, t_ns)].heated_ohm(t_degC)

    def _in_place_of(self, channel: int, t_ns: int) -> int:
        from_s = self.block_options.exchanged_s
        if from_s is None or channel not in CHANNELS[:2] or t_ns < from_s * NS:
            return channel
        return CHANNELS[1] if channel == CHANNELS[0] else CHANNELS[0]

    def _reference_ohm(self, t_ns: int) -> float:
        return REFERENCE.ohm(float(self.thermal.unit_degC(t_ns)) + self._reference_degC)

    def _wander(self, channel: int) -> Callable[[int], float]:
        """Return the temperature of a place against that of the reference: slow waves whose phases are drawn."""
        phases = self.rng("wander", channel).uniform(0.0, math.tau, len(_PERIODS_S))
        size_degC = self.block_options.wander_degC * math.sqrt(2.0 / len(_PERIODS_S))
        return lambda t_ns: (
            size_degC
            * sum(
                math.sin(math.tau * t_ns / NS / period_s + phase)
                for period_s, phase in zip(_PERIODS_S, phases, strict=True)
            )
        )


def _entry(quantity: str, unit: str, value: float, conditions: Mapping[str, Any]) -> dict[str, Any]:
    return {"quantity": quantity, "unit": unit, "value": value, "conditions": dict(conditions)}


WORLD = BlockWorld
