"""Steps that do something: one function per kind, from the words of the file to the arguments of a plan step.

Commands to the unit under test: from the words of a step to the bytes that are sent.

A command is one of ``unit_commands`` of the sequence (number and payload as they are), or one that the frame of the
link declares; that one takes arguments by name and is encoded here, so that a value that does not fit is found before
the run.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel

from bench.frame import CommandLayout
from bench.model.errors import InputError
from bench.model.ports import Effect
from bench.model.quantities import Values
from bench.model.units import parse_quantity, plain_quantity
from bench.plan.deciding import expand_until
from bench.plan.expand import NO_TIME, TIMED, Node, check_whole
from bench.plan.expected import expand_readings, keep_given, keep_signals, named_conditions, reply_conditions
from bench.plan.findings import suggestion
from bench.plan.language.expect import ReadingExpect, ReplyExpect
from bench.plan.language.steps import (
    CallStep,
    PromptStep,
    ReadStep,
    Record,
    RecordStep,
    SendStep,
    SettleStep,
    Soak,
    SoakStep,
    Test,
    TestStep,
    TimelineEntry,
    UnitStep,
    VerifyStep,
)
from bench.plan.station import declared_action, no_instrument
from bench.plan.step_kinds import (
    WIRING,
    PlannedCall,
    PlannedCommand,
    PlannedPrompt,
    PlannedRecord,
    PlannedSend,
    PlannedSettle,
    PlannedSoak,
    PlannedVerify,
)
from bench.plan.values import REFERENCE, UNIT, Quantity, named, plain


def expand_unit(node: Node, step: UnitStep) -> None:
    """Append a command that must be done, else the run ends."""
    link, called = next(iter(step.unit.items()))
    own, plan = node.below("unit"), node.plan
    here = own.below(link)
    if not _takes_commands(here, link):
        return
    name, arguments = (called, {}) if isinstance(called, str) else next(iter(called.items()))
    command = plan.model.unit_commands.get(name)
    layout = plan.layouts.get(link, {}).get(name)
    if command is not None and not arguments:
        payload = tuple(bytes.fromhex(command.payload))
        conditions = reply_conditions(node, step.expect, (link, name), node.scope.context)
        plan.add(own, PlannedCommand, link, name, {"command": command.code, "payload": payload}, conditions=conditions)
    elif layout is not None:
        _append(here, node, link, layout, arguments or {}, {}, step.expect)
    else:
        _unknown(here, name, link)


def expand_test(node: Node, step: TestStep) -> None:
    """Append a command whose outcome is judged when the session is analysed."""
    test: Test = step.test
    link, own = test.link or node.plan.link, node.below("test")
    here = own.below("command")
    if not _takes_commands(here, link):
        return
    layout = node.plan.layouts.get(link, {}).get(test.command)
    if layout is None:
        _unknown(here, test.command, link)
        return
    more: dict[str, Any] = {"item": test.item}
    if test.takes is not None:
        more["takes"] = own.quantity(test.takes, "s", "takes")
    _append(own, node, link, layout, test.arguments, more)


def _takes_commands(node: Node, link: str) -> bool:
    frames = node.plan.model.frame
    if not frames:
        node.fail("B-PLAN-097", "the step sends a command to the unit, and the sequence names no link to it")
        return False
    if link not in frames:
        node.fail("B-PLAN-041", f"there is no link {link!r}{suggestion(link, frames)}")
        return False
    if link not in node.plan.command_links:
        node.fail("B-PLAN-039", f"{link} takes no commands: frame {frames[link]!r} has no 'command' message")
    return True


def _unknown(node: Node, name: str, link: str) -> None:
    plan = node.plan
    if link not in plan.layouts:
        return  # its frame cannot be read, and says so once
    known = [*plan.model.unit_commands, *plan.layouts.get(link, {})]
    message = f"neither 'unit_commands' nor the frame of {link} has {name!r}{suggestion(name, known)}"
    node.fail("B-PLAN-049", message)


def _append(
    node: Node, step: Node, link: str, layout: CommandLayout, given: Values, more: Values,
    expect: ReplyExpect | None = None,
) -> None:  # fmt: skip
    values: dict[str, Any] = {}
    conditions = dict(node.scope.context)
    for name, raw in given.items():
        value = node.resolve(raw, "arguments", name)
        if value is None:
            return
        values[name] = f"{value.value!r} {value.dimension}" if isinstance(value, Quantity) else plain(value)
        conditions[named(name, value)] = plain(value)
    try:
        payload = layout.encode(values)
    except InputError as error:
        node.fail("B-PLAN-091", f"command {layout.name!r}: {error.message}", error.next_step)
        return
    arguments = {"command": layout.code, "payload": tuple(payload), "timeout": layout.timeout_s, **more}
    conditions = reply_conditions(step, expect, (link, layout.name), conditions)
    node.plan.add(node, PlannedCommand, link, layout.name, arguments, conditions=conditions)


MOST_SAMPLES = 2_000_000  # of one record: it is held in memory until the analysis
MOST_TIMED_FRAMES = 100_000  # the square of the frame's number times its pulses still sums up exactly


def expand(node: Node, step: Any) -> None:
    """Append the steps of one structured step."""
    _EXPANDERS[type(step)](node, step)


def expand_entry(node: Node, entry: TimelineEntry) -> None:
    """Append the steps of one line of the flat form."""
    if entry.call is not None:
        expand(node.below("call"), entry.call)
    for word, kind in _OF_A_LINE.items():
        value = getattr(entry, word)
        if value is not None:
            expand(node, kind.model_construct(**{word: value, "expect": entry.expect}))


def _role(node: Node, role: str) -> str:
    """Return the station's name of a role; one that it does not have is noted (B-PLAN-040)."""
    plan = node.plan
    placed = plan.unit.roles.get(role, role) if plan.unit is not None else role
    if placed not in plan.station.instruments and not any(role in unit.roles for unit in plan.units):
        node.fail("B-PLAN-040", no_instrument(plan.station, role))
    return placed


