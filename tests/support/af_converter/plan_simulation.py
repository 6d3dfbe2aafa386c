"""Counts of a scale-factor campaign as a sequence plans it: the physics of ``fit_simulation`` at the planned times.

One channel of each kind stands for all that are alike.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fit_simulation as sim
import numpy as np

from bench.model.clock import NS
from bench.plan import PlannedRecord, PlannedSoak, compile_sequence

SEQUENCES = Path(__file__).resolve().parents[3] / "sequences"
_UNIT_LAG_s, _LEFT_degC = 1500.0, 0.43  # what is left of a soak when its slot ends


def planned_records(name: str, channels: tuple[int, ...] = (1, 7)) -> list[tuple[PlannedRecord, float]]:
    """Return the measuring records of some channels of a shipped sequence, each with the end of the soak before it."""
    plan = compile_sequence(SEQUENCES / f"{name}.yaml", None, {})
    records, arrived_s = [], 0.0
    for step in plan.phase("campaign"):
        if isinstance(step, PlannedSoak):
            arrived_s = step.at_s + step.duration_s
        elif isinstance(step, PlannedRecord) and step.conditions["channel"] in channels:
            records.append((step, arrived_s))
    return records


def simulate_plan(
    seed: int,
    records: list[tuple[PlannedRecord, float]],
    world: sim.World | None = None,
) -> sim.SimulatedCampaign:
    """Return one campaign of the planned records, seeded."""
    world, switches, rng = world or sim.World(), sim.Switches(), np.random.default_rng(seed)
    bench = sim._Bench(rng, switches)
    kinds = {step.conditions["channel"]: step.conditions["kind"] for step, _ in records}
    units = {channel: sim._unit(rng, kind, switches) for channel, kind in kinds.items()}
    leak = rng.uniform(-1e-10, 1e-10, 2) * bench.on
    walk = sim._Walk(rng, switches.noise)
    rows: list[sim.Row] = []
    biases_A: dict[tuple[int, float], float] = {}
    length_s = records[-1][0].at_s + records[-1][0].seconds
    for step, arrived_s in records:
        at = place_of(step, length_s)
        left = _LEFT_degC * float(np.exp(-(step.at_s - arrived_s) / _UNIT_LAG_s))
        unit_degC, unit = at.nominal_degC - left, units[at.channel]
        bias_A = unit.bias(unit_degC) + walk.at(step.at_s, at.channel)
        biases_A.setdefault((at.channel, at.nominal_degC), bias_A)
        bench.drift = world.gain(at)
        net_A = world.input_A(bench.input_A(at.step, leak), at) - bias_A
        net_A += rng.normal(0, switches.white_A_rtHz / np.sqrt(2.0 * step.seconds))
        counts = world.counted(bench.counts(net_A, unit, unit_degC, step.seconds), at)
        rows.append(_row(len(rows) + 1, step, at, counts, world.sensed_degC(unit_degC)))
    campaign, standards = sim.manifest(kinds)
    clocks = bench.af_error, bench.master_error
    return sim.SimulatedCampaign(rows, units, bench.gain, *clocks, campaign, standards, biases_A, drift=0.0)


def place_of(step: PlannedRecord, length_s: float) -> sim.Place:
    """Return where a campaign of this length is in a record."""
    given: Any = step.conditions
    what = given["route"], abs(given["current_A"] or 0.0), given["polarity"], given["range_A"]
    return sim.Place(step.at_s / length_s, given["channel"], given["temperature_degC"], given["repeat"], what)


def _row(number: int, step: PlannedRecord, at: sim.Place, counts: dict[str, float], unit_degC: float) -> sim.Row:
    npp, ppp = np.zeros(10), np.zeros(10)
    npp[at.channel - 1], ppp[at.channel - 1] = counts["n"], counts["p"]
    begin_ns = round(step.at_s * NS)
    sums = {
        "npp": npp,
        "ppp": ppp,
        "af_clock": np.float64(counts["af"]),
        "fg_count": np.float64(counts["fg"]),
        "master_count": np.int64(round(step.seconds * sim.MASTER_Hz)),
    }
    window = sim.Window(number, dict(step.conditions), begin_ns, begin_ns + round(step.seconds * NS))
    return sim.Row(window, sums, {"unit_temperature_degC": unit_degC})
