"""What a run is shown with, and what never changes in it: signals, graphs, limits of temperatures, as in the document.

A run takes it from its plan, a recording from the copies that it holds (docs/live-protocol.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from bench.frame import MEAN_S, FrameDefinition, Signal
from bench.model.declaration import Count
from bench.model.quantities import Values
from bench.model.systems import system_of_analysis
from bench.model.units import prefix_of
from bench.plan import COUNTS, Graph, InterlockRule, graphs_of, shown_signals
from bench.run.context import RunContext
from bench.run.stop import CHAMBER_AIR, UNIT

Row = dict[str, Any]
_WATCHED = {"chamber_air": "air", "second_air": "air", "unit_temperature": "unit"}
_GUARDED = {CHAMBER_AIR: "air", UNIT: "unit"}
GUARD = "guard"


def signals_of(context: RunContext) -> tuple[dict[str, FrameDefinition], list[Graph], tuple[Signal, ...]]:
    """Return the frames of a run's links, its graph windows, and every signal that they show."""
    frames = {name: reader.definition for name, reader in context.acquisition.readers.items()}
    graphs = graphs_of(context.plan.station.file.graphs, frames, context.measurement_link)
    return frames, graphs, shown_signals(graphs, frames)


def signal_rows(signals: Sequence[Signal], manifest: Values) -> list[Row]:
    """Return the columns of the points; ``channel`` is that of the unit whose pulses a signal counts, else null.

    The kind of a channel is null where the campaign does not declare it.
    """
    channels = _channels(manifest)
    rows = []
    for signal in signals:
        number = _number(signal, manifest)
        named = None if number is None else {"number": number, "kind": channels.get(number, {}).get("kind")}
        rows.append({"name": signal.name, "unit": signal.unit, "decimals": signal.decimals, "channel": named})
    return rows


def graph_rows(graphs: Sequence[Graph], signals: Sequence[Signal], manifest: Values) -> list[Row]:
    """Return the graph windows; ``rates`` is null where the signals are not counted per frame."""
    by_name = {signal.name: signal for signal in signals}
    rows = []
    for graph in graphs:
        rates = [by_name[name] for name in graph.rates if name in by_name]
        row = asdict(graph)
        rows.append({**row, "rates": _rates(rates, manifest) if rates and len(rates) == len(graph.signals) else None})
    return rows


def limit_rows(rules: Iterable[InterlockRule], guard_degC: Mapping[str, float]) -> list[Row]:
    """Return the limits that are watched of the temperatures of the bench.

    Args: rules: interlocks of the plan.   guard_degC: hard limits of the guard, by the name of the quantity.
    """
    rows = [
        {"name": rule.name, "of": _WATCHED[rule.signal], "low_degC": rule.low, "high_degC": rule.high,
         "action": rule.action}
        for rule in rules if rule.signal in _WATCHED
    ]  # fmt: skip
    return rows + [
        {"name": GUARD, "of": of, "low_degC": None, "high_degC": guard_degC[name], "action": GUARD}
        for name, of in _GUARDED.items() if name in guard_degC
    ]  # fmt: skip


def _rates(rates: Sequence[Signal], manifest: Values) -> Row:
    """Return the rates of a graph: of the channels that the campaign declares, in the unit of what they count.

    Where it says nothing of any of them: all, in counts per second.
    """
    system = system_of_analysis(str((manifest.get("campaign") or {}).get("analysis")))
    count = None if system is None else system.count
    channels = {} if count is None else _channels(manifest)
    known = [(rate, channels[number]) for rate in rates if (number := _number(rate, manifest)) in channels]
    if count is None or not known or not all(_stated(channel, count) for _, channel in known):
        names = [rate.name for rate in rates]
        return {"signals": names, "unit": rates[0].unit, "factors": [1.0] * len(names), "decimals": rates[0].decimals,
                "mean_s": MEAN_S}  # fmt: skip
    exponent, prefix = prefix_of(max(float(channel[count.full_scale]) for _, channel in known))
    factors = [float(channel[count.amount]) / 10.0**exponent for _, channel in known]
    decimals = max(0, math.ceil(-math.log10(min(factors)) - 1e-9))
    return {"signals": [rate.name for rate, _ in known], "unit": f"{prefix}{count.unit}", "factors": factors,
            "decimals": decimals, "mean_s": MEAN_S}  # fmt: skip


def _stated(channel: Values, count: Count) -> bool:
    values = (channel.get(count.amount), channel.get(count.full_scale))
    return all(isinstance(value, int | float) and value > 0 for value in values)


def _channels(manifest: Values) -> dict[int | None, Values]:
    return {entry["number"]: entry for entry in (manifest.get("campaign") or {}).get("channels") or ()}


def _number(signal: Signal, manifest: Values) -> int | None:
    """Return the channel whose pulses a signal counts: its element in frames of the measurement link."""
    counted = signal.field in COUNTS and signal.link == manifest.get("measurement_link")
    return signal.element if counted else None