def _duration(node: Node, raw: Any, *keys: str) -> Quantity | None:
    seconds = node.quantity(raw, "s", *keys)
    if seconds is not None and seconds.value < 0:
        node.below(*keys).fail("B-PLAN-031", f"the duration {seconds.value:g} s is negative", origin=seconds.origin)
        return None
    return seconds


def _read(node: Node, step: ReadStep) -> None:
    _call(node, step.call, step.expect)


def _call(node: Node, step: CallStep, expect: ReadingExpect | None = None) -> None:
    plan = node.plan
    called, arguments = next(iter(step.root.items()))
    role, name = called.split(".")
    placed, here = _role(node, role), node.below(called)
    values = here.values(arguments or {})
    if "current" in values:
        plan.programmed(role, values["current"], values.get("range") == "locked")
    declared = declared_action(plan.station, placed, name)
    if declared is not None and declared.effect is Effect.THERMAL:
        # the temperature moves on: the band of the soak before says nothing any more
        plan.known = replace(plan.known, settle_band_degC=None)
    plan.add(
        here,
        PlannedCall,
        role,
        name,
        values,
        conditions=named_conditions(node, (role, name), expect, node.scope.context),
    )


def _verify(node: Node, step: VerifyStep) -> None:
    role, name = step.verify.split(".")
    here = node.below("verify")
    _role(here, role)
    node.plan.add(here, PlannedVerify, role, name, {})


def _send(node: Node, step: SendStep) -> None:
    role, text = next(iter(step.send.items()))
    here = node.below("send")
    _role(here.below(role), role)
    conditions = reply_conditions(node, step.expect, (role, text), node.scope.context)
    node.plan.add(here, PlannedSend, role, "", {"text": text}, conditions=conditions)


def _settle(node: Node, step: SettleStep) -> None:
    here = node.below("settle")
    node.plan.add(here, PlannedSettle, "", "", {"bus_s": 0.0}, _duration(here, step.settle))


def _record(outer: Node, step: RecordStep) -> None:
    """Append one record step, or one for each of its windows: whole frames or rounds of readings, and conditions."""
    record, node, plan = step.record, outer.below("record"), outer.plan
    seconds = _duration(node, record.seconds, "seconds")
    if seconds is not None and not math.isnan(plan.rate_Hz):
        frames = seconds.value * plan.rate_Hz
        check_whole(node.below("seconds"), seconds, frames, f"frames at {plan.rate_Hz:g} Hz")
    conditions = {**node.scope.context}
    for name, value in node.below("conditions").values(record.conditions).items():
        conditions[named(name, value)] = plain(value)
    conditions["purpose"] = record.purpose
    if plan.known.settle_band_degC is not None and "temperature_degC" in conditions:
        conditions["settle_band_degC"] = plan.known.settle_band_degC
    arguments: dict[str, Any] = {
        "seconds": seconds,
        "retry": record.retry,
        "max_lost": node.quantity(record.max_lost, "1", "max_lost"),
        "purpose": record.purpose,
        "retry_step": len(plan.steps) if plan.retry_step is None else plan.retry_step,
    }
    read, quantities = expand_readings(node, record, seconds, conditions)
    arguments |= read
    if signals := keep_signals(node, record.expect, conditions):
        arguments["signals"] = signals
    if record.label is not None:
        conditions["label"] = record.label
    if record.pulse_timing:
        arguments["pulse_timing"] = True
        _can_keep(node.below("pulse_timing"), _PULSES, plan.counts_pulses, seconds)
    if record.samples:
        arguments["samples"] = True
        _can_keep(node.below("samples"), _SAMPLES, plan.has_samples, seconds)

    def take(length: Quantity | None, more: Values, own: Values) -> None:
        _windows(node, record, {**arguments, "seconds": length, **more}, {**conditions, **own}, length)

    if record.until is None or seconds is None:
        take(seconds, {}, {})
    else:
        expand_until(node, record, seconds, conditions, take)
    plan.keep_dimensions(quantities, record.windows or 1)


