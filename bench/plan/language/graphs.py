"""The graph windows of a station: up to three, each with signals of one unit and a length of time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field, StringConstraints

from bench.frame import BENCH, BENCH_FIELDS, FrameDefinition, Signal, all_signals, expand, rate_of, signal_of
from bench.model.errors import InputError
from bench.model.units import quantity
from bench.model.yamlio import Path_, StrictModel, characters
from bench.plan.findings import Draft, suggestion

MOST_GRAPHS, MOST_CURVES = 3, 10
WINDOW_S = 60.0
COUNTS = ("npp", "ppp")  # pulses of the two directions, of which the difference is the input
SignalName = Annotated[str, StringConstraints(min_length=3, max_length=100)]


class GraphEntry(StrictModel):
    """One graph window of the live page."""

    title: Annotated[str, characters(80)]
    signals: list[SignalName] = Field(min_length=1, description="names or ranges such as port_a.npp-ppp[1..6]")
    window: Annotated[float, *quantity("s", 1.0, 3600.0)] = Field(WINDOW_S, description="time that is shown at first")


@dataclass(frozen=True)
class Graph:
    """A graph window: signals by name, all in ``unit``; ``window_s`` is shown at first, second.

    ``rates``: of the signals, in their order, where all of them have one; else empty.
    """

    title: str
    unit: str
    signals: tuple[str, ...]
    window_s: float
    rates: tuple[str, ...] = ()


def shown_signals(graphs: Iterable[Graph], frames: Mapping[str, FrameDefinition]) -> tuple[Signal, ...]:
    """Return every signal of the frames, with what the graphs ask for besides."""
    return all_signals(frames, [name for graph in graphs for name in (*graph.signals, *graph.rates)])


def graphs_of(entries: Sequence[GraphEntry], frames: Mapping[str, FrameDefinition], measured: str = "") -> list[Graph]:
    """Return graph windows of a station; without any, some that suit the frames.

    Args:   entries: the section ``graphs``.   frames: by link.   measured: the measurement link, which comes first.
    A signal that these frames do not have is left out: another sequence may choose another frame of a link.
    """
    graphs = []
    for entry in entries:
        signals = _known(entry, frames)
        if signals:
            graphs.append(_graph(entry.title, signals, entry.window, frames))
    return graphs or _default(frames, measured)


def _graph(title: str, signals: Sequence[Signal], window_s: float, frames: Mapping[str, FrameDefinition]) -> Graph:
    rates = [rate.name for signal in signals if (rate := rate_of(signal, frames)) is not None]
    names = tuple(signal.name for signal in signals)
    return Graph(title, signals[0].unit, names, window_s, tuple(rates) if len(rates) == len(names) else ())


def check_graphs(draft: Draft[Any], frames: Mapping[str, FrameDefinition]) -> None:
    """Note what a graph of a station cannot show.

    Findings: B-PLAN-084 (no such signal), B-PLAN-085 (too many curves), B-PLAN-086 (more than one unit).
    """
    for number, entry in enumerate(draft.model.graphs):
        path = ("graphs", number, "signals")
        signals = [signal for text in entry.signals for signal in _checked(draft, path, text, frames)]
        units = sorted({signal.unit or "1" for signal in signals})
        if len(signals) > MOST_CURVES:
            message = f"graph {entry.title!r} has {len(signals)} curves, {MOST_CURVES} can be told apart"
            draft.fail("B-PLAN-085", path, message, "leave some out, or make two graphs")
        if len(units) > 1:
            message = f"graph {entry.title!r} has signals in {' and '.join(units)}; it has one axis"
            draft.fail("B-PLAN-086", path, message, "make a graph of each unit")


def _checked(draft: Draft[Any], path: Path_, text: str, frames: Mapping[str, FrameDefinition]) -> list[Signal]:
    try:
        return [signal_of(name, frames) for name in expand(text)]
    except InputError as error:
        advice = suggestion(text, [*_patterns(frames), *(f"{BENCH}.{field}" for field in BENCH_FIELDS)])
        draft.fail("B-PLAN-084", path, f"{error.message}{advice}")
        return []


def _patterns(frames: Mapping[str, FrameDefinition]) -> list[str]:
    """Return names of all signals, an array as its range."""
    lengths: dict[str, int] = {}
    for signal in all_signals(frames):
        stem = signal.name.partition("[")[0]
        lengths[stem] = max(lengths.get(stem, 0), signal.element or 0)
    return [f"{stem}[1..{length}]" if length else stem for stem, length in lengths.items()]


def _known(entry: GraphEntry, frames: Mapping[str, FrameDefinition]) -> list[Signal]:
    signals: list[Signal] = []
    for text in entry.signals:
        with suppress(InputError):
            for name in expand(text):
                with suppress(InputError):
                    signals.append(signal_of(name, frames))
    return list(dict.fromkeys(signals))[:MOST_CURVES]


def _default(frames: Mapping[str, FrameDefinition], measured: str) -> list[Graph]:
    """Return signals of the unit, in groups of one unit, the measurement link first; and temperatures of the bench."""
    links = sorted(frames, key=lambda link: (link != measured, link))
    groups: dict[tuple[str, str, bool], list[Signal]] = {}
    for link in links:
        for signal in all_signals({link: frames[link]}, _differences(link, frames[link])):
            if signal.link != BENCH:
                groups.setdefault((link, signal.unit, bool(signal.minus)), []).append(signal)
    ranked = sorted(groups, key=lambda key: (links.index(key[0]), not key[2]))
    chosen = {(link, unit): groups[link, unit, minus] for link, unit, minus in reversed(ranked)}
    graphs = []
    for signals in [chosen[group] for group in dict.fromkeys(key[:2] for key in ranked)][: MOST_GRAPHS - 1]:
        title = signals[0].name.partition("[")[0]
        graphs.append(_graph(title, signals[:MOST_CURVES], WINDOW_S, frames))
    bench = tuple(f"{BENCH}.{field}" for field in BENCH_FIELDS)
    return [*graphs, Graph("Temperature", "degC", bench, WINDOW_S)]


def _differences(link: str, definition: FrameDefinition) -> list[str]:
    """Return the input of each channel, where the frames count pulses of both directions."""
    for message in definition.layout.messages:
        if set(COUNTS) <= set(message.by_name) and message.by_name[COUNTS[0]].count:
            return [f"{link}.{COUNTS[0]}-{COUNTS[1]}[1..{message.by_name[COUNTS[0]].count}]"]
    return []
