"""Interlocks as a station or a sequence may state them: a signal, its limits, and what happens beyond them.

docs/unattended.md is the user's description.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from bench.model.drivers import driver_class
from bench.model.errors import InputError
from bench.model.units import parse_quantity, quantity
from bench.model.yamlio import Name, StrictModel, characters
from bench.plan.findings import Draft, suggestion

Level = Annotated[str, characters(60)]
Duration = Annotated[float, *quantity("s", 0.0, 86_400.0)]
Action = Literal["hold", "retake", "skip", "abort", "warn"]
Source = Literal["", "link", "instrument"]


@dataclass(frozen=True)
class Signal:
    """A quantity the run knows while it goes on: its base unit, and what ``of`` must name."""

    dimension: str
    of: Source = ""
    meaning: str = ""


SIGNALS: Mapping[str, Signal] = {
    "chamber_air": Signal("degC", meaning="air of the chamber by its own sensor"),
    "chamber_slope": Signal("degC/min", meaning="how fast the chamber's air changes, over the last minutes"),
    "unit_temperature": Signal("degC", meaning="mean of the unit's temperature sensors"),
    "unit_slope": Signal("degC/min", meaning="how fast the unit's temperature changes, over the last minutes"),
    "lab_air": Signal("degC", "instrument", "a channel of the data logger"),
    "second_air": Signal("degC", "instrument", "air of the chamber by a channel of the data logger"),
    "supply_current": Signal("A", meaning="supply current the unit reports"),
    "supply_voltage": Signal("V", meaning="supply voltage the unit reports"),
    "link_loss": Signal("1", "link", "share of the frames of a link that are missing"),
    "link_bad": Signal("1", "link", "share of the frames of a link that are damaged"),
    "link_age": Signal("s", "link", "time since the newest good frame of a link"),
    "rate_step": Signal("Hz", meaning="difference of the pulse rates in the two halves of a record"),
    "disk_time": Signal("s", meaning="how long the free space lasts at the planned rate of bytes; wall clock only"),
}
OF_UNIT = ("unit_temperature", "unit_slope", "supply_current", "supply_voltage", "rate_step")  # told over its links
AFTER_THE_FACT = ("rate_step",)  # known when its record is complete: the point under way is another one by then


class Interlock(StrictModel):
    """One limit that is watched through the whole run."""

    signal: Name
    of: Name | None = Field(None, description="the link or instrument, for a signal that there is several times")
    channel: int | None = Field(None, ge=1, description="channel of the data logger")
    high: Level | None = Field(None, description="trips above it")
    low: Level | None = Field(None, description="trips below it")
    release_high: Level | None = Field(None, description="must be back at or below it; default: the trip level")
    release_low: Level | None = Field(None, description="must be back at or above it; default: the trip level")
    dwell: Duration = Field(0.0, description="how long it must stay beyond before it trips")
    release_after: Duration | None = Field(None, description="how long it must be back; default: as dwell")
    stale: Duration | None = Field(None, description="no reading for longer than this counts as beyond")
    action: Action


@dataclass(frozen=True)
class InterlockRule:
    """A checked interlock. Levels in the base unit ``unit`` of its signal, None where there is none."""

    name: str
    signal: str
    of: str
    channel: int | None
    unit: str
    high: float | None
    low: float | None
    release_high: float | None
    release_low: float | None
    dwell_s: float
    release_after_s: float
    stale_s: float | None
    action: Action
    where: str

    def beyond(self, value: float) -> bool:
        """Return True on the wrong side of a trip level; a value on the level itself is not beyond it."""
        return (self.high is not None and value > self.high) or (self.low is not None and value < self.low)

    def back(self, value: float) -> bool:
        """Return True on the right side of every release level, or on it."""
        above = self.release_high is not None and value > self.release_high
        below = self.release_low is not None and value < self.release_low
        return not above and not below


@dataclass(frozen=True)
class _Entry:
    """An interlock as it is checked: its name, what a file says of it, and the file."""

    name: str
    said: Interlock
    draft: Draft[Any]

    def fail(self, code: str, key: str, message: str, next_step: str = "") -> None:
        """Note a mistake at one of its keys."""
        self.draft.fail(code, ("interlocks", self.name, key), f"interlock {self.name}: {message}", next_step)


def rule_of(
    name: str, entry: Interlock, draft: Draft[Any], links: Mapping[str, Any], roles: Mapping[str, Any]
) -> InterlockRule | None:
    """Return the rule of one entry, None if it cannot be used.

    Args:   draft: the file, whose section ``interlocks`` has the entry.   links, roles: what the station has.
    Findings: B-PLAN-080 (signal or what it is of), B-PLAN-081 (levels), B-PLAN-082 (a level that is no quantity of
    the signal's unit), B-PLAN-083 (an action that comes too late for the signal).
    """
    signal, checked = SIGNALS.get(entry.signal), _Entry(name, entry, draft)
    if signal is None:
        message = f"there is no signal {entry.signal!r}{suggestion(entry.signal, SIGNALS)}"
        checked.fail("B-PLAN-080", "signal", message)
        return None
    _check_of(checked, signal, links, roles)
    if entry.signal in AFTER_THE_FACT and entry.action in ("retake", "skip"):
        message = f"{entry.signal} is known when its record is over; {entry.action} comes too late"
        checked.fail("B-PLAN-083", "action", message, "use hold, abort or warn")
    levels = {key: _level(checked, key, signal) for key in _LEVELS}
    rule = InterlockRule(
        name=name, signal=entry.signal, of=entry.of or "", channel=entry.channel, unit=signal.dimension,
        high=levels["high"], low=levels["low"],
        release_high=levels["high"] if entry.release_high is None else levels["release_high"],
        release_low=levels["low"] if entry.release_low is None else levels["release_low"],
        dwell_s=entry.dwell, release_after_s=entry.dwell if entry.release_after is None else entry.release_after,
        stale_s=entry.stale, action=entry.action,
        where=draft.document.where(("interlocks", name, "signal")),
    )  # fmt: skip
    _check_sides(checked, rule)
    return rule


_LEVELS = ("high", "low", "release_high", "release_low")


def _check_of(checked: _Entry, signal: Signal, links: Mapping[str, Any], roles: Mapping[str, Any]) -> None:
    entry = checked.said
    if signal.of and entry.of is None:
        message = f"which {signal.of} is {entry.signal} of?"
        checked.fail("B-PLAN-080", "signal", message, f"add 'of:' with the name of the {signal.of}")
    elif not signal.of and entry.of is not None:
        checked.fail("B-PLAN-080", "of", f"{entry.signal} needs no 'of'", "take it out")
    elif signal.of:
        known = links if signal.of == "link" else roles
        if entry.of not in known:
            checked.fail("B-PLAN-080", "of", f"there is no {signal.of} {entry.of!r}{suggestion(str(entry.of), known)}")
    if (entry.channel is not None) != (signal.of == "instrument"):
        wrong = "needs a channel" if entry.channel is None else "has no channel"
        checked.fail("B-PLAN-080", "channel", f"the signal {entry.signal} {wrong}")
    elif entry.channel is not None and entry.of is not None and entry.of in roles:
        _check_channel(checked, roles[entry.of])


def _check_channel(checked: _Entry, role: Any) -> None:
    """Note an instrument that scans no channels, or not this one: the interlock would never have a reading."""
    try:
        known = getattr(driver_class(role.driver), "default_options", {})
    except InputError:
        return  # the check of the station says so
    channels, entry = {**known, **role.options}.get("channels"), checked.said
    if channels is None:
        checked.fail("B-PLAN-080", "of", f"{entry.of} ({role.driver}) scans no channels", "name the data logger")
    elif isinstance(channels, list) and entry.channel not in channels:
        message = f"{entry.of} does not scan channel {entry.channel}, only {channels}"
        checked.fail("B-PLAN-080", "channel", message, "use one of them, or add it to 'channels' of the logger")


def _level(checked: _Entry, key: str, signal: Signal) -> float | None:
    text = getattr(checked.said, key)
    if text is None:
        return None
    try:
        return parse_quantity(text, signal.dimension)
    except ValueError as error:
        checked.fail("B-PLAN-082", key, f"{key}: {error}")
        return None


def _check_sides(checked: _Entry, rule: InterlockRule) -> None:
    """Note levels in the wrong order, a release level that is beyond its trip level or has none, no level at all."""

    def wrong(key: str, message: str, advice: str = "") -> None:
        checked.fail("B-PLAN-081", key, message, advice)

    entry = checked.said
    if entry.high is None and entry.low is None:
        wrong("signal", "it has neither 'high' nor 'low'", "add the level at which it trips")
    for side in ("high", "low"):
        if getattr(entry, side) is None and getattr(entry, f"release_{side}") is not None:
            wrong(f"release_{side}", f"there is no '{side}' to release from")
    low, high, back_low, back_high = rule.low, rule.high, rule.release_low, rule.release_high
    if low is not None and high is not None and low >= high:
        wrong("low", f"low ({entry.low}) is not below high ({entry.high})")
    if high is not None and back_high is not None and back_high > high:
        wrong("release_high", f"it releases at {entry.release_high}, which is beyond its trip level {entry.high}")
    if low is not None and back_low is not None and back_low < low:
        wrong("release_low", f"it releases at {entry.release_low}, which is beyond its trip level {entry.low}")
    if back_low is not None and back_high is not None and back_low > back_high:
        wrong("release_low", "no value is inside both release levels, so it would never release")