def _windows(node: Node, record: Record, arguments: Values, conditions: Values, seconds: Quantity | None) -> None:
    name, plan = record.label or record.purpose, node.plan
    if record.windows is not None and record.windows > 1 and record.retry:
        message = f"{record.windows} windows without a gap cannot be taken again (retry {record.retry})"
        advice = "leave 'retry' out; lost frames are counted in each window"
        node.below("retry").fail("B-PLAN-068", message, advice)
    for index in range(record.windows or 1):
        follows = {"follows": True} if record.follows or index else {}
        numbered = {} if record.windows is None else {"window_index": index}
        own, known = {**arguments, **follows}, {**conditions, **numbered}
        if plan.units:
            _of_units(node, name, own, known, seconds)
        else:
            plan.add(node, PlannedRecord, plan.link, name, own, seconds, known)


def _of_units(node: Node, name: str, arguments: Values, conditions: Values, seconds: Quantity | None) -> None:
    """Append a record of the unit of the loop, or one of each unit at once where there is no loop over them.

    A wiring record of one unit comes with one of every other, which nothing may move; that of the unit itself is the
    last of them, so that a current which moves another unit is named as such. Planned time passes in the first.
    """
    plan, within = node.plan, node.plan.unit
    others = [unit for unit in plan.units if unit is not within] if within is None or name == WIRING else []
    told = {key: value for key, value in conditions.items() if key != UNIT}
    beside = {} if within is None else {"purpose": WIRING, "beside": within.slot}
    beside |= {"current_A": told["current_A"]} if "current_A" in told else {}
    records = [(unit, told if within is None else beside) for unit in others]
    records += [] if within is None else [(within, told)]
    for index, (unit, known) in enumerate(records):
        plan.unit = unit
        more = {"together": True} if index else {}
        length = NO_TIME if index and seconds is not None else seconds
        plan.add(node, PlannedRecord, plan.link, name, {**arguments, **more}, length, {**known, UNIT: unit.serial})
    plan.unit = within


@dataclass(frozen=True)
class _Kept:
    """Something a record can keep beside its sums: how many frames of it fit, and what frames must carry."""

    code: str
    most: int
    what: str
    lacks: str
    advice: str


_PULSES = _Kept(
    "B-PLAN-069", MOST_TIMED_FRAMES, "pulse times of {} frames",
    f"no {' and '.join(TIMED)} counts per frame, so no pulse has a time",
    "leave 'pulse_timing' out, or count a link that has them",
)  # fmt: skip
_SAMPLES = _Kept(
    "B-PLAN-092", MOST_SAMPLES, "{} samples of one record",
    "no fields with 'per: sample', so a record has no samples",
    "leave 'samples' out, or record a link whose frames carry samples",
)  # fmt: skip


def _can_keep(node: Node, kept: _Kept, carried: bool, seconds: Quantity | None) -> None:
    """Note what keeps a record from keeping more than its sums (B-PLAN-069, -092)."""
    rate_Hz = node.plan.rate_Hz
    if not carried:
        frame = next(iter(node.plan.model.frame.values()), None)
        counted = "a record of readings" if frame is None else f"frame {frame!r}"
        node.fail(kept.code, f"{counted} has {kept.lacks}", kept.advice)
    elif seconds is not None and seconds.value * rate_Hz > kept.most:
        message = f"{kept.what.format(round(seconds.value * rate_Hz))} do not fit; {kept.most} are allowed"
        node.fail(kept.code, message, "take shorter records; 'windows' makes many without a gap")


def _soak(outer: Node, slot: SoakStep) -> None:
    step, node, plan = slot.soak, outer.below("soak"), outer.plan
    _role(node.below("chamber"), step.chamber)
    slot_s = _duration(node, step.slot, "slot")
    stable, judged = step.stable, node.below("stable")
    if stable.sensor == "unit" and not plan.model.frame:
        message = "the soak waits for the temperature that the unit tells, and the sequence names no link to it"
        judged.fail("B-PLAN-097", message, "write 'sensor: air'")
    for_s = judged.quantity(stable.for_, "s", "for")
    _fits_in(judged.below("for"), "B-PLAN-043", "stable for {} s does not fit", for_s, slot_s)
    limit_s = slot_s if step.hold_limit is None else _duration(node, step.hold_limit, "hold_limit")
    within = judged.quantity(stable.within, "degC", "within")
    plan.known = replace(plan.known, settle_band_degC=None if within is None else within.value)
    arguments = {
        "temperature": node.quantity(step.temperature, "degC", "temperature"),
        "ramp": node.quantity(step.ramp, "degC/min", "ramp"),
        "slot": slot_s,
        "within": within,
        "for": for_s,
        "sensor": stable.sensor,
        "late": step.late,
        "hold_limit": limit_s,
        **_done(node.below("done"), step, slot_s),
    }
    plan.add(node, PlannedSoak, step.chamber, "soak", arguments, slot_s)


