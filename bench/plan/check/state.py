"""Static check of order: what is switched on, closed, set and moving at each step of the plan.

An instrument is a table if its driver declares an action with the effect "motion on". One without an axis makes the
table ready (``close_interlock``), one with an ``axis`` moves it; ``set_limits`` says how fast an axis may be. What a
record says of the table and of the unit on it must be what was done before it: an analysis takes gravity and the
Earth's rate from these conditions, and a wrong one becomes a wrong number without any other sign.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, assert_never

from bench.model.drivers import driver_class
from bench.model.errors import InputError
from bench.model.ports import ENERGISING, Action, Drivers, Effect, can_move
from bench.model.quantities import Values
from bench.model.systems import declared_by
from bench.plan.check.actions import Judged
from bench.plan.decision import Followed
from bench.plan.findings import Findings
from bench.plan.plan import Plan, Step, no_effect
from bench.plan.station import Station, declared_action, driver_ladder_A, range_after, station_drivers
from bench.plan.step_kinds import PlannedCall, PlannedCommand, PlannedPrompt, PlannedRecord, PlannedSend, PlannedSoak

_LIMITED = ("rate", "acceleration")
_SET_LIMITS = "set_limits"
AXES = {1: "outer_deg", 2: "middle_deg", 3: "inner_deg"}
_MOVE, _TURN = "move", "turn"


class MotionState:
    """Follows the tables of a bench, step by step.

    Args: drivers: declared actions of each role. ``may_move`` holds the roles whose interlocks are closed,
    with the place where they were.
    """

    def __init__(self, plan: Plan, drivers: Drivers, findings: Findings) -> None:
        self._findings = findings
        self._origins = plan.origins
        self._tables = {role: actions for role, actions in drivers.items() if can_move(actions)}
        self._axes = {role: _axes_of(actions) for role, actions in self._tables.items()}
        self._limits: dict[tuple[str, Any], Values] = {}
        self.may_move: dict[str, str] = {}

    def copy(self) -> MotionState:
        """Return a state that goes on by itself."""
        other = copy(self)
        other._limits, other.may_move = dict(self._limits), dict(self.may_move)
        return other

    def key(self) -> Hashable:
        """Return what tells the state from others."""
        return repr(sorted(self._limits.items(), key=repr)), tuple(sorted(self.may_move.items()))

    def call(self, step: Step, action: Action, usable: Values) -> None:
        """Apply one call to a table; note what it breaks."""
        if step.role not in self._tables:
            return
        if action.name == _SET_LIMITS:
            self._set_limits(step, usable)
        elif action.effect is Effect.MOTION_OFF:
            self.may_move.pop(step.role, None)
        elif action.effect is Effect.MOTION_ON and "axis" in usable:
            self._motion(step, usable)
        elif action.effect is Effect.MOTION_ON:
            self._close(step)

    def raw(self, step: Step) -> None:
        """Raw text to a table may close its interlocks."""
        if step.role in self._tables:
            self.may_move.setdefault(step.role, step.where)

    def prompt(self, step: Step) -> None:
        """Whoever answers a prompt may stand at the table."""
        for role, where in sorted(self.may_move.items()):
            message = f"somebody is asked to act while the {role} may move (from {where} on)"
            self._findings.add("B-PLAN-087", step.where, message, "open its interlock before the prompt")

    def _set_limits(self, step: Step, usable: Values) -> None:
        if step.role in self.may_move:
            message = f"{step.role}.{step.name} is called with the interlock closed"
            self._findings.add("B-PLAN-088", step.where, message, "set the limits before the interlock is closed")
        self._limits[step.role, usable.get("axis")] = usable

    def _close(self, step: Step) -> None:
        missing = [axis for axis in self._axes[step.role] if (step.role, axis) not in self._limits]
        if missing:
            message = f"{step.role}.{step.name} before {_SET_LIMITS} of axis {', '.join(map(str, missing))}"
            self._findings.add("B-PLAN-088", step.where, message, "set the limits of every axis before it")
        self.may_move[step.role] = step.where

    def _motion(self, step: Step, usable: Values) -> None:
        limits = self._limits.get((step.role, usable["axis"]))
        missing = _SET_LIMITS if limits is None else "" if step.role in self.may_move else "the interlock is closed"
        if missing:
            message = f"{step.role}.{step.name} moves axis {usable['axis']} before {missing}"
            self._findings.add("B-PLAN-088", step.where, message, "set the limits, close the interlock, then move")
        for name in _LIMITED if limits is not None else ():
            most, value = (limits or {}).get(name), usable.get(name)
            if most is not None and value is not None and abs(value) > most:
                message = f"{step.role}.{step.name}: {name} {value:g} is above {most:g}, the limit set for this axis"
                origin = self._origins[step.number].get(name, "")
                self._findings.add("B-PLAN-089", step.where, message, "move slower, or set a higher limit", origin)


def _axes_of(actions: Mapping[str, Action]) -> tuple[Any, ...]:
    """Return the axes that have limits to be set."""
    parameters = actions[_SET_LIMITS].parameters if _SET_LIMITS in actions else ()
    return next((parameter.choices for parameter in parameters if parameter.name == "axis"), ())


@dataclass
class Pose(Followed):
    """Where the axes were sent, None if nobody knows, and what prompts have set, by name.

    Findings: B-PLAN-076 (a record whose conditions differ from that).
    """

    station: Station
    findings: Findings
    angles: dict[str, float | None] = field(default_factory=dict)
    was_set: dict[str, Any] = field(default_factory=dict)

    def take(self, step: Step) -> None:
        if isinstance(step, PlannedCall):
            if _moves(step, self.station):
                _follow(step, self.angles)
        elif isinstance(step, PlannedRecord | PlannedCommand):
            wrong = [*_poses(step, self.angles), *_sets(step.conditions, self.was_set)]
            if wrong:
                what = "record" if isinstance(step, PlannedRecord) else "command"
                message = f"the {what} says what the bench does not do: " + "; ".join(wrong)
                self.findings.add("B-PLAN-076", step.where, message, "correct the conditions, or the steps before it")
        else:
            self.was_set |= step.sets

    def copy(self) -> Pose:
        return replace(self, angles=dict(self.angles), was_set=dict(self.was_set))

    def key(self) -> Hashable:
        return repr((sorted(self.angles.items()), sorted(self.was_set.items())))


def _moves(step: Step, station: Station) -> bool:
    declared = declared_action(station, step.role, step.name)
    return declared is not None and declared.effect is Effect.MOTION_ON


def _follow(step: PlannedCall, angles: dict[str, float | None]) -> None:
    """A move goes to an angle, a turn goes on from the demand before it; behind anything else nobody knows."""
    name, angle = AXES.get(step.axis or 0), step.quantity("angle")
    if name is None:
        return
    before = angles.get(name)
    if angle is None or step.name not in (_MOVE, _TURN):
        angles[name] = None
    elif step.name == _MOVE:
        angles[name] = angle
    else:
        angles[name] = None if before is None else before + angle


def _poses(step: Step, angles: Mapping[str, float | None]) -> Iterator[str]:
    if not isinstance(step, PlannedRecord) or step.conditions.get("continues"):  # that one begins within the motion
        return
    for name, angle in angles.items():
        said = step.conditions.get(name)
        if angle is None or not isinstance(said, float | int):
            continue
        if not math.isclose(math.remainder(said - angle, 360.0), 0.0, abs_tol=1e-9):
            yield f"{name.removesuffix('_deg')} axis at {said:g} deg, but the table was sent to {angle:g} deg"


def _sets(conditions: Values, was_set: Values) -> Iterator[str]:
    for name, value in was_set.items():
        if name in conditions and conditions[name] != value:
            yield f"{name} {conditions[name]}, but the operator was told {value}"


_RELEASES = ("output_off", "stop")
_FOLLOWED = ("energised", "output_on", "unknown", "untrusted", "closed", "level_A", "range_A", "meter_A")
_OVER_RANGE = 1.2  # a meter reads up to 120 % of a range


class BenchState(Followed):
    """Follows the effects of the steps.

    ``raw`` effects are unknown: after raw text to an instrument with an output, that output counts as on until a call
    switches it off; after raw text to a switch, its route counts as unknown until a call routes or opens it.
    ``untrusted`` roles had a call that could not be read: what is said of their order from there on would be guessed.
    ``closed`` holds the arguments of the route that each switch has closed; ``level_A`` and ``range_A`` what each
    source was last set to (None: not known), ``used_A`` every range a source or a meter was set to,
    ``meter_A`` the range a meter is on;
    ``target_degC`` is where the temperature was last sent; ``motion`` follows the tables that move.
    """

    def __init__(self, plan: Plan, station: Station, findings: Findings, judge: Callable[[Step], Judged]) -> None:
        self._findings = findings
        self._station = station
        self._judge = judge
        self._origins = plan.origins
        asked = declared_by(plan.campaign)
        self._metered = asked is not None and bool(asked.reading)
        channels = plan.campaign.get("channels", [])
        self._full_scale = {int(c["number"]): float(c["full_scale_A"]) for c in channels}
        self._levels_A = {int(c["number"]): frozenset(c.get("levels_A", ())) for c in channels}
        self._actions = station_drivers(station)
        self._effects = {
            role: frozenset(action.effect for action in known.values()) for role, known in self._actions.items()
        }
        self.motion = MotionState(plan, self._actions, findings)
        self.switches = _with(Effect.ROUTE, self._effects)
        self.sources = _with(Effect.STIMULUS_ON, self._effects)
        self.energised: dict[str, str] = {}
        self.output_on: set[str] = set()
        self.unknown: set[str] = set()
        self.untrusted: set[str] = set()
        self.closed: dict[str, Values] = {}
        self.level_A: dict[str, float | None] = {}
        self.range_A: dict[str, float | None] = {}
        self.used_A: dict[str, set[float]] = {}
        self.meter_A: dict[str, float] = {}
        self.target_degC: float | None = None

    def copy(self) -> BenchState:
        """Return a state that goes on by itself; the ranges that are used are collected from both."""
        other = copy(self)
        for name in _FOLLOWED:
            setattr(other, name, copy(getattr(self, name)))
        other.motion = self.motion.copy()
        return other

    def key(self) -> Hashable:
        """Return what tells the state from others."""
        followed = (getattr(self, name) for name in _FOLLOWED)
        return tuple(_told(value) for value in followed), self.target_degC, self.motion.key()

    def take(self, step: Step) -> None:
        """Apply one step; note what it breaks."""
        self.apply(step, self._judge(step))

    def apply(self, step: Step, judged: Judged) -> None:
        """Apply one step, or one of a record's readings, of which this action is declared."""
        if isinstance(step, PlannedSoak):
            self.target_degC = None if math.isnan(step.temperature_degC) else step.temperature_degC
            self._energise(step, step.role)
        elif isinstance(step, PlannedSend):
            self._raw(step, self._effects.get(step.role, frozenset()), "raw text to")
        elif isinstance(step, PlannedPrompt):
            self.motion.prompt(step)
        elif isinstance(step, PlannedCall) and judged.action is not None:
            self._call(step, judged.action.effect, judged.usable)
            self.motion.call(step, judged.action, judged.usable)
            self._measure(step.role, judged.usable)
            if judged.action.returns == "A":
                self._readable(step)
        elif isinstance(step, PlannedCall):
            self._forget(step.role)
        elif type(step).effects is not no_effect:
            self._raw(step, step.effects(self._actions.get(step.role, {})), f"a {step.kind} step of")

    def _forget(self, role: str) -> None:
        """A call that names nothing may have been meant for the source or the switch: their order is not judged."""
        if role not in self._station.instruments or not self._effects.get(role):
            self.untrusted |= self.switches | self.sources
        self.untrusted |= {role} & (self.switches | self.sources)

    def _call(self, step: Step, effect: Effect, usable: Values) -> None:
        role = step.role
        match effect:
            case Effect.ROUTE | Effect.ROUTES_OPEN:
                self._route(step, effect, usable)
            case Effect.STIMULUS_SET:
                self._set(role, usable)
                self._within_full_scale(step, role)
            case Effect.STIMULUS_ON:
                self._switch_on(step)
            case Effect.STIMULUS_OFF:
                self.output_on.discard(role)
                self.unknown.discard(role)
                self.energised.pop(role, None)
            case Effect.THERMAL if "temperature" in usable:
                self.target_degC = usable["temperature"]
                self._energise(step, role)
            case Effect.THERMAL | Effect.POWER | Effect.MOTION_ON if step.name not in _RELEASES:
                self._energise(step, role)
            case Effect.THERMAL | Effect.POWER | Effect.MOTION_ON | Effect.MOTION_OFF:
                self.energised.pop(role, None)
            case Effect.NONE:
                pass
            case _:
                assert_never(effect)

    def _set(self, role: str, usable: Values) -> None:
        level_A = usable.get("current")
        self.level_A[role] = level_A
        ladder_A = driver_ladder_A(self._station.instruments[role].driver) or self._station.ranges_A(role)
        locked = usable.get("range") == "locked"
        held_A = None if level_A is None else range_after(ladder_A, level_A, locked, self.range_A.get(role))
        self.range_A[role] = held_A
        if held_A is not None:
            self.used_A.setdefault(role, set()).add(held_A)

    def _measure(self, role: str, usable: Values) -> None:
        """Range of a meter that is a standard: the register gives it uncertainties, or the analysis asks for them."""
        wanted_A = usable.get("range")
        if role in self.sources or not isinstance(wanted_A, float):
            return
        if not self._metered and not self._station.ranges_A(role):
            return
        held_A = range_after(driver_ladder_A(self._station.instruments[role].driver), wanted_A, False, None)
        if held_A is not None:
            self.used_A.setdefault(role, set()).add(held_A)
            self.meter_A[role] = held_A

    def _readable(self, step: Step) -> None:
        """A reading of the loop's current must fit the range of the meter: an overload costs the point it is for."""
        limit_A = self.meter_A.get(step.role)
        if limit_A is None or self.untrusted:
            return
        for role in sorted(self.output_on - self.unknown):
            level_A = self.level_A.get(role)
            if level_A is not None and abs(level_A) > _OVER_RANGE * limit_A:
                message = f"{step.role} is on its {limit_A:g} A range and cannot read the {level_A:g} A of {role}"
                self._findings.add("B-PLAN-079", step.where, message, "configure a range that holds the level")

    def _route(self, step: Step, effect: Effect, usable: Values) -> None:
        if self.output_on and not self.untrusted:
            source = sorted(self.output_on)[0]
            state = "may be on after a raw command" if source in self.unknown else "is on"
            message = f"{step.role}.{step.name} moves a relay while the output of {source} {state}"
            self._findings.add(
                "B-PLAN-070", step.where, message, f"call the action that switches {source} off before it"
            )
        self.unknown.discard(step.role)
        self.closed.pop(step.role, None)
        if effect is Effect.ROUTES_OPEN:
            return
        if self.closed and not self.untrusted:
            other = sorted(self.closed)[0]
            message = f"{step.role}.{step.name} closes a second route; one of {other} is closed already"
            self._findings.add("B-PLAN-071", step.where, message, f"open the routes of {other} before it")
        self.closed[step.role] = usable
        self._exit(step, step.role)

    def _switch_on(self, step: Step) -> None:
        role = step.role
        if self.switches and not self.closed and not self.untrusted:
            message = f"{role}.{step.name} switches the output on without a closed route"
            self._findings.add("B-PLAN-072", step.where, message, "route it before")
        self.output_on.add(role)
        self._within_full_scale(step, role)
        self._energise(step, role)

    def _within_full_scale(self, step: Step, role: str) -> None:
        channel = next((route["channel"] for route in self.closed.values() if "channel" in route), None)
        limit_A = self._full_scale.get(channel) if isinstance(channel, int) else None
        level_A = self.level_A.get(role)
        if channel is not None and level_A in self._levels_A.get(channel, ()):
            return  # noted where the level is declared
        if limit_A is not None and level_A is not None and abs(level_A) > limit_A and not self.untrusted:
            message = f"{level_A:g} A is above the full scale {limit_A:g} A of channel {channel}"
            origin = self._origins[step.number].get("current", "")
            self._findings.add("B-PLAN-073", step.where, message, origin=origin)

    def _raw(self, step: Step, effects: frozenset[Effect], what: str) -> None:
        """Apply a step of which nobody can see what it does of that; ``what`` it is, in words."""
        if Effect.STIMULUS_ON in effects:
            if self.switches and not self.closed and not self.untrusted:
                self._doubt(step, what, "may switch its output on without a closed route")
            self.output_on.add(step.role)
            self.unknown.add(step.role)
            self.level_A[step.role] = self.range_A[step.role] = None
        if Effect.ROUTE in effects:
            self._doubt(step, what, "may close any route, so the plan cannot be proved safe")
        if Effect.MOTION_ON in effects and not (isinstance(step, PlannedSend) and step.asks):
            self._doubt(step, what, "may move it, faster and further than its limits allow")
        if Effect.MOTION_ON in effects:
            self.motion.raw(step)
        if effects & ENERGISING:
            self._energise(step, step.role)

    def _doubt(self, step: Step, what: str, why: str) -> None:
        self._findings.add("B-PLAN-074", step.where, f"{what} {step.role} {why}", "write a call instead")

    def _energise(self, step: Step, role: str) -> None:
        self.energised[role] = step.where
        self._exit(step, role)

    def _exit(self, step: Step, role: str) -> None:
        """Whatever can hold energy or a closed relay must have a declared way to its safe state."""
        entry = self._station.instruments.get(role)
        if entry is None:
            return
        try:
            safe = callable(getattr(driver_class(entry.driver), "make_safe", None))
        except InputError:
            return
        if not safe:
            message = f"from here on {role} ({entry.driver}) has no way to a safe state: its driver has no make_safe"
            self._findings.add("B-PLAN-075", step.where, message)


def _told(value: Values | set[str]) -> Hashable:
    return frozenset((key, repr(of)) for key, of in value.items()) if isinstance(value, Mapping) else frozenset(value)


def _with(effect: Effect, effects: Mapping[str, frozenset[Effect]]) -> frozenset[str]:
    return frozenset(role for role, known in effects.items() if effect in known)
