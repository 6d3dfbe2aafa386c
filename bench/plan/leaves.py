"""Steps that do something: one function per kind, from the words of the file to the arguments of a plan step."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from bench.model.ports import Effect
from bench.model.units import parse_quantity, plain_quantity
from bench.plan.drivers import declared_action, no_instrument
from bench.plan.expand import NO_TIME, TIMED, Expander, Path
from bench.plan.expected import keep_given, keep_signals, named_conditions, reply_conditions
from bench.plan.language.expect import ReadingExpect
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
    TestStep,
    TimelineEntry,
    UnitStep,
    VerifyStep,
)
from bench.plan.readings import expand_readings
from bench.plan.step_kinds import WIRING
from bench.plan.stopping import expand_until
from bench.plan.unit_commands import expand_test, expand_unit
from bench.plan.values import REFERENCE, UNIT, Quantity, Scope, named, plain

MOST_SAMPLES = 2_000_000  # of one record: it is held in memory until the analysis
MOST_TIMED_FRAMES = 100_000  # the square of the frame's number times its pulses still sums up exactly


def expand(plan: Expander, step: Any, path: Path, scope: Scope) -> None:
    """Append the steps of one structured step."""
    _EXPANDERS[type(step)](plan, step, path, scope)


def expand_entry(plan: Expander, entry: TimelineEntry, path: Path, scope: Scope) -> None:
    """Append the steps of one line of the flat form."""
    if entry.call is not None:
        expand(plan, entry.call, (*path, "call"), scope)
    for word, kind in _OF_A_LINE.items():
        value = getattr(entry, word)
        if value is not None:
            expand(plan, kind.model_construct(**{word: value, "expect": entry.expect}), path, scope)


def _values(plan: Expander, arguments: Mapping[str, Any], path: Path, scope: Scope) -> dict[str, Any]:
    return {name: plan.resolve(raw, scope, (*path, name)) for name, raw in arguments.items()}


def _role(plan: Expander, role: str, path: Path) -> str:
    """Return the station's name of a role; one that it does not have is noted (B-PLAN-040)."""
    placed = plan.unit.roles.get(role, role) if plan.unit is not None else role
    if placed not in plan.station.instruments and not any(role in unit.roles for unit in plan.units):
        plan.fail("B-PLAN-040", path, no_instrument(plan.station, role))
    return placed


def _duration(plan: Expander, raw: Any, scope: Scope, path: Path) -> Quantity | None:
    seconds = plan.quantity(raw, "s", scope, path)
    if seconds is not None and seconds.value < 0:
        plan.fail("B-PLAN-031", path, f"the duration {seconds.value:g} s is negative", origin=seconds.origin)
        return None
    return seconds


def _read(plan: Expander, step: ReadStep, path: Path, scope: Scope) -> None:
    _call(plan, step.call, path, scope, step.expect)


def _call(plan: Expander, step: CallStep, path: Path, scope: Scope, expect: ReadingExpect | None = None) -> None:
    called, arguments = next(iter(step.root.items()))
    role, name = called.split(".")
    placed = _role(plan, role, path)
    values = _values(plan, arguments or {}, (*path, called), scope)
    if "current" in values:
        plan.programmed(role, values["current"], values.get("range") == "locked")
    declared = declared_action(plan.station, placed, name)
    if declared is not None and declared.effect is Effect.THERMAL:
        plan.settle_band_degC = None  # the temperature moves on: the band of the soak before says nothing any more
    conditions = named_conditions(plan, (role, name), expect, scope.context, path, scope)
    plan.add("call", role, name, values, scope, (*path, called), conditions=conditions)


def _verify(plan: Expander, step: VerifyStep, path: Path, scope: Scope) -> None:
    role, name = step.verify.split(".")
    _role(plan, role, (*path, "verify"))
    plan.add("verify", role, name, {}, scope, (*path, "verify"))


def _send(plan: Expander, step: SendStep, path: Path, scope: Scope) -> None:
    role, text = next(iter(step.send.items()))
    _role(plan, role, (*path, "send", role))
    conditions = reply_conditions(plan, step.expect, (role, text), scope.context, path, scope)
    plan.add("send", role, "", {"text": text}, scope, (*path, "send"), conditions=conditions)


def _settle(plan: Expander, step: SettleStep, path: Path, scope: Scope) -> None:
    seconds = _duration(plan, step.settle, scope, (*path, "settle"))
    plan.add("settle", "", "", {"bus_s": 0.0}, scope, (*path, "settle"), seconds)


