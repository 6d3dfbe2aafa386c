"""Deviations that nobody declared: chamber, supplies and tables that are not what they were set to; the run says so.

Each is one alarm with what to do, over when the quantity is back. Readings are those that the run takes anyway; on the
wall clock the chamber, an independent sensor of its air (a rule on the signal ``second_air``), supplies and spinning
axes are read besides: never while a step talks to them, all but the chamber only while the step under way waits.

Settings of supplies and tables that these measure themselves: voltages of outputs that are on, rates of axes.

Followed step by step; what a step sets counts from its beginning.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from bench.model.clock import NS, to_ns
from bench.model.events import Deviation, Environment, Event, Surroundings
from bench.model.ports import Effect, Instrument, drivers_of
from bench.model.units import finite
from bench.plan import CHAMBER, InterlockRule, PlannedCall, PlannedRecord, SetPoint, Step
from bench.record import RecordError
from bench.run.context import RunContext
from bench.run.guard.temperatures import BLIND_S
from bench.run.observers import Observer, Order
from bench.run.setpoints import VOLTAGE_WITHIN
from bench.run.stop import CHAMBER_AIR, guarded
from bench.run.watch.air import APART_BACK_K, APART_K, BACK_K, OWN, SECOND, ChamberAir
from bench.run.watch.interlocks import LOOK_VIRTUAL_S, LOOK_WALL_S, InterlockState
from bench.run.watch.signals import leaves_the_bus, read_idle, scanned

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


DWELL_S = 60.0  # a door that is opened and closed, and an overshoot of a minute, are no deviation
AIR_S = 5.0  # between two looks at the chamber's air, its own sensor and the other one
SETTINGS_S = 30.0  # between two looks at supplies and tables
DOOR_S = 900.0  # so long after its door was closed a chamber is still coming back
SURROUNDINGS_S = 60.0  # a scan becomes an event no more often than this
ACTIONS = {
    "air": "look at the chamber: its door, its heating and cooling, its set-point",
    "runaway": "look at the chamber now, it runs away or its door is open; the guard switches its heat off at {limit}",
    "sensors": "trust neither; compare both with a thermometer before the run counts",
    "voltage": "look at load, current limit and terminals of the supply",
    "rate": "look at the table: its demand, its load, its drive",
}
_SENSORS = {OWN: "its own sensor", SECOND: "the other sensor"}


@dataclass
class _Watched:
    """One deviation: its state, and what is told of it."""

    state: InterlockState
    by: str = ""
    value: float = math.nan
    set_point: float = math.nan
    limit: float = math.nan


class DeviationWatch(Observer):
    """The deviations of one run. ``asks``: instruments are read besides what the run reads."""

    order = Order.SAFETY
    loss = "deviations are not watched any more"

    def __init__(self, context: RunContext, rules: Sequence[InterlockRule], *, asks: bool) -> None:
        self._context, self._asks = context, asks
        self.air = ChamberAir()
        self._settings = Settings(context.instruments)
        second = next((rule for rule in rules if rule.signal == "second_air"), None)
        self._second = None if second is None or second.channel is None else (second.of, second.channel)
        self._heard: deque[Callable[[], None]] = deque()  # from the threads of the run, taken at the next look
        self._air_ns = self._chamber_ns = self._settings_ns = self._noted_ns = self._scanned_ns = 0
        self._watched: dict[tuple[str, str], _Watched] = {}
        self._begun = False
        self._open_ns: int | None = None  # the door of the chamber was seen open last

    def step(self, step: Step, at_s: float) -> None:
        """A step begins that may set something; before the first one everything is as the plan has it."""
        if not self._begun:
            left_out = self._context.decided.left_out
            earlier = (before for before in self._context.plan.steps[: step.number] if before.number not in left_out)
            for before in earlier:
                if isinstance(before, PlannedCall):
                    self._settings.called(before)
        self._begun = True
        if isinstance(step, PlannedCall):
            self._heard.append(partial(self._called, step))

    def set_point(self, asked: SetPoint) -> None:
        """The chamber was given a set-point."""
        self._heard.append(partial(self.air.set_point, self._context.clock.now_ns(), asked))

    def event(self, event: Event, t_mono_ns: int) -> None:
        """A temperature was read by somebody else."""
        if isinstance(event, Environment) and event.air_degC is not None:
            self._heard.append(partial(self.air.take, t_mono_ns, OWN, event.air_degC))
        elif isinstance(event, Surroundings) and self._second is not None and event.role == self._second[0]:
            degC = event.degC.get(str(self._second[1]), math.nan)
            self._heard.append(partial(self.air.take, t_mono_ns, SECOND, float(degC)))

    def look(self) -> None:
        """Take what was heard, read what is due, and judge; nothing any more once the bench is made safe."""
        context = self._context
        if context.stop.over:
            return
        while self._heard:
            self._heard.popleft()()
        self._take_noted()
        if self._asks:
            self._ask()
        self._judge_air(context.clock.now_ns())

    def _called(self, step: PlannedCall) -> None:
        if step.role == CHAMBER and step.name in ("stop", "hold"):
            self.air.forget()
        self._settings.called(step)

    def _take_noted(self) -> None:
        """Take the reading of the chamber's air that the guard has noted last."""
        noted = self._context.health.newest(CHAMBER_AIR)
        if noted is not None and noted[1] > self._noted_ns:
            degC, self._noted_ns = noted
            self.air.take(self._noted_ns, OWN, degC)

    def _ask(self) -> None:
        """Read what is due: the chamber by a short question, as the guard does; others while the bus is left alone."""
        now_ns, step = self._context.clock.now_ns(), self._context.step
        air_is_due = now_ns - self._air_ns >= AIR_S * NS and math.isfinite(self.air.target_degC)
        if air_is_due:
            self._ask_chamber(now_ns)
        timed = isinstance(step, PlannedRecord) and bool(step.readings)  # its readings come one after the other
        if timed or not leaves_the_bus(self._context):
            return
        if air_is_due:
            self._air_ns = now_ns
            if self._second is not None:
                read_idle(self._context, self._second[0], partial(self._scan, *self._second))
        if now_ns - self._settings_ns >= SETTINGS_S * NS:
            self._settings_ns = now_ns
            for setting in self._settings.set_now(holding=bool(self._context.stop.holds.reasons)):
                read_idle(self._context, setting.role, partial(self._measure, setting))

    def _ask_chamber(self, now_ns: int) -> None:
        health, chamber = self._context.health, self._context.instruments.get(CHAMBER)
        if chamber is None or now_ns < self._chamber_ns:
            return
        self._chamber_ns = now_ns + to_ns(AIR_S)
        if now_ns - self._noted_ns >= AIR_S * NS:  # else the guard has just read it
            read_idle(self._context, CHAMBER, lambda: health.note(CHAMBER_AIR, float(chamber.measure_air())))  # type: ignore[attr-defined]
            self._take_noted()
            if self._noted_ns < now_ns:  # it is mute, and its bus may be another one's too
                self._chamber_ns = now_ns + to_ns(BLIND_S)
                return
        self._look_at_door()

    def _scan(self, role: str, channel: int) -> None:
        temperatures, now_ns = scanned(self._context.instruments[role]), self._context.clock.now_ns()
        self.air.take(now_ns, SECOND, temperatures.get(channel, math.nan))
        if now_ns - self._scanned_ns >= SURROUNDINGS_S * NS:
            self._scanned_ns = now_ns
            self._context.event(Surroundings(role=role, degC={str(key): degC for key, degC in temperatures.items()}))

    def _measure(self, setting: Setting) -> None:
        watched = self._of(setting.name, setting.of, unit=setting.unit)
        watched.value, watched.set_point, watched.limit = setting.measure(), setting.value, setting.tolerance
        watched.by = "as the instrument measures it"
        self._take(watched, abs(watched.value - setting.value) - setting.tolerance)

    def _judge_air(self, now_ns: int) -> None:
        air = self.air
        outside = self._of("air", CHAMBER, back=BACK_K, unit="degC")
        outside.value, outside.set_point, outside.limit = air.air_degC(now_ns), air.target_degC, air.margin_K(now_ns)
        outside.by = _SENSORS[OWN if math.isfinite(air.reading_degC(now_ns, OWN)) else SECOND]
        self._take(outside, air.outside_K(now_ns) - outside.limit)
        rates = {sensor: air.runaway_degC_min(now_ns, sensor) for sensor in (OWN, SECOND)}
        fastest = max((sensor for sensor in rates if math.isfinite(rates[sensor])), key=rates.__getitem__, default=OWN)
        runaway = self._of("runaway", CHAMBER, dwell_s=0.0, unit="degC/min")
        runaway.value, runaway.set_point, runaway.limit = rates[fastest], air.target_degC, air.runaway_limit_degC_min
        runaway.by = _SENSORS[fastest]
        self._take(runaway, runaway.value - runaway.limit)
        apart = self._of("sensors", CHAMBER, back=APART_K - APART_BACK_K, unit="K")
        apart.value, apart.limit = air.apart_K(now_ns), APART_K
        own_degC, second_degC = air.reading_degC(now_ns, OWN), air.reading_degC(now_ns, SECOND)
        apart.by = f"its own {own_degC:.1f} degC, the other {second_degC:.1f} degC"
        self._take(apart, apart.value - APART_K)

    def _of(self, name: str, of: str, *, back: float = 0.0, dwell_s: float = DWELL_S, unit: str = "") -> _Watched:
        """Return what is known of a deviation; its value counts from its limit on, and is back ``back`` below it."""
        if (name, of) not in self._watched:
            rule = InterlockRule(
                name=name, signal=name, of=of, channel=None, unit=unit, high=0.0, low=None, release_high=-back,
                release_low=None, dwell_s=dwell_s, release_after_s=DWELL_S, stale_s=None, action="warn", where="",
            )  # fmt: skip
            self._watched[name, of] = _Watched(InterlockState(rule, self._context.clock.now_ns()))
        return self._watched[name, of]

    def _take(self, watched: _Watched, excess: float) -> None:
        change = watched.state.take(self._context.clock.now_ns(), excess)
        if change in ("tripped", "released"):
            self._tell(watched, begun=change == "tripped")

    def _tell(self, watched: _Watched, *, begun: bool) -> None:
        guard_degC = self._context.plan.station.guard_limits_degC.get(CHAMBER_AIR)
        limit = "the limit of its thermostat alone" if guard_degC is None else f"{guard_degC:g} degC"
        rule = watched.state.rule
        self._context.event(
            Deviation(
                name=rule.name,
                of=rule.of,
                state="begun" if begun else "over",
                value=finite(watched.value),
                set_point=finite(watched.set_point),
                limit=finite(watched.limit),
                unit=rule.unit,
                by=watched.by,
                door=self._door() if begun and rule.name in ("air", "runaway") else None,
                action=ACTIONS[rule.name].format(limit=limit),
            )
        )

    def _door(self) -> bool | None:
        """Return whether the door of the chamber is open or was in the last ``DOOR_S``; None where nothing tells."""
        if not self._look_at_door():
            return None
        return self._open_ns is not None and self._context.clock.now_ns() - self._open_ns <= DOOR_S * NS

    def _look_at_door(self) -> bool:
        """Note an open door; returns whether the driver of the chamber has ``door_open``."""
        signal = getattr(self._context.instruments.get(CHAMBER), "door_open", None)
        if signal is None:
            return False

        def look() -> None:
            if signal():
                self._open_ns = self._context.clock.now_ns()

        read_idle(self._context, CHAMBER, look)
        return True


@contextmanager
def deviations(context: RunContext, rules: Sequence[InterlockRule]) -> Iterator[DeviationWatch]:
    """Watch for deviations while the run goes on. In a rehearsal no instrument is read for it."""
    virtual = context.clock.virtual
    watch = DeviationWatch(context, rules, asks=not virtual)
    context.observers.add(watch)
    look_s = LOOK_VIRTUAL_S if virtual else LOOK_WALL_S

    def look() -> None:
        try:
            watch.look()
        except RecordError:
            raise
        except Exception as error:  # a warning that cannot be given is no reason to end a campaign
            periodic.cancel()
            context.message(f"{watch.loss} ({type(error).__name__}: {error}); the run goes on")

    periodic = context.clock.every(look_s, guarded(look, context.stop))
    try:
        yield watch
    finally:
        periodic.cancel()
