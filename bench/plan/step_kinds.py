"""The kinds of step with their arguments, and the reader of a plan as a session holds it.

Numbers are in SI base units, temperatures in degC, ramps in degC/min. In a plan with mistakes a number is NaN where it
could not be read.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from decimal import Decimal
from typing import Any, ClassVar, Self

from bench.model import events
from bench.model.errors import SessionDamaged
from bench.model.events import Answer, Event, Prompt, Record
from bench.model.ports import ENERGISING, SWITCHES, Actions, Drivers, Effect
from bench.model.quantities import QUANTITY, Values
from bench.plan.plan import (
    KINDS,
    PLACE,
    ROW,
    Place,
    SetPoint,
    Step,
    an_event,
    cannot_be_taken_again,
    no_effect,
    not_again,
    nothing,
)
from bench.plan.values import SUFFIX

CHAMBER = "chamber"  # role of the instrument that holds the air's temperature
MEASUREMENT, WIRING = "measurement", "wiring"  # purposes of a record
_AUTOMATIC = ("purpose", "label", "settle_band_degC")
_LEFT_OFF = frozenset({Effect.STIMULUS_SET, Effect.STIMULUS_ON, Effect.STIMULUS_OFF, Effect.ROUTE, Effect.ROUTES_OPEN})
_NOT_AGAIN = _LEFT_OFF | {Effect.THERMAL, Effect.MOTION_ON, Effect.MOTION_OFF}
_NO_RAW_AGAIN = _LEFT_OFF | {Effect.MOTION_ON}  # of an instrument with such an action nobody knows what raw text does


@dataclass(frozen=True, slots=True)
class PlannedCall(Step):
    """Call a declared action of an instrument; ``arguments`` are those its driver declares, by name."""

    kind: ClassVar[str] = "call"
    on_the_bus: ClassVar[bool] = True
    proof: ClassVar[type[Event] | None] = None
    may_end: ClassVar[bool] = True
    unread: ClassVar[float | None] = None

    arguments: Values

    def effects(self, actions: Actions) -> frozenset[Effect]:
        """Return the effect that the action declares."""
        return frozenset(action.effect for name, action in actions.items() if name == self.name) - {Effect.NONE}

    def again(self, actions: Actions) -> tuple[Any, ...] | None:
        """Return settings before switches; neither stimulus, relays nor motion: the point itself sets them."""
        action = actions.get(self.name)
        if action is None or action.effect in _NOT_AGAIN or not action.sets:
            return None
        chosen = tuple(self.arguments.get(parameter.name) for parameter in action.parameters if parameter.choices)
        name = SWITCHES if self.name in SWITCHES else self.name  # what was switched off is not on for a moment
        return (0 if action.parameters else 1), self.role, name, chosen

    def leaves(self, actions: Actions) -> bool:
        """Return whether the action reads something."""
        return self.name in actions and bool(actions[self.name].returns)

    def written(self, drivers: Drivers) -> Values:
        """Return the call as a sequence has it: each argument in the unit that its driver declares."""
        declared = drivers.get(self.role, {}).get(self.name)
        units = {} if declared is None else {parameter.name: parameter.dimension for parameter in declared.parameters}
        arguments = {name: _in_unit(value, units.get(name, "")) for name, value in self.arguments.items()}
        return {f"{self.role}.{self.name}": arguments}

    def confirmed(self, actions: Actions) -> Values:
        """Return the arguments of an action that sets something: its driver reads back what it sets."""
        sets = self.name in actions and actions[self.name].sets
        return {f"{self.role}.{self.name}": dict(self.arguments)} if sets else {}

    @property
    def set_point(self) -> SetPoint | None:
        """Return what the call asks of the air of the chamber, None if it asks nothing."""
        degC = self.quantity("temperature")
        return None if self.role != CHAMBER or degC is None else SetPoint(degC, self.quantity("ramp") or 0.0)

    @property
    def axis(self) -> int | None:
        """Return the axis of a table that the call names, None if it names none."""
        axis = self.arguments.get("axis")
        return axis if isinstance(axis, int) else None

    def quantity(self, name: str) -> float | None:
        """Return an argument that is a quantity, None if there is no such one."""
        value = self.arguments.get(name)
        return value if isinstance(value, float) else None

    @classmethod
    def read(cls, place: Place, arguments: Values) -> Self:
        """Return a step from its arguments in a plan file and what else is in its row."""
        return cls(*place, arguments)

    def told(self) -> dict[str, Any]:
        """Return the arguments as they stand in a plan file."""
        return dict(self.arguments)


@dataclass(frozen=True, slots=True)
class PlannedVerify(Step):
    """Call an action that must answer true; otherwise the record before it is not valid."""

    kind: ClassVar[str] = "verify"
    on_the_bus: ClassVar[bool] = True
    proof: ClassVar[type[Event] | None] = events.Reading
    may_end: ClassVar[bool] = True

    effects = no_effect  # it only asks
    again = not_again  # what it asks about is over
    leaves = nothing

    def written(self, drivers: Drivers) -> Values:
        """Return it as a sequence has it."""
        return {self.kind: f"{self.role}.{self.name}"}


@dataclass(frozen=True, slots=True)
class PlannedSend(Step):
    """Send raw text to an instrument."""

    kind: ClassVar[str] = "send"
    on_the_bus: ClassVar[bool] = True
    proof: ClassVar[type[Event] | None] = None
    may_end: ClassVar[bool] = True

    text: str

    @property
    def asks(self) -> bool:
        """Return whether every command of the text is a question; what follows the mark is its argument."""
        return all(re.match(r"[^\s?]+\?", part.strip()) for part in self.text.split(";"))

    def effects(self, actions: Actions) -> frozenset[Effect]:
        """Return all that its instrument can do, as nobody knows which of it the text does."""
        return frozenset() if self.asks else frozenset(action.effect for action in actions.values()) & ENERGISING

    def again(self, actions: Actions) -> tuple[Any, ...] | None:
        """Return the command word, for an instrument that drives no stimulus and moves nothing."""
        if self.asks or any(action.effect in _NO_RAW_AGAIN for action in actions.values()):
            return None
        return 2, self.role, self.text.split(maxsplit=1)[0]

    def leaves(self, actions: Actions) -> bool:
        """Return whether something is expected of the reply."""
        return QUANTITY in self.conditions

    def written(self, drivers: Drivers) -> Values:
        """Return it as a sequence has it."""
        return {self.kind: {self.role: self.text}}


@dataclass(frozen=True, slots=True)
class PlannedSettle(Step):
    """Wait; ``bus_s`` is the bus time of the calls that share the wait."""

    kind: ClassVar[str] = "settle"
    on_the_bus: ClassVar[bool] = False
    proof: ClassVar[type[Event] | None] = None

    bus_s: float

    effects = no_effect  # it waits
    again = not_again  # it is done behind the step that it stands behind
    leaves = nothing

    def written(self, drivers: Drivers) -> Values:
        """Return it as a sequence has it."""
        return {self.kind: _quantity(self.duration_s, "s")}


@dataclass(frozen=True, slots=True)
class Reading:
    """One reading of a record: an action that only measures; ``quantity`` is its name in the results, "" for none."""

    role: str
    name: str
    arguments: Values
    quantity: str = ""

    def told(self) -> dict[str, Any]:
        """Return it as it stands in a plan file."""
        told = asdict(self)
        return told if self.quantity else {name: value for name, value in told.items() if name != QUANTITY}


@dataclass(frozen=True, slots=True)
class PlannedRecord(Step):
    """Take a record of frames, or of ``readings``, one round of them each ``every_s``.

    ``retry``: how often it may be taken again, from step ``retry_step`` on; ``max_lost``: share of frames or readings
    that may be lost. ``follows``: there is no gap between it and the record before of its link. ``together``: it begins
    with the record before it, which is of another unit. ``signals``: quantity and name of
    each signal that is kept.
    ``longest_s``: what it would last at most, if a stop rule has made it last no longer than it need; else 0.
    """

    kind: ClassVar[str] = "record"
    on_the_bus: ClassVar[bool] = False
    proof: ClassVar[type[Event] | None] = Record

    seconds: float
    retry: int
    max_lost: float
    purpose: str
    retry_step: int
    readings: tuple[Reading, ...] = ()
    every_s: float = 0.0
    pulse_timing: bool = False
    samples: bool = False
    follows: bool = False
    together: bool = False
    signals: tuple[tuple[str, str], ...] = ()
    longest_s: float = 0.0

    effects = no_effect  # its readings only measure
    again = not_again  # what it took is kept
    leaves = nothing

    def written(self, drivers: Drivers) -> Values:
        """Return it as a sequence has it. Raises: InputError B-RES-008 for one of several that belong together."""
        if self.samples:
            why = "records of samples on a table cannot be taken again one by one: each depends on how it was mounted"
            raise cannot_be_taken_again(self, why, "run")
        if self.follows or "window_index" in self.conditions:
            why = "records without a gap over a changing temperature cannot be taken again one by one"
            raise cannot_be_taken_again(self, why, "ramp")
        record: dict[str, Any] = {"seconds": _quantity(self.seconds, "s")}
        if self.readings:
            record["every"] = _quantity(self.every_s, "s")
            record["readings"] = [expected_reading(call, drivers) for call in self.calls]
        if self.signals:
            record["expect"] = [{"name": quantity, "signal": signal} for quantity, signal in self.signals]
        if self.retry:
            record["retry"] = self.retry
        if self.max_lost:
            record["max_lost"] = _quantity(self.max_lost, "1")
        if self.pulse_timing:
            record["pulse_timing"] = True
        if self.purpose != MEASUREMENT:
            record["purpose"] = self.purpose
        if "label" in self.conditions:
            record["label"] = self.conditions["label"]
        conditions = (_condition(*of) for of in self.conditions.items() if of[0] not in _AUTOMATIC)
        return {self.kind: {**record, "conditions": dict(conditions)}}

    @property
    def quantities(self) -> list[str]:
        """Return the quantities that it reads."""
        named = [reading.quantity for reading in self.readings if reading.quantity]
        return [*named, *(quantity for quantity, _ in self.signals)]

    @classmethod
    def taken(cls, arguments: Values) -> Values:
        """Return the arguments of a plan file as the step holds them."""
        readings = tuple(Reading(**reading) for reading in arguments.get("readings", ()))
        signals = tuple((quantity, signal) for quantity, signal in arguments.get("signals", ()))
        return {**arguments, "readings": readings, "signals": signals}

    def told(self) -> dict[str, Any]:
        """Return the arguments as they stand in a plan file."""
        told = Step.told(self)
        return {**told, "readings": [reading.told() for reading in self.readings]} if self.readings else told

    @property
    def calls(self) -> tuple[PlannedCall, ...]:
        """Return its readings as call steps."""
        place = self.number, self.phase, self.at_s, self.duration_s
        return tuple(
            PlannedCall(*place, reading.role, reading.name, self._conditions(reading), self.where, reading.arguments)
            for reading in self.readings
        )

    def _conditions(self, reading: Reading) -> Values:
        return {**self.conditions, QUANTITY: reading.quantity} if reading.quantity else self.conditions


@dataclass(frozen=True, slots=True)
class PlannedSoak(Step):
    """Ramp the chamber and wait out a slot; it must end ``within_degC`` of the target, and have been so for ``for_s``.

    ``sensor``: "unit" or "air"; ``late``: what happens if it is not: "hold" for ``hold_limit_s`` more, "skip", "abort".
    With ``residual_degC`` the rest of the slot is left out, not before ``least_s``, once the unit is so near its end.
    """

    kind: ClassVar[str] = "soak"
    on_the_bus: ClassVar[bool] = False
    proof: ClassVar[type[Event] | None] = None
    may_end: ClassVar[bool] = True

    temperature_degC: float
    ramp_degC_min: float
    slot_s: float
    within_degC: float
    for_s: float
    sensor: str
    late: str
    hold_limit_s: float
    residual_degC: float | None = None
    least_s: float | None = None

    def effects(self, actions: Actions) -> frozenset[Effect]:
        """Return that it heats or cools."""
        return frozenset({Effect.THERMAL})

    again = not_again  # the way back sets the chamber
    leaves = nothing

    def written(self, drivers: Drivers) -> Values:
        """Return it as a sequence has it."""
        stable = {"within": _quantity(self.within_degC, "degC"), "for": _quantity(self.for_s, "s")}
        soak: dict[str, Any] = {"chamber": self.role, "temperature": _quantity(self.temperature_degC, "degC")}
        soak |= {"ramp": _quantity(self.ramp_degC_min, "degC/min"), "slot": _quantity(self.slot_s, "s")}
        soak |= {"stable": {**stable, "sensor": self.sensor}, "late": self.late}
        soak |= {"hold_limit": _quantity(self.hold_limit_s, "s")}
        if self.residual_degC is not None and self.least_s is not None:
            soak["done"] = {"residual": _quantity(self.residual_degC, "degC"), "least": _quantity(self.least_s, "s")}
        return {self.kind: soak}

    def confirmed(self, actions: Actions) -> Values:
        """Return the target, as a call of the chamber has it."""
        return {f"{self.role}.set_temperature": {"temperature": self.temperature_degC, "ramp": self.ramp_degC_min}}

    @property
    def set_point(self) -> SetPoint:
        """Return what the soak asks of the air of the chamber."""
        return SetPoint(self.temperature_degC, self.ramp_degC_min)


@dataclass(frozen=True, slots=True)
class PlannedPrompt(Step):
    """Ask a person to do something, or with a ``unit`` for a value between ``low`` and ``high``.

    ``sets`` is what the act changes on the bench, by name. ``quantity`` names a value that is a measurement of the unit
    under test and is judged later, "" for one that must be inside its limits; if one that is ``required`` is not, the
    steps behind it under the same conditions are left out. ``presence``: where it is answered, "bench" or "anywhere".
    """

    kind: ClassVar[str] = "prompt"
    on_the_bus: ClassVar[bool] = False
    proof: ClassVar[type[Event] | None] = Prompt
    unread: ClassVar[float | None] = None

    text: str
    confirm: str
    sets: Values = field(default_factory=dict)
    unit: str = ""
    low: float | None = None
    high: float | None = None
    quantity: str = ""
    required: bool = False
    presence: str = "bench"

    effects = no_effect  # what is done is done by the person, who stands beside it
    again = not_again  # what the person changed stays
    leaves = an_event

    def written(self, drivers: Drivers) -> Values:
        """Return it as a sequence has it."""
        prompt: dict[str, Any] = {"text": self.text, "confirm": self.confirm}
        if self.unit:
            asked = {"low": self.low, "high": self.high}
            limits = {key: _quantity(limit, self.unit) for key, limit in asked.items() if limit is not None}
            judged: dict[str, Any] = {"quantity": self.quantity} if self.quantity else {}
            judged |= {"required": True} if self.required else {}
            prompt["value"] = {"unit": self.unit, **limits, **judged}
        return {self.kind: prompt}

    @property
    def quantities(self) -> list[str]:
        """Return the quantity that it asks for."""
        return [self.quantity] if self.quantity else []

    def told(self) -> dict[str, Any]:
        """Return the arguments as they stand in a plan file."""
        sets = {"sets": dict(self.sets)} if self.sets else {}
        value = {"unit": self.unit, "low": self.low, "high": self.high} if self.unit else {}
        judged: dict[str, Any] = {"quantity": self.quantity} if self.quantity else {}
        judged |= {"required": True} if self.required else {}
        judged |= {"presence": self.presence} if self.presence != "bench" else {}
        return {"text": self.text, "confirm": self.confirm, **sets, **value, **judged}


@dataclass(frozen=True, slots=True)
class PlannedCommand(Step):
    """Send a command to the unit under test; one with an ``item`` is a test of it, and its outcome is judged later.

    ``timeout_s``: how long the answer may take; ``takes_s``: how long it takes by plan. None where the plan leaves it
    to the software.
    """

    kind: ClassVar[str] = "unit"
    on_the_bus: ClassVar[bool] = True
    proof: ClassVar[type[Event] | None] = Answer
    may_end: ClassVar[bool] = True

    code: int
    payload: tuple[int, ...]
    timeout_s: float | None = None
    item: str = ""
    takes_s: float | None = None

    effects = no_effect  # it changes the unit, which the bench supplies

    def again(self, actions: Actions) -> tuple[Any, ...] | None:
        """Return each command once, but no test of the unit."""
        return None if self.item else (3, self.role, self.name)

    def leaves(self, actions: Actions) -> bool:
        """Return whether it is a test of the unit, or something is expected of the reply."""
        return bool(self.item) or QUANTITY in self.conditions

    def written(self, drivers: Drivers) -> Values:
        """Return it as a sequence has it. Raises: InputError B-RES-008 for one of the frame with arguments."""
        if self.timeout_s is not None and self.payload:
            why = f"the arguments of the command {self.name!r} stand in the plan as bytes only"
            raise cannot_be_taken_again(self, why, "run")
        if not self.item:
            return {self.kind: {self.role: self.name}}
        takes = {} if self.takes_s is None else {"takes": _quantity(self.takes_s, "s")}
        return {"test": {"link": self.role, "item": self.item, "command": self.name, **takes}}

    @classmethod
    def taken(cls, arguments: Values) -> Values:
        """Return the arguments of a plan file as the step holds them."""
        return {**arguments, "payload": tuple(arguments["payload"])}


def expected_reading(call: PlannedCall, drivers: Drivers) -> Values | str:
    """Return a call as a sequence has it, with the name of the value it reads; what is expected of it is left out."""
    form = call.written(drivers)
    if QUANTITY in call.conditions:
        return {**form, "expect": {"name": call.conditions[QUANTITY]}}
    return form if call.arguments else next(iter(form))


def _in_unit(value: Any, unit: str) -> Any:
    return _quantity(value, unit) if unit and isinstance(value, int | float) else value


def _quantity(value: float, unit: str) -> str:
    return f"{Decimal(repr(float(value))) * 100:f} %" if unit == "1" else f"{value!r} {unit}"


def _condition(name: str, value: Any) -> tuple[str, Any]:
    """Return a condition as it was written: ``("current_A", 0.01)`` was ``current: 0.01 A``."""
    for unit, suffix in sorted(SUFFIX.items(), key=lambda known: len(known[1]), reverse=True):
        if suffix and name.endswith(f"_{suffix}") and isinstance(value, float):
            return name.removesuffix(f"_{suffix}"), _quantity(value, unit)
    return name, value


def is_measurement(conditions: Values) -> bool:
    """Return whether a record counts as one of the campaign's (those of the wiring check do not)."""
    return bool(conditions.get("purpose", MEASUREMENT) == MEASUREMENT)


def step_of(row: Values) -> Step:
    """Return a step from its row of a plan file."""
    if row.keys() != set(ROW):
        raise ValueError(f"the row of a step holds {sorted(row)}")
    place: Any = tuple(row[name] for name in PLACE)
    return KINDS[row["kind"]].read(place, row["arguments"])


def plan_json(steps: Iterable[Step]) -> str:
    """Return the text of a session's ``plan.json``."""
    return json.dumps([step.as_json() for step in steps], separators=(",", ":"), default=dict)


def steps_of(text: str, where: str = "plan.json") -> tuple[Step, ...]:
    """Return the steps of a session's ``plan.json``. Raises: SessionDamaged B-RES-004 if it is not one."""
    try:
        return tuple(step_of(row) for row in json.loads(text))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise SessionDamaged(
            "B-RES-004",
            f"the plan in the session cannot be read: {error!r}",
            where=where,
            next_step="'bench recover' lists what the session still holds",
        ) from error
