"""Signals: the single numbers of a link's frames that people look at, and how their names are written.

``port_a.npp[3]`` is element 3 (from 1) of an array field, ``port_b.supply_voltage`` a single value, ``bench.air`` a
temperature of the bench, ``port_a.npp-ppp[3]`` the difference of two fields. ``port_a.npp[1..6]`` stands for several.
``port_a.npp-ppp[3]/s`` is the rate of a field that counts per frame: what comes in a second, mean over ``MEAN_S``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from bench.frame.batch import MessageBatch
from bench.frame.definition import FrameDefinition
from bench.frame.layout import Field, Message
from bench.model.arrays import Array, Column, Floats, Indices, Integers
from bench.model.clock import NS
from bench.model.errors import InputError

BENCH = "bench"
BENCH_FIELDS = ("air", "unit", "setpoint")
MOST_SIGNALS = 200
_ASKED = ("command", "answer", "refusal")  # messages that come when somebody asks, not by themselves
_FLOAT_DECIMALS = 4
_MOST_DECIMALS = 9
_NAME = re.compile(r"([a-z0-9_]+)\.([a-z0-9_]+)(?:-([a-z0-9_]+))?(?:\[(\d{1,4})(?:\.\.(\d{1,4}))?\])?(/s)?")
RATE = "/s"  # behind the name of a count: its rate
MEAN_S = 1.0  # a mean that lacks half of its frames or more is NaN: a gap
_LEAST_FRAMES = 10  # in MEAN_S: of fewer a mean says no more than the frames themselves


@dataclass(frozen=True)
class Signal:
    """One number of a link's frames, or of the bench (``link`` "bench", no message).

    ``element`` counts from 1, None for a single value; ``minus`` is the field that is subtracted, "" for none.
    ``decimals``: how many are worth showing.   ``rate_Hz``: of a rate the frames in a second, 0 of anything else.
    """

    name: str
    link: str
    message: str
    field: str
    element: int | None
    minus: str
    unit: str
    decimals: int
    rate_Hz: float = 0.0


def expand(text: str) -> tuple[str, ...]:
    """Names a text stands for: one, or those of a range ``[a..b]``.

    Raises: InputError B-FRAME-024 if it is no name of a signal.
    """
    match = _NAME.fullmatch(text)
    if match is None or (match[5] and not 1 <= int(match[4]) <= int(match[5]) < int(match[4]) + MOST_SIGNALS):
        raise _unknown(text, "it is not written as link.field, link.field[3], link.field-field[3] or link.field[1..6]")
    if match[5] is None:
        return (text,)
    stem, behind = text[: text.index("[")], match[6] or ""
    return tuple(f"{stem}[{element}]{behind}" for element in range(int(match[4]), int(match[5]) + 1))


def signal_of(name: str, frames: Mapping[str, FrameDefinition]) -> Signal:
    """Return the signal of a name. Raises: InputError B-FRAME-024 if the frames have none of that name."""
    match = _NAME.fullmatch(name)
    if match is None or match[5]:
        raise _unknown(name, "it is not the name of one signal")
    link, field, minus, element = match[1], match[2], match[3] or "", match[4]
    if link == BENCH and field in BENCH_FIELDS and not (minus or element or match[6]):
        return _of_bench(field)
    if link not in frames:
        known = (*frames, BENCH)
        raise _unknown(name, f"there is no link {link!r}", known)
    message = _message_with(frames[link], field, name)
    signal = _signal(link, message, field, minus, None if element is None else int(element), name)
    return _rate(signal, frames[link], message.by_name[field]) if match[6] else signal


def rate_of(signal: Signal, frames: Mapping[str, FrameDefinition]) -> Signal | None:
    """Return the rate of a signal; None if it is not counted per frame, or by fewer than ten frames in a second."""
    try:
        return signal_of(signal.name + RATE, frames)
    except InputError:
        return None


def all_signals(frames: Mapping[str, FrameDefinition], wanted: Sequence[str] = ()) -> tuple[Signal, ...]:
    """Every number of the frames that stream, then what else is wanted (differences), then those of the bench.

    Left out: messages that answer, counters, bytes, constants, defaults, codes of commands, and fields of bits. Of a
    field that several messages of a link have, the first one counts. Where there are more than ``MOST_SIGNALS`` only
    those wanted and those of the bench remain. The order is that of the links' names, then of the wire.

    Raises: InputError B-FRAME-024 for a wanted name that is none.
    """
    asked = [signal_of(name, frames) for text in wanted for name in expand(text)]
    found = [signal for link in sorted(frames) if link != BENCH for signal in _of_link(link, frames[link])]
    bench = [_of_bench(field) for field in BENCH_FIELDS]
    every = tuple(dict.fromkeys([*found, *(signal for signal in asked if signal.link != BENCH), *bench]))
    return every if len(every) <= MOST_SIGNALS else tuple(dict.fromkeys([*asked, *bench]))[:MOST_SIGNALS]


def of_message(signals: Iterable[Signal], link: str, message: str) -> tuple[Signal, ...]:
    """Return signals of one message of one link, in the order given."""
    return tuple(signal for signal in signals if signal.link == link and signal.message == message)


def columns(signals: Iterable[Signal], link: str, batch: MessageBatch) -> Floats:
    """Return values of the signals of one message of a link, (n, k) in the unit of each field, in the order given.

    Of a rate the value of each frame alone, as if a whole second were like it.
    """
    chosen = of_message(signals, link, batch.message.name)
    found = np.empty((len(batch), len(chosen)))
    for block in blocks(chosen):
        found[:, block.places] = block.in_unit(block.values(batch), batch.message)
    return found


def means(sums: Floats, counts: Indices, rate_Hz: Floats | float) -> Floats:
    """Return sums over ``MEAN_S`` as means, (m, k); NaN where not more than half of the frames came.

    Args: sums: (m, k).   counts: of the frames in each sum, (m, k) or (m, 1).   rate_Hz: of the frames, (k,) or one.
    """
    enough = counts * 2 > np.asarray(rate_Hz) * MEAN_S
    found: Floats = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=enough)
    return found


def trailing_means(t_ns: Integers, signals: Sequence[Signal], values: Floats) -> Floats:
    """Return values of frames with those of rates replaced by their mean over ``MEAN_S`` up to each frame, (n, k).

    Args: t_ns: of the frames, (n,), never falling.   signals: (k,).   values: as ``columns`` gives them, (n, k).
    """
    places = rates_among(signals)
    if not len(places) or not len(t_ns):
        return values
    first = np.searchsorted(t_ns, t_ns - round(MEAN_S * NS), side="right")
    total = np.concatenate((np.zeros((1, len(places))), np.cumsum(values[:, places], axis=0)))
    sums = total[1:] - total[first]
    found = values.copy()
    found[:, places] = means(sums, (np.arange(1, len(t_ns) + 1) - first)[:, None], rates_Hz(signals)[places])
    return found


def rates_among(signals: Sequence[Signal]) -> Indices:
    """Return places of the rates among signals."""
    return np.flatnonzero(rates_Hz(signals))


def rates_Hz(signals: Sequence[Signal]) -> Floats:
    """Return ``rate_Hz`` of each signal, (k,)."""
    return np.array([signal.rate_Hz for signal in signals], np.float64)


class Columns(Protocol):
    """Frames of one message, cut into fields."""

    def raw(self, name: str) -> Array:
        """Raw values of a field, (n,) or (n, count)."""


@dataclass(frozen=True)
class Block:
    """Signals of one field, or of one difference: ``places`` among the signals they were taken from, ``elements``.

    ``rate_Hz``: as of its signals.
    """

    field: str
    minus: str
    places: Indices
    elements: Indices
    rate_Hz: float = 0.0

    def values(self, batch: Columns) -> Column:
        """Raw values, (n, k); a difference in a type that holds it."""
        values = _chosen(batch.raw(self.field), self.elements)
        if not self.minus:
            return values
        less = _chosen(batch.raw(self.minus), self.elements)
        difference: Column = np.subtract(values, less, dtype=_wide(values, less), casting="unsafe")
        return difference

    def in_unit(self, values: Column, message: Message) -> Floats:
        """Raw values in the unit of the field."""
        item = message.by_name[self.field]
        shift = 0.0 if self.minus else item.shift
        return (values.astype(np.float64) * item.scale + shift) * (self.rate_Hz or 1.0)


def blocks(signals: Sequence[Signal]) -> tuple[Block, ...]:
    """Return the signals of one message, those of one field together."""
    groups: dict[tuple[str, str, float], list[int]] = {}
    for place, signal in enumerate(signals):
        groups.setdefault((signal.field, signal.minus, signal.rate_Hz), []).append(place)
    return tuple(
        Block(field, minus, np.array(at), np.array([(signals[place].element or 1) - 1 for place in at]), rate_Hz)
        for (field, minus, rate_Hz), at in groups.items()
    )


def _chosen(values: Column, elements: Indices) -> Column:
    rows = values[:, None] if values.ndim == 1 else values
    if len(elements) == rows.shape[1] and (elements == np.arange(rows.shape[1])).all():
        return rows
    return rows[:, elements]


def _wide(one: Column, other: Column) -> type[np.generic]:
    """The smallest type that holds every difference of these values; small is fast."""
    if one.dtype.kind not in "iu" or max(one.dtype.itemsize, other.dtype.itemsize) == np.dtype(np.int64).itemsize:
        return np.float64
    reach = max((int(values.max()) - min(0, int(values.min())) for values in (one, other) if values.size), default=0)
    return next(kind for kind in (np.int16, np.int32, np.int64) if reach <= np.iinfo(kind).max)


def _of_link(link: str, definition: FrameDefinition) -> Iterator[Signal]:
    seen: set[str] = set()
    for message, item in _numbers(definition):
        if item.name in seen:
            continue
        seen.add(item.name)
        elements: Iterable[int | None] = [None] if item.count is None else range(1, item.count + 1)
        for element in elements:
            suffix = "" if element is None else f"[{element}]"
            yield _signal(link, message, item.name, "", element, f"{link}.{item.name}{suffix}")


def _numbers(definition: FrameDefinition) -> Iterator[tuple[Message, Field]]:
    """Messages that stream, with the fields that are numbers a person would look at."""
    framing = {item.name for item in (definition.layout.length_field, definition.layout.type_field) if item is not None}
    framing |= {"command"} if definition.commands else set()
    for message in definition.layout.messages:
        if message.name in _ASKED or (message.rest is not None and message.rest.per != "sample"):
            continue
        for item in message.fields:
            plain = (
                (not item.given or (item.kind == "f" and not item.step))
                and item.kind != "b"
                and item.constant is None
                and not item.counter
                and not item.bits
            )
            plain = plain and item.default is None  # addresses and the like, which the encoder fills in
            if plain and item.name not in framing:
                yield message, item


def _message_with(definition: FrameDefinition, field: str, name: str) -> Message:
    found = {item.name: message for message, item in reversed(list(_numbers(definition)))}
    if field not in found:
        raise _unknown(name, f"{definition.name} streams no number {field!r}", found)
    return found[field]


def _signal(link: str, message: Message, field: str, minus: str, element: int | None, name: str) -> Signal:
    item = message.by_name[field]
    if minus:
        other = message.by_name.get(minus)
        if other is None or (other.unit, other.scale, other.count, other.kind == "b") != (
            item.unit, item.scale, item.count, item.kind == "b",
        ):  # fmt: skip
            same = [peer.name for peer in message.fields if _alike(peer) == _alike(item)]
            raise _unknown(name, f"{minus!r} is no field like {field!r}, to be subtracted from it", same)
    if (element is None) != (item.count is None) or not 1 <= (1 if element is None else element) <= (item.count or 1):
        due = f"{link}.{field} is a single value" if item.count is None else f"elements are 1 to {item.count}"
        raise _unknown(name, due)
    return Signal(name, link, message.name, field, element, minus, item.unit, _decimals(item))


def _rate(signal: Signal, definition: FrameDefinition, item: Field) -> Signal:
    rate_Hz = definition.rate_Hz or 0.0
    if item.per != "frame" or item.shift:
        raise _unknown(signal.name, f"{definition.name} declares no {item.name!r} 'per: frame' without offset")
    if rate_Hz * MEAN_S < _LEAST_FRAMES:
        raise _unknown(signal.name, f"{definition.name} comes {rate_Hz:g} times in a second, too seldom")
    return replace(signal, unit=f"{signal.unit}/s", rate_Hz=rate_Hz)


def _alike(item: Field) -> tuple[str, float, int | None]:
    return item.unit, item.scale, item.count


def _decimals(item: Field) -> int:
    """Decimals that show one raw step of an integer."""
    if item.kind == "f":
        return _FLOAT_DECIMALS
    return next((n for n in range(_MOST_DECIMALS) if abs(item.scale) >= 0.999 * 10.0**-n), _MOST_DECIMALS)


def _of_bench(field: str) -> Signal:
    return Signal(f"{BENCH}.{field}", BENCH, "", field, None, "", "degC", 2)


def _unknown(name: str, why: str, known: Iterable[str] = ()) -> InputError:
    words = ", ".join(known)
    advice = f"use one of: {words}" if words else "docs/live-protocol.md says how signals are named"
    return InputError("B-FRAME-024", f"there is no signal {name!r}: {why}", where="signal", next_step=advice)