def _fits_in(node: Node, code: str, what: str, part_s: Quantity | None, slot_s: Quantity | None) -> None:
    """Note a time that is longer than the slot it is part of."""
    if part_s is not None and slot_s is not None and part_s.value > slot_s.value:
        message = f"{what.format(f'{part_s.value:g}')} in a slot of {slot_s.value:g} s"
        node.fail(code, message, origin=part_s.origin or slot_s.origin)


def _done(node: Node, soak: Soak, slot_s: Quantity | None) -> dict[str, Quantity | None]:
    """Return how near its end the unit must be, and the least time, of a soak that may be over before its slot is."""
    done = soak.done
    if done is None:
        return {}
    residual = node.quantity(done.residual, "degC", "residual")
    least_s = _duration(node, done.least, "least")
    if soak.stable.sensor != "unit":
        message = "the unit's lag decides, and the soak is judged by the air"
        node.fail("B-PLAN-156", message, "write 'sensor: unit', or leave 'done' out")
    if node.plan.phase == "finally":
        node.fail("B-PLAN-156", "what leaves the bench in order is never shortened", "leave 'done' out")
    if residual is not None and residual.value <= 0.0:
        message = f"a residual of {residual.value:g} degC is never reached"
        node.below("residual").fail("B-PLAN-156", message, "allow more", residual.origin)
    _fits_in(node.below("least"), "B-PLAN-156", "at least {} s do not fit", least_s, slot_s)
    return {"residual": residual, "least": least_s}


def _prompt(outer: Node, asked: PromptStep) -> None:
    """Append an operator prompt; limits come out in the base unit of the value."""
    step, node = asked.prompt, outer.below("prompt")
    arguments: dict[str, Any] = {"text": _filled(node.below("text"), step.text), "confirm": step.confirm}
    arguments |= {"presence": step.presence} if step.presence != "bench" else {}
    if step.sets:
        arguments["sets"] = {name: plain(value) for name, value in node.below("sets").values(step.sets).items()}
    if step.value is not None:
        here = node.below("value")
        arguments["unit"] = step.value.unit
        arguments["quantity"] = step.value.quantity or ""
        arguments["required"] = step.value.required
        for key in ("low", "high"):
            text = getattr(step.value, key)
            try:
                arguments[key] = None if text is None else parse_quantity(text, step.value.unit)
            except ValueError as error:
                here.below(key).fail("B-PLAN-031", str(error))
        low, high = arguments.get("low"), arguments.get("high")
        if low is None and high is None:
            here.fail("B-PLAN-044", "a value needs a limit: low, high or both")
        elif low is not None and high is not None and low > high:
            message = f"no value is inside its limits: low {step.value.low} is above high {step.value.high}"
            here.fail("B-PLAN-044", message, "exchange them")
        keep_given(here, step.value)
    node.plan.add(node, PlannedPrompt, "", "", arguments)


def _filled(node: Node, text: str) -> str:
    """Return a text for a person with its variables written out; nobody is shown a brace (B-PLAN-030)."""
    if left := re.search(r"\{[^{}]*\}?|\}", REFERENCE.sub("", text)):
        node.fail("B-PLAN-030", f"{left[0]!r} in the text is no variable", "write {name}, in lower case")

    def value(match: re.Match[str]) -> str:
        resolved = node.resolve(match[0])
        return (
            plain_quantity(resolved.value, resolved.dimension)
            if isinstance(resolved, Quantity)
            else str(plain(resolved))
        )

    return REFERENCE.sub(value, text)


_EXPANDERS: dict[type, Callable[[Node, Any], None]] = {
    CallStep: _call,
    ReadStep: _read,
    VerifyStep: _verify,
    SendStep: _send,
    UnitStep: expand_unit,
    TestStep: expand_test,
    SettleStep: _settle,
    RecordStep: _record,
    SoakStep: _soak,
    PromptStep: _prompt,
}
_OF_A_LINE: dict[str, type[BaseModel]] = {
    "send": SendStep,
    "unit": UnitStep,
    "verify": VerifyStep,
    "record": RecordStep,
    "soak": SoakStep,
    "prompt": PromptStep,
}
