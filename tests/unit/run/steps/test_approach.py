"""Soaks that the lag of the unit ends: chamber and unit alone, without records, and units with a second, slower mass.

The simulated chamber and unit are closed forms; a soak ends with a truth to compare with: how far the unit still is
from the air, now and later.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plan_sample import planned
from scipy.signal import lfilter

from bench.model.clock import NS, VirtualClock, to_ns
from bench.model.errors import InstrumentError
from bench.model.events import Event, ThermalLag
from bench.plan import PlannedSoak
from bench.run.context import InUse
from bench.run.steps.approach import Approach, Rest
from bench.run.steps.decided import Decided
from sim_instruments.worlds.common.thermal import UNIT_LAG_S, Thermal

TEMPERATURES_degC = (-10.0, 5.0, 20.0, 35.0, 50.0)
SLOT_s, LOOK_s, RAMP_degC_min = 9000.0, 60.0, 0.5
SAMPLE_degC = 0.005  # four sensors of 0.01 degC, ten times a second, in steps of 0.01 degC
WANDER_s = 300.0


@dataclass(frozen=True)
class Part:
    share: float
    lag: float  # in lags of the usual unit


ONE = (Part(1.0, 1.0),)


class Bench:
    """Chamber and unit without records; the unit is a sum of parts, the air may wander."""

    def __init__(self, seed: int, parts: Sequence[Part] = ONE, wander_degC: float = 0.0) -> None:
        self.clock, self.parts = VirtualClock(), parts
        self.thermals = [Thermal(unit_lag=part.lag) for part in parts]
        self._rng = np.random.default_rng(seed)
        self._wander = self._of_air(wander_degC)
        self.events: list[Event] = []
        self.decided = Decided(())
        self.in_use, self.instruments = InUse(), {"chamber": self}
        self.acquisition = SimpleNamespace(readers={}, lock=nullcontext())
        self.silent_s: tuple[float, float] = (math.inf, math.inf)

    def _of_air(self, rms_degC: float) -> Any:
        """What a wander of the air, each 10 s, does to the unit; its display has steps of 0.1 degC."""
        alike, lag = math.exp(-10.0 / WANDER_s), math.exp(-10.0 / UNIT_LAG_S)
        air = lfilter([rms_degC * math.sqrt(1.0 - alike**2)], [1.0, -alike], self._rng.normal(size=6000))
        return lfilter([1.0 - lag], [1.0, -lag], air)

    def event(self, event: Event) -> None:
        self.events.append(event)
        self.decided.take(event)

    def measure_air(self) -> float:
        first, last = self.silent_s
        if first <= self.clock.now_ns() / NS < last:
            raise InstrumentError("B-INST-001", "no answer", where="chamber")
        return round(float(self.thermals[0].air_degC(self.clock.now_ns())), 1)

    def unit_degC(self, t_ns: Any) -> Any:
        parts = zip(self.parts, self.thermals, strict=True)
        return sum(part.share * thermal.unit_degC(t_ns) for part, thermal in parts)

    def said(self, until_s: float) -> tuple[Any, Any]:
        """Samples since the look before."""
        t_ns = np.round(np.arange(until_s - LOOK_s + 0.1, until_s + 0.05, 0.1) * NS).astype(np.int64)
        noise = self._rng.normal(0.0, SAMPLE_degC, t_ns.size) + self._wander[int(until_s / 10.0) % 6000]
        return t_ns, np.round(self.unit_degC(t_ns) + noise, 2)

    def soak(self, target_degC: float, residual_degC: float) -> float:
        """Soak as the step does; return how far from the air the unit is then, or will be."""
        start_s = self.clock.now_ns() / NS
        step = soak_step(target_degC, residual_degC, start_s)
        approach = Approach(self, step, [None])  # type: ignore[arg-type]
        for thermal in self.thermals:
            thermal.ramp(target_degC, RAMP_degC_min, self.clock.now_ns())
        moment_s, is_over = start_s, False
        while not is_over and moment_s < start_s + SLOT_s:
            moment_s += LOOK_s
            self.clock.sleep_until_ns(to_ns(moment_s))
            approach.means[None].add(*self.said(moment_s))
            is_over = approach.look(moment_s)
        approach.note(start_s + SLOT_s - moment_s)
        later_ns = self.clock.now_ns() + np.arange(0, 36_000, 300) * NS
        return float(np.abs(self.unit_degC(later_ns) - target_degC).max())

    def campaign(self, residual_degC: float) -> list[tuple[ThermalLag, float]]:
        """Return, of each soak, what it noted and the truth."""
        found = []
        for target_degC in TEMPERATURES_degC:
            truth_degC = self.soak(target_degC, residual_degC)
            noted = self.events[-1]
            assert isinstance(noted, ThermalLag)
            found.append((noted, truth_degC))
        return found


def soak_step(target_degC: float, residual_degC: float, at_s: float = 0.0) -> PlannedSoak:
    step = planned(
        "soak", role="chamber", name="soak", at_s=at_s, duration_s=SLOT_s, temperature=target_degC,
        ramp=RAMP_degC_min, slot=SLOT_s, residual=residual_degC, least=2400.0,
    )  # fmt: skip
    assert isinstance(step, PlannedSoak)
    return step


@pytest.mark.parametrize("seeds", [2, pytest.param(20, marks=pytest.mark.sweep)])
@pytest.mark.parametrize("residual_degC", [0.2, 0.5])
def test_the_lag_of_the_first_soak_ends_the_others_as_near_as_is_stated(residual_degC: float, seeds: int) -> None:
    """The first takes its slot, the least time holds, and what is stated holds by the truth."""
    saved_h, worst_degC = [], 0.0
    for seed in range(seeds):
        (first, _), *others = Bench(seed).campaign(residual_degC)
        assert first.saved_s == 0.0
        assert first.lag_s == pytest.approx(UNIT_LAG_S, rel=5e-3)
        for noted, truth_degC in others:
            assert 0.0 < noted.saved_s <= SLOT_s - 2400.0
            worst_degC = max(worst_degC, truth_degC)
            assert truth_degC <= residual_degC
            assert truth_degC <= noted.bound_degC <= residual_degC
        saved_h.append(sum(noted.saved_s for noted, _ in others) / 3600.0)
    print(
        f"{seeds} seeds, {residual_degC} degC stated: {min(saved_h):.2f} to {max(saved_h):.2f} h of 10 h saved, "
        f"worst truth {worst_degC:.3f} degC"
    )


WRONG = {
    "5 % of it 80 min": ((Part(0.95, 0.8), Part(0.05, 3.2)), 0.0),
    "5 % of it 80 min, air wanders": ((Part(0.95, 0.8), Part(0.05, 3.2)), 0.02),
    "3 % of it 120 min, air wanders": ((Part(0.97, 0.8), Part(0.03, 4.8)), 0.03),
    "10 % of it 60 min, air wanders": ((Part(0.9, 1.0), Part(0.1, 2.4)), 0.05),
    "20 % of it 7 min": ((Part(0.8, 1.0), Part(0.2, 0.27)), 0.0),
    "one lag, air wanders": (ONE, 0.03),
}


@pytest.mark.parametrize("seeds", [1, pytest.param(20, marks=pytest.mark.sweep)])
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_world_ends_no_soak_too_early(name: str, seeds: int) -> None:
    """A second mass that is slower than the sensor's: its soaks are as near as stated, or take their slots."""
    parts, wander_degC = WRONG[name]
    early, worst_degC = 0, 0.0
    for seed in range(seeds):
        for noted, truth_degC in Bench(seed, parts, wander_degC).campaign(0.3):
            if noted.saved_s:
                early, worst_degC = early + 1, max(worst_degC, truth_degC)
    print(f"{name}: {early} of {4 * seeds} soaks ended early, 0.3 degC stated, worst truth {worst_degC:.3f} degC")
    assert worst_degC <= 0.3


