"""The unit under test and its place as a sequence states them: channels, levels, and what an analysis is told.

Units that share a campaign sit each in a slot of the station, with links and instruments of its own.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from bench.frame import FrameDefinition
from bench.model.declaration import ChannelKind, UnitSections, stated
from bench.model.lab import folder_name
from bench.model.systems import analysis_declaration, sections_in
from bench.model.units import format_quantity, likely, read_quantity
from bench.plan.check.everything import NO_SERIAL, SERIAL, short
from bench.plan.expand import TIMED, Expander, Node
from bench.plan.findings import Draft, suggestion
from bench.plan.language.interlocks import OF_UNIT, InterlockRule
from bench.plan.language.sequence import Sequence, Site, UnitUnderTest
from bench.plan.plan import PlannedUnit
from bench.plan.station import Slot
from bench.plan.values import Channel, Quantity, UnitInSlot, plain, read_text, traced

MAX_CHANNEL = 64
_RANGE = re.compile(r"(\d{1,4})\s*-\s*(\d{1,4})")


def channel_numbers(raw: int | str | list[int | str]) -> list[int]:
    """Return numbers meant by ``3``, ``"1-6"`` or a list of both. Raises ValueError."""
    if isinstance(raw, list):
        return [number for item in raw for number in channel_numbers(item)]
    match = _RANGE.fullmatch(raw) if isinstance(raw, str) else None
    if isinstance(raw, str) and match is None:
        raise ValueError(f"{raw!r} is neither a channel number nor a range such as 1-6")
    first, last = (int(match[1]), int(match[2])) if match is not None else (int(raw), int(raw))
    if not 1 <= first <= last <= MAX_CHANNEL:
        raise ValueError(f"channels {raw} are not inside 1-{MAX_CHANNEL}, lowest first")
    return list(range(first, last + 1))


def declared_channels(draft: Draft[Sequence]) -> dict[int, Channel]:
    """Return all channels of a sequence by number; mistakes go to the draft (B-PLAN-020, -021, -022, -099)."""
    channels: dict[int, Channel] = {}
    for index, group in enumerate(draft.model.channels):
        path = ("channels", index, "numbers")
        levels = _levels(draft, index)
        try:
            numbers = channel_numbers(group.numbers)
        except ValueError as error:
            draft.fail("B-PLAN-020", path, str(error))
            continue
        for number in numbers:
            if number in channels:
                draft.fail("B-PLAN-021", path, f"channel {number} is declared twice", "keep one of them")
            channels[number] = Channel(number, group.kind, levels, index)
    _check_standard(draft, channels)
    return channels


def _check_standard(draft: Draft[Sequence], channels: dict[int, Channel]) -> None:
    """Note a check standard on a channel that the campaign does not measure (B-PLAN-099)."""
    named = draft.model.check_standard
    if named is not None and not (named.channel in channels and channels[named.channel].levels):
        measured = ", ".join(str(number) for number, channel in sorted(channels.items()) if channel.levels)
        message = f"the check standard is on channel {named.channel}, which this campaign does not measure"
        advice = f"name one of the channels with levels: {measured or 'none'}"
        draft.fail("B-PLAN-099", ("check_standard", "channel"), message, advice)


def _levels(draft: Draft[Sequence], index: int) -> tuple[Quantity, ...]:
    name = draft.model.channels[index].levels
    if name is None:
        return ()
    table = draft.model.tables.get(name)
    if table is None:
        message = f"there is no table {name!r}{suggestion(name, draft.model.tables)}"
        draft.fail("B-PLAN-022", ("channels", index, "levels"), message)
        return ()
    levels = []
    for position, raw in enumerate(table):
        path = ("tables", name, position)
        value = read_text(raw) if isinstance(raw, str) else raw
        if isinstance(value, Quantity) and value.dimension == "A" and value.value > 0:
            levels.append(traced(value, f"{name}[{position}], line {draft.line(path)}"))
        else:
            message = f"level {raw!r} is not a positive current with its unit{likely(raw, 'A')}"
            draft.fail("B-PLAN-022", path, message)
    return tuple(levels)


def campaign_channels(draft: Draft[Sequence], channels: dict[int, Channel]) -> list[dict[str, Any]]:
    """Return channel constants for the analysis, in SI base units; [] if the sequence does not describe the unit.

    A kind that the unit lacks (B-PLAN-023), that the channel is not of (B-PLAN-028) and a level over full scale
    (B-PLAN-024) go to the draft.
    """
    uut = draft.model.uut
    entries = []
    for index, group in enumerate(draft.model.channels if uut is not None else ()):
        kind = _kind(uut, group.kind)
        if kind is None:
            draft.fail("B-PLAN-023", ("channels", index, "kind"), f"uut.kinds does not describe {group.kind!r}")
            continue
        _check_kind(draft, index, kind)
        _check_levels(draft, index, kind.full_scale)
        _check_noise(draft, group.kind, kind)
        entries += [_constants(c, kind) for c in channels.values() if c.group == index]
    return sorted(entries, key=lambda entry: int(entry["number"]))


def check_counted(draft: Draft[Sequence], link: str, frame: FrameDefinition) -> None:
    """Note declared channels whose pulses the frames of the recorded link do not count (B-PLAN-027)."""
    name = draft.model.frame[link]
    counted = min((_counted(frame, field) for field in TIMED), default=0)
    if draft.model.channels and not counted:
        message = f"the frame {name!r} of {link} counts no pulses, and records of channels are made of them"
        draft.fail("B-PLAN-027", ("frame", link), message, "name the link that counts them first")
        return
    for index, group in enumerate(draft.model.channels):
        try:
            missing = [number for number in channel_numbers(group.numbers) if number > counted]
        except ValueError:
            continue  # noted where the channels are declared
        for number in missing:
            message = f"there is no channel {number}: the frame {name!r} of {link} counts pulses of {counted} channels"
            draft.fail("B-PLAN-027", ("channels", index, "numbers"), message, "correct the number, or the frame")


def _counted(frame: FrameDefinition, field: str) -> int:
    """Return of how many channels the frames hold a count of this name; all there may be if the frame says how many."""
    fields = [item for message in frame.layout.messages for item in message.fields if item.name == field]
    return max((MAX_CHANNEL if item.count == 0 else item.count or 1 for item in fields), default=0)


def _kind(uut: UnitUnderTest | None, name: str) -> ChannelKind | None:
    """Return what the data sheet says of a kind of channel, in the section of whichever system has it."""
    for sections in () if uut is None else sections_in(uut, UnitSections):
        kind = sections.channel_kind(uut, name)  # type: ignore[arg-type]
        if kind is not None:
            return kind
    return None


def _check_kind(draft: Draft[Sequence], index: int, kind: ChannelKind) -> None:
    """Note channels that are not among those which the data sheet has of their kind (B-PLAN-028)."""
    if kind.channels is None:
        return
    group = draft.model.channels[index]
    path = ("uut", "kinds", group.kind, "channels")
    try:
        of_kind = channel_numbers(kind.channels)
    except ValueError as error:
        draft.fail("B-PLAN-020", path, str(error))
        return
    try:
        others = [number for number in channel_numbers(group.numbers) if number not in of_kind]
    except ValueError:
        return  # noted where the channels are declared
    if others:
        declared = f"declared as {group.kind}: {', '.join(map(str, others))}"
        message = f"{declared}; the unit has {group.kind} channels {kind.channels} (line {draft.line(path)})"
        draft.fail("B-PLAN-028", ("channels", index, "kind"), message, "correct the kind")


def _check_levels(draft: Draft[Sequence], index: int, full_scale_A: float) -> None:
    name = draft.model.channels[index].levels
    if name is None:
        return
    for position, raw in enumerate(draft.model.tables.get(name, [])):
        level = read_quantity(raw) if isinstance(raw, str) else None
        if level is not None and level[0] > full_scale_A:
            group = draft.model.channels[index]
            lines = [draft.line(place) for place in (("channels", index), ("uut", "kinds", group.kind))]
            message = (
                f"level {raw} is above the full scale {format_quantity(full_scale_A, 'A')} of channels {group.numbers} "
                f"(line {lines[0]}), kind {group.kind} (line {lines[1]})"
            )
            advice = "correct the level, the kind or the full scale"
            draft.fail("B-PLAN-024", ("tables", name, position), message, advice)


def _check_noise(draft: Draft[Sequence], name: str, kind: ChannelKind) -> None:
    """Note what the analysis needs of a kind of channel and the data sheet does not say (B-PLAN-026)."""
    analysis = draft.model.analysis
    asked = analysis_declaration(analysis)
    of_channel = () if asked is None else asked.of_channel
    if missing := ", ".join(key for key in of_channel if getattr(kind, key) is None):
        draft.fail("B-PLAN-026", ("uut", "kinds", name), f"the analysis {analysis} needs {missing} of {name!r}")


def check_declared(draft: Draft[Sequence]) -> None:
    """Note what the analysis needs of the unit under test and the sequence does not say (B-PLAN-026)."""
    uut, analysis = draft.model.uut, draft.model.analysis
    asked = analysis_declaration(analysis)
    if asked is None or not asked.of_unit:
        return
    if uut is None:
        message = f"the analysis {analysis} needs 'uut', the data sheet of the unit under test"
        draft.fail("B-PLAN-026", ("analysis",), message, "describe the unit under 'uut'")
    elif missing := ", ".join(name for name in asked.of_unit if getattr(uut, name) is None):
        draft.fail("B-PLAN-026", ("uut",), f"the analysis {analysis} needs {missing} of the unit")


def _constants(channel: Channel, kind: ChannelKind) -> dict[str, Any]:
    levels_A = [level.value for level in channel.levels]
    return {"number": channel.number, "kind": channel.kind, **kind.channel_constants(levels_A)}


def unit_constants(model: Sequence, serial: str) -> dict[str, Any]:
    """Return entries of the manifest's section "campaign", in base units; what is not stated is left out."""
    constants: dict[str, Any] = {}
    if model.uut is not None:
        constants["uut"] = {"model": model.uut.model, "serial": serial}
        for sections in sections_in(model.uut, UnitSections):
            constants |= sections.constants(model.uut)
        for key, texts in (("limits", model.uut.limits), ("spread", model.uut.spread)):
            if texts:
                constants[key] = {name: _limit(text) for name, text in texts.items()}
    if model.check_standard is not None:
        constants["check_standard"] = model.check_standard.model_dump()
    if model.site is not None:
        constants["site"] = _site(model.site)
    return constants


