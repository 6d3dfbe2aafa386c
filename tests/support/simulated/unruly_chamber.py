"""A chamber that overshoots, cycles and has its door opened, with its sensors, for the watch of deviations.

The air follows the programme as a second-order control loop; an open door draws it to the laboratory's temperature.
A cycle of the compressor lies on top. Nothing of it is taken from the worlds of the simulated bench: these neither
overshoot nor cycle.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from bench.model.clock import NS
from bench.model.events import Deviation, Event
from bench.plan import SetPoint
from bench.plan.language.interlocks import InterlockRule
from bench.run.context import InUse
from bench.run.stop import CHAMBER_AIR, Health, StopSwitch
from bench.run.watch.deviations import DeviationWatch

LAB_DEGC = 23.0
CHANNEL = 102
SECOND_AIR = InterlockRule(
    name="second_air", signal="second_air", of="logger", channel=CHANNEL, unit="degC", high=65.0, low=None,
    release_high=65.0, release_low=None, dwell_s=0.0, release_after_s=0.0, stale_s=None, action="abort", where="",
)  # fmt: skip


@dataclass(frozen=True)
class Character:
    """What one chamber is like. Loop: angular frequency 1/s and damping; cycle: amplitude K and period s.

    ``second_lag_s``: of a thin thermocouple in moving air.
    """

    loop_per_s: float
    damping: float
    cycle_K: float
    cycle_s: float
    door_s: float
    offset_K: float
    second_lag_s: float

    @classmethod
    def drawn(cls, draw: np.random.Generator) -> "Character":
        return cls(
            loop_per_s=2.0 * math.pi / draw.uniform(500.0, 1200.0),
            damping=float(draw.uniform(0.3, 0.8)),
            cycle_K=float(draw.uniform(0.1, 0.6)),
            cycle_s=float(draw.uniform(90.0, 400.0)),
            door_s=float(draw.uniform(45.0, 150.0)),
            offset_K=float(draw.uniform(-1.0, 1.0)),
            second_lag_s=float(draw.uniform(1.0, 6.0)),
        )


class Clock:
    """Time as the test sets it."""

    virtual = False

    def __init__(self) -> None:
        self.t_ns = 0

    def now_ns(self) -> int:
        return self.t_ns


class UnrulyChamber:
    """Steps of a second. ``door``: open or not; ``runaway_degC_min``: the air's own rate, whatever is asked.

    ``own_stuck_degC``, ``second_stuck_degC``: what a sensor that hangs says.
    """

    def __init__(self, character: Character, draw: np.random.Generator, start_degC: float = LAB_DEGC) -> None:
        self.character, self._draw = character, draw
        self.air_degC, self._velocity = start_degC, 0.0
        self._demand_degC = self._target_degC = start_degC
        self._ramp_degC_s = 0.0
        self._second_degC = start_degC
        self._t_s = 0.0
        self.door = False
        self.runaway_degC_min: float | None = None
        self.own_stuck_degC: float | None = None
        self.second_stuck_degC: float | None = None

    def set_point(self, asked: SetPoint) -> None:
        self._target_degC, self._ramp_degC_s = asked.temperature_degC, asked.ramp_degC_min / 60.0

    def step(self) -> None:
        kind, self._t_s = self.character, self._t_s + 1.0
        left = self._target_degC - self._demand_degC
        self._demand_degC += max(-self._ramp_degC_s, min(self._ramp_degC_s, left))
        if self.runaway_degC_min is not None:
            self._velocity = self.runaway_degC_min / 60.0
        else:
            pull = kind.loop_per_s**2 * (self._demand_degC - self.air_degC)
            self._velocity += pull - 2.0 * kind.damping * kind.loop_per_s * self._velocity
        self.air_degC += self._velocity
        if self.door:
            self.air_degC += (LAB_DEGC - self.air_degC) / kind.door_s
        self._second_degC += (self._true_degC - self._second_degC) / kind.second_lag_s

    @property
    def _true_degC(self) -> float:
        kind = self.character
        return self.air_degC + kind.cycle_K * math.sin(2.0 * math.pi * self._t_s / kind.cycle_s)

    def measure_air(self) -> float:
        """As a controller tells it: noise of 0.03 K, one decimal."""
        noise = self._draw.normal(0.0, 0.03)
        return round(self._true_degC + noise, 1) if self.own_stuck_degC is None else self.own_stuck_degC

    def second_air(self) -> float:
        """As a thermocouple tells it."""
        degC = self._second_degC if self.second_stuck_degC is None else self.second_stuck_degC
        return degC + self.character.offset_K + float(self._draw.normal(0.0, 0.02))


class Watched:
    """A watch on such a chamber, looked at each second as on the wall clock, the chamber's sensor read each second.

    ``told`` holds every deviation with its time, second. ``door_signal``: the chamber tells whether its door is open.
    """

    def __init__(self, seed: int, *, door_signal: bool = False, second: bool = True) -> None:
        self.draw = np.random.default_rng(seed)
        self.clock = Clock()
        self.chamber = UnrulyChamber(Character.drawn(self.draw), self.draw)
        self.told: list[tuple[float, Deviation]] = []
        driver: Any = SimpleNamespace(measure_air=self.chamber.measure_air)
        if door_signal:
            driver.door_open = lambda: self.chamber.door
        logger = SimpleNamespace(options={"channels": [CHANNEL]}, scan=lambda: [self.chamber.second_air()])
        self.health = Health(self.clock)  # type: ignore[arg-type]
        context: Any = SimpleNamespace(
            clock=self.clock, health=self.health, instruments={"chamber": driver, "logger": logger}, in_use=InUse(),
            stop=StopSwitch(), event=self._event, step=None,
            plan=SimpleNamespace(station=SimpleNamespace(guard_limits_degC={CHAMBER_AIR: 65.0})),
        )  # fmt: skip
        self.watch = DeviationWatch(context, [SECOND_AIR] if second else [], asks=True)

    @property
    def now_s(self) -> float:
        return self.clock.t_ns / NS

    def set_point(self, degC: float, ramp_degC_min: float) -> None:
        asked = SetPoint(degC, ramp_degC_min)
        self.chamber.set_point(asked)
        self.watch.set_point(asked)

    def run(self, seconds: float) -> None:
        """Let time pass, a look each second."""
        for _ in range(round(seconds)):
            self.clock.t_ns += NS
            self.chamber.step()
            self.health.note(CHAMBER_AIR, self.chamber.measure_air())
            self.watch.look()

    def begun(self, since_s: float = 0.0) -> list[tuple[float, str]]:
        """Return when each deviation was told that began since then, and its name."""
        return [(t_s, said.name) for t_s, said in self.told if said.state == "begun" and t_s >= since_s]

    def _event(self, event: Event) -> None:
        if isinstance(event, Deviation):
            self.told.append((self.now_s, event))


def campaign(watched: Watched, hours: float) -> Iterator[tuple[float, float]]:
    """Soaks at -40 to 60 degC, ramps of 0.2 to 2 degC/min, a door about each 8 hours; yields when each was open, s."""
    draw, end_s = watched.draw, watched.now_s + 3600.0 * hours
    while watched.now_s < end_s:
        watched.set_point(float(draw.uniform(-40.0, 60.0)), float(draw.choice([0.2, 0.5, 1.0, 2.0])))
        soak_s = float(draw.uniform(3600.0, 5.0 * 3600.0))
        if draw.random() < soak_s / (8.0 * 3600.0):
            before_s, open_s = float(draw.uniform(0.0, soak_s)), float(draw.uniform(10.0, 180.0))
            watched.run(before_s)
            opened_s, watched.chamber.door = watched.now_s, True
            watched.run(open_s)
            watched.chamber.door = False
            yield opened_s, watched.now_s
            watched.run(max(0.0, soak_s - before_s - open_s))
        else:
            watched.run(soak_s)
