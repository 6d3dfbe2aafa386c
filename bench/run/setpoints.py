"""The set-points of the bench, their readback, and the steps that bring them back: supplies, generator, unit, tables.

A driver reads back what it sets before it returns, so a finished step is a verified set-point. After a table was made
safe its interlock is closed again if it was closed; each axis goes by an absolute move to where its moves and turns had
brought it, or spins again. A stimulus that was on is set and switched on again, unless the plan does so itself before
anything is recorded or read.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from bench.model.clock import Clock, to_ns
from bench.model.errors import InstrumentError
from bench.model.ports import (
    DE_ENERGISING,
    SWITCHED_ON,
    SWITCHES,
    Action,
    Drivers,
    Effect,
    Instrument,
    actions_of,
    can_move,
    effects_of,
)
from bench.plan import Plan, PlannedCall, PlannedRecord, PlannedSend, PlannedSettle, Step, Steps
from bench.record import JournalEntry

READ_BACK_S = 3.0  # looking at the bench must not keep it from being made safe
VOLTAGE_WITHIN = 0.05  # of the set-point
AIR_WITHIN_degC = 2.0
_ASKED = ("operating", "closed", "measure_voltage", "measure_air")
Readings = dict[str, dict[str, Any]]
_DRIVEN = frozenset((Effect.STIMULUS_ON, Effect.ROUTE))
_SWITCHED = _DRIVEN | {Effect.STIMULUS_OFF, Effect.ROUTES_OPEN}
_MOVE, _TURN, _SPIN = "move", "turn", "spin"
_STOP = "stop"


def expected_of(entries: Iterable[JournalEntry]) -> Readings:
    """Return newest arguments of every action by role, oldest first; of switching on and off only the last."""
    expected: Readings = {}
    for entry in entries:
        for name, arguments in entry.setpoint.items():
            role, action = name.split(".", 1)
            state = expected.setdefault(role, {})
            for other in SWITCHES if action in SWITCHES else ():
                state.pop(other, None)
            state.pop(action, None)
            state[action] = arguments
    return expected


def read_back(instruments: Mapping[str, Instrument], clock: Clock) -> Readings:
    """Ask every instrument that drives something what it does now; nothing is set. What does not answer is left out.

    Takes ``READ_BACK_S`` and one question more at most.
    """
    readings: Readings = {}
    limit_ns = clock.now_ns() + to_ns(READ_BACK_S)
    for role, instrument in instruments.items():
        declared = actions_of(type(instrument))
        if not any(action.effect is not Effect.NONE for action in declared.values()):
            continue
        for name in _ASKED:
            if name in declared and not declared[name].parameters and clock.now_ns() < limit_ns:
                try:
                    readings.setdefault(role, {})[name] = getattr(instrument, name)()
                except InstrumentError:
                    break
    return readings


def differences(expected: Mapping[str, Mapping[str, Any]], actual: Readings) -> list[str]:
    """Return sentences about what is not as the last finished step had left it."""
    said = []
    for role, readings in actual.items():
        state = expected.get(role, {})
        for name, value in readings.items():
            if state and (text := _difference(name, value, state)):
                said.append(f"{role}: {text}")
    return said


def _difference(name: str, value: Any, state: Mapping[str, Any]) -> str:
    on = any(word in state for word in SWITCHED_ON)
    if name == "operating" and bool(value) != on:
        return f"output was {_word(on)}, is {_word(bool(value))}"
    if name == "closed" and bool(value) != ("route" in state):
        return f"a route was {'closed' if 'route' in state else 'open'}, closed are now {', '.join(value) or 'none'}"
    if name == "measure_voltage" and "voltage" in state.get("configure", {}):
        set_V = float(state["configure"]["voltage"])
        due_V = set_V if on else 0.0
        far = abs(float(value) - due_V) > VOLTAGE_WITHIN * abs(set_V)
        return f"was at {due_V:g} V, is at {value:.3g} V" if far else ""
    if name == "measure_air" and "temperature" in state.get("set_temperature", {}):
        due_degC = float(state["set_temperature"]["temperature"])
        far = abs(float(value) - due_degC) > AIR_WITHIN_degC
        return f"set-point {due_degC:g} degC, air is at {value:.1f} degC" if far else ""
    return ""


def _word(on: bool) -> str:
    return "on" if on else "off"


def steps_again(plan: Plan, first: int, drivers: Drivers, left_out: Container[int] = ()) -> list[Step]:
    """Return steps before ``first`` that bring supplies, generator and unit back after everything was made safe.

    The last call of each action (of each rail; on and off are one), settings before switches, then the last raw text
    of each command word to instruments that drive no stimulus and move nothing, then the last of each unit command;
    each with the settle time behind it. Prompts, stimulus, relays, readings, motion and the chamber are left out: the
    point itself sets the stimulus, reentry moves tables (motion_again) and sets the chamber.

    Args: drivers: declared actions by role.   left_out: numbers of steps that a decision has left out.
    """
    last: dict[tuple[Any, ...], int] = {}
    for step in plan.steps[:first]:
        key = step.again(drivers.get(step.role, {}))
        if key is not None and step.number not in left_out:
            last.pop(key, None)
            last[key] = step.number
    ordered = sorted(last, key=lambda key: (key[0], last[key]))
    again: list[Step] = []
    for key in ordered:
        again.append(plan.steps[last[key]])
        behind = plan.steps[last[key] + 1 : last[key] + 2]
        again += [step for step in behind if isinstance(step, PlannedSettle)]
    return again


def warm_up_s(plan: Plan, first: int, left_out: Container[int] = ()) -> float:
    """Return longest settle time in preparation behind what switched something on, before step ``first``, seconds."""
    before = [step for step in plan.steps[:first] if step.phase == "prepare" and step.number not in left_out]
    on = next(
        (at for at, step in enumerate(before) if isinstance(step, PlannedCall) and step.name in SWITCHED_ON),
        len(before),
    )
    return max((step.duration_s for step in before[on:] if isinstance(step, PlannedSettle)), default=0.0)


def goes_off(driver: type) -> bool:
    """Return True for an instrument that a hold makes safe: it drives a stimulus or leads it to the unit, or moves."""
    return drives(driver) or Effect.MOTION_ON in effects_of(driver)


def drives(driver: type) -> bool:
    """Return True for an instrument that drives a stimulus or leads it to the unit."""
    return not effects_of(driver).isdisjoint(_DRIVEN)


def is_motion(step: Step) -> bool:
    """Return whether a step of the plan sets an axis of a table moving."""
    return isinstance(step, PlannedCall) and step.name in (_MOVE, _TURN, _SPIN) and step.axis is not None


def motion_again(steps: Steps, number: int, drivers: Drivers, left_out: Container[int] = ()) -> list[Step]:
    """Return calls and settle times that bring all tables to where they were before step ``number``, in order.

    None inside ``finally``, where nothing has to move any more. An axis that was only turned, never moved, has no known
    angle to come back to; it stays where it is.
    """
    if number < len(steps) and steps[number].phase == "finally":
        return []
    again: list[Step] = []
    done = [step for step in steps[:number] if step.number not in left_out]
    for role in sorted(role for role, actions in drivers.items() if can_move(actions)):
        calls = [step for step in done if isinstance(step, PlannedCall) and step.role == role]
        closed = _closed(calls, drivers[role])
        if closed is not None:
            again += [closed, *_settle_behind(steps, closed.number, number)]
            again += _axes(steps, calls, number, drivers[role])
    return again


def stimulus_again(
    steps: Steps, number: int, drivers: Drivers, left_out: Container[int] = (), roles: Container[str] | None = None
) -> list[Step]:
    """Return steps that bring stimulus and routes to what step ``number`` finds, levels before switches; a settle time.

    Left out is an instrument that the plan switches off, or switches anew as a whole, before anything is recorded or
    read, and a level that it sets anew before it switches on. Of raw text, which may have switched anything, the last
    of each command word is done again. None inside ``finally``. ``roles``: those that are looked at, None for all.
    """
    if number == len(steps) or steps[number].phase == "finally":
        return []
    again: list[Step] = []
    noted = _noted(steps, number, drivers)
    for role, actions in drivers.items():
        if roles is not None and role not in roles:
            continue
        own = [step for step in steps if step.role == role and step.number not in left_out]
        done = [step for step in own if step.number < number]
        coming = own[len(done) :]
        levels, switches = _in_force(done, actions)
        anew = [step for step in coming if step.number < noted and step.effects(actions) & _SWITCHED]
        replaced = switches.keys() <= {_identity(step, actions) for step in anew}
        if replaced or any(_turns_off(step, actions) for step in anew):
            switches = {}
        again += [step for step in levels.values() if switches or _is_used(step, coming, actions)]
        again += switches.values()
    again.sort(key=lambda step: (Effect.STIMULUS_SET not in step.effects(drivers[step.role]), step.number))
    waits = [wait for step in again for wait in _settle_behind(steps, step.number, number)]
    return [*again, *sorted(waits, key=lambda step: -step.duration_s)[:1]]


def _noted(steps: Steps, number: int, drivers: Drivers) -> int:
    """Return number of the first step from ``number`` on that records or reads, ``len(steps)`` if none does."""
    return next(
        (
            step.number
            for step in steps[number:]
            if isinstance(step, PlannedRecord) or step.leaves(drivers.get(step.role, {}))
        ),
        len(steps),
    )


def _in_force(done: Steps, actions: Mapping[str, Action]) -> tuple[dict[Any, Step], dict[Any, Step]]:
    """Return the last steps of an instrument that set each level, and that switched since all of it was off.

    Both by what a later step replaces (``_identity``).
    """
    levels: dict[Any, Step] = {}
    switches: dict[Any, Step] = {}
    for step in done:
        effects = step.effects(actions)
        if _turns_off(step, actions):
            switches = {}
        elif effects & _SWITCHED:
            switches[_identity(step, actions)] = step
        elif Effect.STIMULUS_SET in effects:
            levels[_identity(step, actions)] = step
    return levels, switches


def _turns_off(step: Step, actions: Mapping[str, Action]) -> bool:
    """Return whether behind a step the whole instrument is off; nobody knows that of raw text."""
    return isinstance(step, PlannedCall) and not DE_ENERGISING.isdisjoint(step.effects(actions))


def _identity(step: Step, actions: Mapping[str, Action]) -> Any:
    """Return what a later step of the same replaces: an action of the same choices, a route, a word of raw text."""
    if isinstance(step, PlannedSend):
        return step.text.split(maxsplit=1)[0]
    if not isinstance(step, PlannedCall):
        return step.kind, step.name
    if Effect.ROUTE in step.effects(actions):
        return Effect.ROUTE  # it closes one and opens every other one
    choices = [parameter.name for parameter in actions[step.name].parameters if parameter.choices]
    return step.name, *(step.arguments.get(name) for name in choices)


def _is_used(level: Step, coming: Steps, actions: Mapping[str, Action]) -> bool:
    """Return whether the instrument is switched on, by what is coming, before the level is set anew."""
    for step in coming:
        effects = step.effects(actions)
        if effects & _DRIVEN:
            return True
        if Effect.STIMULUS_SET in effects and _identity(step, actions) == _identity(level, actions):
            return False
    return False


def changes_motion(step: Step, drivers: Drivers) -> bool:
    """Return whether a step moves a table, or opens or closes its interlock."""
    return not step.effects(drivers.get(step.role, {})).isdisjoint((Effect.MOTION_ON, Effect.MOTION_OFF))


def _closed(calls: Sequence[PlannedCall], actions: Mapping[str, Action]) -> PlannedCall | None:
    """Return the call that closed the interlock, if it is closed."""
    closed = None
    for step in calls:
        effects = step.effects(actions)
        if Effect.MOTION_OFF in effects:
            closed = None
        elif Effect.MOTION_ON in effects and step.axis is None:
            closed = step
    return closed


def _axes(steps: Steps, calls: Sequence[PlannedCall], number: int, actions: Mapping[str, Action]) -> list[Step]:
    """Return the last motion of each axis as a move or a spin, and the longest settle time that follows one of them."""
    last: dict[int | None, PlannedCall] = {}
    for step in calls:
        if Effect.MOTION_OFF in step.effects(actions):  # what was turning came to rest, and stayed so
            last = {axis: call for axis, call in last.items() if call.name == _MOVE}
            continue
        axis, before = step.axis, last.get(step.axis)
        if step.name in (_MOVE, _SPIN):
            last[axis] = step
        elif step.name == _TURN and before is not None and before.name == _MOVE:
            angle = before.arguments["angle"] + step.arguments["angle"]
            last[axis] = replace(before, number=step.number, arguments={**before.arguments, "angle": angle % 360.0})
        elif step.name in (_TURN, _STOP) and not (before is not None and step.name == _STOP and before.name == _MOVE):
            last.pop(axis, None)
    motions = sorted(last.values(), key=lambda step: step.number)
    waits = [wait for step in motions for wait in _settle_behind(steps, step.number, number)]
    return [*motions, *sorted(waits, key=lambda step: -step.duration_s)[:1]]


def _settle_behind(steps: Steps, at: int, number: int) -> list[PlannedSettle]:
    """Return the first settle step behind step ``at``, before step ``number``."""
    return [step for step in steps[at + 1 : number] if isinstance(step, PlannedSettle)][:1]