def test_a_silent_chamber_ends_no_soak() -> None:
    bench = Bench(1)
    bench.soak(-10.0, 0.5)
    bench.silent_s = (SLOT_s + 3600.0, 2.0 * SLOT_s + 1.0)
    count = len(bench.events)
    bench.soak(5.0, 0.5)
    assert bench.clock.now_ns() == to_ns(2.0 * SLOT_s)
    assert {event.kind for event in bench.events[count:]} == {"error"}  # no look was at air that stands still


def test_air_is_at_rest_when_its_readings_lie_together() -> None:
    rest = Rest()
    assert [rest.look(degC) for degC in (40.0, 45.0, 49.0, 49.8)] == [0, 0, 0, 0]
    assert [rest.look(50.0) for _ in range(12)] == [0] * 6 + [0, 0, 0, 1, 2, 3]
    assert rest.look(50.4) == 0
    assert [rest.look(50.0) for _ in range(10)][-2:] == [0, 0]
    assert rest.look(math.nan) == 0


def test_moments_that_have_passed_behind_a_hold_are_no_looks() -> None:
    """A soak that goes on behind a hold comes to its first moments at once, with nothing said in between."""
    bench = Bench(1)
    bench.clock.sleep_until_ns(to_ns(3000.0))
    approach = Approach(bench, soak_step(23.0, 0.5), [None])  # type: ignore[arg-type]
    for moment_s in np.arange(60.0, 3060.0, 60.0):
        assert not approach.look(moment_s)
    approach.note(0.0)
    assert bench.events == []