def _record(plan: Expander, step: RecordStep, at: Path, scope: Scope) -> None:
    """Append one record step, or one for each of its windows: whole frames or rounds of readings, and conditions."""
    record, path = step.record, (*at, "record")
    seconds = _duration(plan, record.seconds, scope, (*path, "seconds"))
    if seconds is not None and not math.isnan(plan.rate_Hz):
        _whole_frames(plan, seconds, (*path, "seconds"))
    conditions = {**scope.context}
    for name, value in _values(plan, record.conditions, (*path, "conditions"), scope).items():
        conditions[named(name, value)] = plain(value)
    conditions["purpose"] = record.purpose
    if plan.settle_band_degC is not None and "temperature_degC" in conditions:
        conditions["settle_band_degC"] = plan.settle_band_degC
    arguments: dict[str, Any] = {
        "seconds": seconds,
        "retry": record.retry,
        "max_lost": plan.quantity(record.max_lost, "1", scope, (*path, "max_lost")),
        "purpose": record.purpose,
        "retry_step": len(plan.steps) if plan.retry_step is None else plan.retry_step,
    }
    read, quantities = expand_readings(plan, record, seconds, conditions, path, scope)
    arguments |= read
    if signals := keep_signals(plan, record.expect, conditions, path, scope):
        arguments["signals"] = signals
    if record.label is not None:
        conditions["label"] = record.label
    if record.pulse_timing:
        arguments["pulse_timing"] = True
        _can_keep(plan, _PULSES, plan.counts_pulses, seconds, (*path, "pulse_timing"))
    if record.samples:
        arguments["samples"] = True
        _can_keep(plan, _SAMPLES, plan.has_samples, seconds, (*path, "samples"))

    def take(length: Quantity | None, more: Mapping[str, Any], own: Mapping[str, Any]) -> None:
        _windows(plan, record, {**arguments, "seconds": length, **more}, {**conditions, **own}, path, scope, length)

    if record.until is None or seconds is None:
        take(seconds, {}, {})
    else:
        expand_until(plan, record, seconds, conditions, path, scope, take)
    plan.keep_dimensions(quantities, record.windows or 1)


def _windows(
    plan: Expander, record: Record, arguments: Mapping[str, Any], conditions: Mapping[str, Any], path: Path,
    scope: Scope, seconds: Quantity | None,
) -> None:  # fmt: skip
    link = next(iter(plan.document.model.frame), "")
    name = record.label or record.purpose
    if record.windows is not None and record.windows > 1 and record.retry:
        message = f"{record.windows} windows without a gap cannot be taken again (retry {record.retry})"
        plan.fail("B-PLAN-068", (*path, "retry"), message, "leave 'retry' out; lost frames are counted in each window")
    for index in range(record.windows or 1):
        follows = {"follows": True} if record.follows or index else {}
        numbered = {} if record.windows is None else {"window_index": index}
        own, known = {**arguments, **follows}, {**conditions, **numbered}
        if plan.units:
            _of_units(plan, name, own, known, path, scope, seconds)
        else:
            plan.add("record", link, name, own, scope, path, seconds, known)


def _of_units(
    plan: Expander, name: str, arguments: Mapping[str, Any], conditions: Mapping[str, Any], path: Path, scope: Scope,
    seconds: Quantity | None,
) -> None:  # fmt: skip
    """Append a record of the unit of the loop, or one of each unit at once where there is no loop over them.

    A wiring record of one unit comes with one of every other, which nothing may move; that of the unit itself is the
    last of them, so that a current which moves another unit is named as such. Planned time passes in the first.
    """
    link, within = next(iter(plan.document.model.frame)), plan.unit
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
        plan.add("record", link, name, {**arguments, **more}, scope, path, length, {**known, UNIT: unit.serial})
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


def _can_keep(plan: Expander, kept: _Kept, carried: bool, seconds: Quantity | None, path: Path) -> None:
    """Note what keeps a record from keeping more than its sums (B-PLAN-069, -092)."""
    if not carried:
        frame = next(iter(plan.document.model.frame.values()), None)
        counted = "a record of readings" if frame is None else f"frame {frame!r}"
        plan.fail(kept.code, path, f"{counted} has {kept.lacks}", kept.advice)
    elif seconds is not None and seconds.value * plan.rate_Hz > kept.most:
        message = f"{kept.what.format(round(seconds.value * plan.rate_Hz))} do not fit; {kept.most} are allowed"
        plan.fail(kept.code, path, message, "take shorter records; 'windows' makes many without a gap")


def _whole_frames(plan: Expander, seconds: Quantity, path: Path) -> None:
    frames = seconds.value * plan.rate_Hz
    if frames < 1 or abs(frames - round(frames)) > 1e-6:
        message = f"{seconds.value:g} s is not a whole number of frames at {plan.rate_Hz:g} Hz"
        plan.fail("B-PLAN-042", path, message, origin=seconds.origin)


