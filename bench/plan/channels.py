"""The unit under test and its place as a sequence states them: channels, levels, and what an analysis is told."""

from __future__ import annotations

import re
from typing import Any

from bench.frame import FrameDefinition
from bench.model.declaration import ChannelKind, UnitSections, stated
from bench.model.errors import InputError
from bench.model.systems import analysis_declaration, sections_in
from bench.model.units import format_quantity, likely, read_quantity
from bench.plan.expand import TIMED
from bench.plan.findings import Draft, suggestion
from bench.plan.language.sequence import Sequence, Site, UnitUnderTest
from bench.plan.values import Channel, Quantity, read_text, traced

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
    for key in () if asked is None else asked.of_channel:
        if getattr(kind, key) is None:
            where = draft.document.where(("uut", "kinds", name))
            message = f"the analysis {analysis} needs {key} of {name!r}"
            draft.findings.extend(
                InputError("B-PLAN-026", message, where=where, next_step="take it from the data sheet")
            )


def check_declared(draft: Draft[Sequence]) -> None:
    """Note what the analysis needs of the unit under test and the sequence does not say (B-PLAN-026)."""
    uut, analysis = draft.model.uut, draft.model.analysis
    asked = analysis_declaration(analysis)
    if asked is None or not asked.of_unit:
        return
    if uut is None:
        message = f"the analysis {analysis} needs 'uut', the data sheet of the unit under test"
        draft.fail("B-PLAN-026", ("analysis",), message, "describe the unit under 'uut'")
    else:
        for name in asked.of_unit:
            if getattr(uut, name) is None:
                message = f"the analysis {analysis} needs {name} of the unit"
                draft.fail("B-PLAN-026", ("uut",), message, "take it from the unit's data sheet")


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
