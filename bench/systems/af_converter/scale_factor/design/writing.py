"""Writes a campaign as a sequence: the given text with other tables, record length, temperatures and repeats."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

from bench.design import SequenceText
from bench.model.errors import InputError
from bench.model.units import parse_quantity
from bench.systems.af_converter.scale_factor.design.template import Template
from bench.systems.af_converter.scale_factor.design.tours import Tour

_REFERENCE = re.compile(r"\{(\w+)\}")
_REPEAT = re.compile(r"\brepeat: *\d+")
ARRIVE = "arrive"  # procedure: the soak, and what is done before the channels
_FORM = (
    "steps: a loop over temperatures that begins with a soak and ends with a loop over channels, then one that repeats "
    "channels; records of one length that is a parameter"
)


def write_levels(text: SequenceText, template: Template, levels_A: Sequence[tuple[float, ...]]) -> None:
    """Leave out of the tables the levels that are not taken."""
    for name, values in text.tree.get("tables", {}).items():
        known_A = [parse_quantity(value, "A") for value in values]
        for given_A, kept_A in zip(template.levels_A, levels_A, strict=True):
            if set(known_A) - {0.0} == set(given_A) and set(kept_A) != set(given_A):
                kept = [value for value, level_A in zip(values, known_A, strict=True) if level_A in {0.0, *kept_A}]
                left = [value for value in values if value not in kept]
                text.set_value(("tables", name), f"[{', '.join(kept)}]", f"without {', '.join(left)}")


def write_length(text: SequenceText, length_s: float, given_s: float) -> None:
    """Give the records another length. Raises: InputError B-DES-005 if that is not one parameter."""
    lengths = {str(length) for length in _seconds(text.tree.get("procedures", {}))}
    references = {match[1] for length in lengths if (match := _REFERENCE.fullmatch(length))}
    names = references & text.tree.get("parameters", {}).keys()
    if len(names) != 1:
        raise _other_form(text, ("procedures",))
    if length_s != given_s:
        text.set_value(("parameters", names.pop()), f"{length_s:g} s", f"{given_s:g} s before")


def _seconds(value: Any) -> Iterator[Any]:
    """Yield the lengths of all measuring records in a part of a sequence."""
    if isinstance(value, dict):
        record = value.get("record")
        if isinstance(record, dict) and "purpose" not in record:
            yield record.get("seconds")
        for part in value.values():
            yield from _seconds(part)
    elif isinstance(value, list):
        for part in value:
            yield from _seconds(part)


def write_stops(
    text: SequenceText,
    stops: Tour,
    channels: Sequence[tuple[int, ...]],
    slots_s: Sequence[float],
    why: str,
) -> None:
    """Write the temperatures in their order, each with its slot, and why these are as long as they are.

    Raises: InputError B-DES-005 for another form.
    """
    loop = ("steps", 0, "do")
    body = _entry(text, loop, list)
    last = (*loop, len(body) - 1)
    again = _again(text)
    if "soak" not in body[0] or _entry(text, last, dict).get("in") != "channels":
        raise _other_form(text, loop)
    slot = str(body[0]["soak"].get("slot"))
    text.set_value((*loop, 0, "soak", "slot"), '"{slot}"', "")
    arrival = "\n".join(line for number in range(len(body) - 1) for line in text.block((*loop, number)))
    lines = textwrap.indent(textwrap.dedent(arrival), " " * 6)
    points = _dedented(text, (*last, "do"))
    text.replace_below(("steps",), list(_stop_lines(stops, channels, slots_s, points, again)))
    heading = [f"  {ARRIVE}:", "    arguments: {slot: required}", "    do:", *lines.splitlines(), ""]
    text.insert_below(("procedures",), [f"  # The soak to a temperature, with slots{why}.", *heading])
    _drop_slot(text, slot)


def _again(text: SequenceText) -> list[str]:
    """Return what is done with a channel that is repeated."""
    loop = ("steps", 1, "do")
    body = _entry(text, loop, list)
    last = (*loop, len(body) - 1)
    if len(body) != 1 or "for" not in _entry(text, last, dict):
        raise _other_form(text, ("steps",))
    return _dedented(text, (*last, "do"))


def _dedented(text: SequenceText, path: tuple[str | int, ...]) -> list[str]:
    lines = text.block(path)[1:]
    if not lines:  # all in one line
        raise _other_form(text, path)
    return textwrap.dedent("\n".join(lines)).splitlines()


def _entry(text: SequenceText, path: tuple[str | int, ...], kind: type) -> Any:
    """Return a value of the sequence. Raises: InputError B-DES-005 if there is none of this kind."""
    value: Any = text.tree
    try:
        for part in path:
            value = value[part]
    except (KeyError, IndexError, TypeError) as error:
        raise _other_form(text, ("steps",)) from error
    if not isinstance(value, kind) or not value:
        raise _other_form(text, ("steps",))
    return value


def _stop_lines(
    stops: Tour, channels: Sequence[tuple[int, ...]], slots_s: Sequence[float], points: list[str], again: list[str]
) -> Iterator[str]:
    for number, (stop, chosen, slot_s) in enumerate(zip(stops, channels, slots_s, strict=True)):
        what = f"repeat {stop.repeat}: what has drifted since the opening" if stop.repeat else ""
        what = "the opening, which the repeats are held against" if number == 0 else what
        yield f"  - for: temperature{f'  # {what}' if what else ''}"
        yield f"    in: [{stop.temperature_degC:g} degC]"
        yield "    do:"
        if slot_s:
            yield f"      - {ARRIVE}: {{slot: {slot_s:g} s}}"
        yield "      - for: channel"
        of_some = ", ".join(map(str, chosen))
        yield f"        in: {f'{{channels: [{of_some}]}}' if chosen else 'channels'}"
        yield "        do:"
        for line in again if stop.repeat else points:
            yield " " * 10 + (_REPEAT.sub(f"repeat: {stop.repeat}", line) if stop.repeat else line)


def _drop_slot(text: SequenceText, slot: str) -> None:
    """Leave out the parameter of the slot if nothing else reads it."""
    match = _REFERENCE.fullmatch(slot)
    if match and match[1] in text.tree.get("parameters", {}) and text.count(slot) == 1:
        text.remove(("parameters", match[1]))


def _other_form(text: SequenceText, path: tuple[str | int, ...]) -> InputError:
    message = f"the sequence cannot be written in the place of this one, which is not of the form: {_FORM}"
    return InputError("B-DES-005", message, where=text.where(path), next_step="begin with the shipped scale_factor_38h")