def _soak(plan: Expander, slot: SoakStep, at: Path, scope: Scope) -> None:
    step, path = slot.soak, (*at, "soak")
    _role(plan, step.chamber, (*path, "chamber"))
    slot_s = _duration(plan, step.slot, scope, (*path, "slot"))
    stable = step.stable
    if stable.sensor == "unit" and not plan.document.model.frame:
        message = "the soak waits for the temperature that the unit tells, and the sequence names no link to it"
        plan.fail("B-PLAN-097", (*path, "stable"), message, "write 'sensor: air'")
    for_s = plan.quantity(stable.for_, "s", scope, (*path, "stable", "for"))
    if for_s is not None and slot_s is not None and for_s.value > slot_s.value:
        message = f"stable for {for_s.value:g} s does not fit in a slot of {slot_s.value:g} s"
        plan.fail("B-PLAN-043", (*path, "stable", "for"), message, origin=for_s.origin or slot_s.origin)
    limit_s = slot_s if step.hold_limit is None else _duration(plan, step.hold_limit, scope, (*path, "hold_limit"))
    within = plan.quantity(stable.within, "degC", scope, (*path, "stable", "within"))
    plan.settle_band_degC = None if within is None else within.value
    arguments = {
        "temperature": plan.quantity(step.temperature, "degC", scope, (*path, "temperature")),
        "ramp": plan.quantity(step.ramp, "degC/min", scope, (*path, "ramp")),
        "slot": slot_s,
        "within": within,
        "for": for_s,
        "sensor": stable.sensor,
        "late": step.late,
        "hold_limit": limit_s,
        **_done(plan, step, slot_s, path, scope),
    }
    plan.add("soak", step.chamber, "soak", arguments, scope, path, slot_s)


def _done(plan: Expander, soak: Soak, slot_s: Quantity | None, at: Path, scope: Scope) -> dict[str, Quantity | None]:
    """Return how near its end the unit must be, and the least time, of a soak that may be over before its slot is."""
    done, path = soak.done, (*at, "done")
    if done is None:
        return {}
    residual = plan.quantity(done.residual, "degC", scope, (*path, "residual"))
    least_s = _duration(plan, done.least, scope, (*path, "least"))
    if soak.stable.sensor != "unit":
        message = "the unit's lag decides, and the soak is judged by the air"
        plan.fail("B-PLAN-156", path, message, "write 'sensor: unit', or leave 'done' out")
    if plan.phase == "finally":
        plan.fail("B-PLAN-156", path, "what leaves the bench in order is never shortened", "leave 'done' out")
    if residual is not None and residual.value <= 0.0:
        message = f"a residual of {residual.value:g} degC is never reached"
        plan.fail("B-PLAN-156", (*path, "residual"), message, "allow more", residual.origin)
    if least_s is not None and slot_s is not None and least_s.value > slot_s.value:
        message = f"at least {least_s.value:g} s do not fit in a slot of {slot_s.value:g} s"
        plan.fail("B-PLAN-156", (*path, "least"), message, origin=least_s.origin or slot_s.origin)
    return {"residual": residual, "least": least_s}


def _prompt(plan: Expander, asked: PromptStep, at: Path, scope: Scope) -> None:
    """Append an operator prompt; limits come out in the base unit of the value."""
    step, path = asked.prompt, (*at, "prompt")
    arguments: dict[str, Any] = {"text": _filled(plan, step.text, scope, (*path, "text")), "confirm": step.confirm}
    arguments |= {"presence": step.presence} if step.presence != "bench" else {}
    if step.sets:
        sets = _values(plan, step.sets, (*path, "sets"), scope)
        arguments["sets"] = {name: plain(value) for name, value in sets.items()}
    if step.value is not None:
        arguments["unit"] = step.value.unit
        arguments["quantity"] = step.value.quantity or ""
        arguments["required"] = step.value.required
        for key in ("low", "high"):
            text = getattr(step.value, key)
            try:
                arguments[key] = None if text is None else parse_quantity(text, step.value.unit)
            except ValueError as error:
                plan.fail("B-PLAN-031", (*path, "value", key), str(error))
        low, high = arguments.get("low"), arguments.get("high")
        if low is None and high is None:
            plan.fail("B-PLAN-044", (*path, "value"), "a value needs a limit: low, high or both")
        elif low is not None and high is not None and low > high:
            message = f"no value is inside its limits: low {step.value.low} is above high {step.value.high}"
            plan.fail("B-PLAN-044", (*path, "value"), message, "exchange them")
        keep_given(plan, step.value, scope.context, (*path, "value"))
    plan.add("prompt", "", "", arguments, scope, path)


def _filled(plan: Expander, text: str, scope: Scope, path: Path) -> str:
    """Return a text for a person with its variables written out; nobody is shown a brace (B-PLAN-030)."""
    if left := re.search(r"\{[^{}]*\}?|\}", REFERENCE.sub("", text)):
        plan.fail("B-PLAN-030", path, f"{left[0]!r} in the text is no variable", "write {name}, in lower case")

    def value(match: re.Match[str]) -> str:
        resolved = plan.resolve(match[0], scope, path)
        return (
            plain_quantity(resolved.value, resolved.dimension)
            if isinstance(resolved, Quantity)
            else str(plain(resolved))
        )

    return REFERENCE.sub(value, text)


_EXPANDERS: dict[type, Callable[[Expander, Any, Path, Scope], None]] = {
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