def _limit(text: str) -> dict[str, Any]:
    value, unit = read_quantity(text) or (0.0, "")
    return {"value": value, "unit": unit}


def _site(site: Site) -> dict[str, Any]:
    constants: dict[str, Any] = stated({
        "latitude_deg": site.latitude,
        "longitude_deg": site.longitude,
        "height_m": site.height,
        "gravity_m_s2": site.gravity,
        "azimuth_deg": site.azimuth,
        "azimuth_std_deg": site.azimuth_uncertainty,
        "tilt_std_deg": site.tilt,
    })  # fmt: skip
    if site.magnetic_field is not None:
        field = site.magnetic_field
        constants["magnetic_field"] = {
            "size_gauss": field.size, "inclination_deg": field.inclination, "declination_deg": field.declination,
        }  # fmt: skip
    return constants


UNITS = "units"  # key of a sequence, and what a loop over them names


def planned_units(outer: Node) -> tuple[PlannedUnit, ...]:
    """Return the units of a sequence in order of the station's slots, () where it has no section ``units``.

    An empty text leaves its slot empty. Mistakes are noted: B-PLAN-140 (no slot, no unit, a link that a slot lacks, or
    something that is not done for several units), B-PLAN-025 (a serial number that is none, or stands twice).
    """
    node, plan = outer.below(UNITS), outer.plan
    named, station = plan.model.units, plan.station
    if named is None:
        return ()
    serials = node.resolve(named)
    texts = [str(plain(serial)) for serial in serials] if isinstance(serials, tuple) else []
    slots = sorted(station.file.slots.items())
    if len(texts) > len(slots) or not any(texts):
        message = f"station {station.name} has {len(slots)} slots for units; {len(texts)} are named"
        node.fail("B-PLAN-140", message, "name a serial number for each slot, '' for an empty one")
        return ()
    _check_possible(node)
    units: list[PlannedUnit] = []
    for (letter, slot), serial in zip(slots, texts, strict=False):
        if serial and _is_complete(plan, letter, slot) and _is_serial(node, serial, units):
            units.append(PlannedUnit(letter, serial, slot.links, slot.roles, slot.card, slot.gradient))
    return tuple(units)


def _check_possible(node: Node) -> None:
    """Note what a sequence of several units cannot have: each of these would have to say which unit it means."""
    plan = node.plan
    if not plan.model.frame:
        node.fail("B-PLAN-140", "the sequence names no link, and units are told apart by theirs")
    for name in ("check_standard", "early", "fits"):
        if getattr(plan.model, name):
            plan.fail("B-PLAN-140", (name,), f"{name!r} is not done for several units", "take it out")


def _is_complete(plan: Expander, letter: str, slot: Slot) -> bool:
    """Note links of the sequence that a slot does not have."""
    missing = [link for link in plan.model.frame if link not in slot.links]
    for link in missing:
        message = f"slot {letter} of station {plan.station.name} has no link {link!r}{suggestion(link, slot.links)}"
        plan.fail("B-PLAN-140", ("frame", link), message, "add it to 'links' of the slot")
    return not missing


def _is_serial(node: Node, serial: str, before: list[PlannedUnit]) -> bool:
    if not SERIAL.fullmatch(serial):
        node.fail("B-PLAN-025", f"{short(serial)} {NO_SERIAL}")
        return False
    if folder_name(serial) in [folder_name(unit.serial) for unit in before]:
        node.fail("B-PLAN-025", f"the unit {serial!r} stands in two slots", "correct one of them")
        return False
    return True


def in_slot(unit: PlannedUnit) -> UnitInSlot:
    """Return the unit as the value of a loop over ``units``."""
    return UnitInSlot(unit.serial, unit.slot, unit.card)


def rules_of_units(rules: tuple[InterlockRule, ...], units: tuple[PlannedUnit, ...]) -> tuple[InterlockRule, ...]:
    """Return the interlocks with one of each unit for what a unit tells of itself; it is ``of`` the unit's first link.

    The name gets the slot: ``unit_hot`` becomes ``unit_hot_a``.
    """
    if not units:
        return rules
    several = []
    for rule in rules:
        if rule.signal in OF_UNIT:
            several += [
                replace(rule, name=f"{rule.name}_{unit.slot.lower()}", of=next(iter(unit.links.values())))
                for unit in units
            ]
        else:
            several.append(rule)
    return tuple(several)
