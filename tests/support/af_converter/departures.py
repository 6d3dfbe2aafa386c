"""Further wrong worlds of a scale-factor campaign: those of a table, and drawn ones of label, shape and size.

What departs (the calibrator's gain, a counter, the current that arrives, the thermometer) does so where a label has a
value, in a shape of time, temperature, level or history. Physics and judge share no line with the product.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import fit_simulation as sim
import numpy as np
from doubt_classes import Seen, Switch
from trials import without_budgets

from bench.analysis import Material, build_results, estimates_of
from bench.systems.af_converter.scale_factor.analysis import analyse

SYSTEM = "departures"
KINDS = {1: "gyro", 3: "gyro", 4: "gyro", 7: "accelerometer"}
REPEATED = 1
QUANTITIES = ("dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_tc0", "dsf_n_tc1", "dsf_n_tc2", "dsf_p_tc0", "dsf_p_tc1",
              "dsf_p_tc2")  # fmt: skip
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "doubt"}
HOURS = 21.0
SEEN = 7.5  # of |P d|: a threshold of about 4.5 and a power of 99.9 %
_QUIET = sim.Switches(gain=False, calibrator_errors=False, noise=False, quantised=False)

Where = Callable[[sim.Place], float]


def _always(at: sim.Place) -> float:
    return 1.0


def _rest(at: sim.Place) -> float:
    return at.nominal_degC - sim.REFERENCE_degC


@dataclass(frozen=True)
class Departed(sim.World):
    """A world that departs by ``size`` times ``where`` in what ``what`` names."""

    size: float
    what: str
    where: Where

    def gain(self, at: sim.Place) -> float:
        return self.size * self.where(at) if self.what == "gain" else 0.0

    def input_A(self, current_A: float, at: sim.Place) -> float:
        if self.what == "part":
            return current_A * (1.0 + self.size * self.where(at))
        return current_A + self.size * self.where(at) * (self.what == "current")

    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        factors = {"n": ("n", "unit"), "p": ("p", "unit")}
        change = 1.0 + self.size * self.where(at)
        return counts | {name: counts[name] * change for name, of in factors.items() if self.what in of}

    def unit(self, units: dict[int, sim.Unit], at: sim.Place) -> sim.Unit:
        if self.what != "exchange" or at.channel not in (3, 4) or not self.where(at):
            return units[at.channel]
        own, other = units[at.channel], units[7 - at.channel]
        mixed = {name: getattr(own, name) + self.size * (getattr(other, name) - getattr(own, name))
                 for name in ("dsf_ppm", "tc1", "tc2")}  # fmt: skip
        return replace(own, **mixed)


def _of_visit(scale: float) -> Where:
    """Return a shape that is drawn for each range of each visit."""

    @cache
    def drawn(*place: Any) -> float:
        number = abs(hash(tuple(round(1e6 * float(part)) for part in place))) % 2**32
        return float(scale * np.random.default_rng(number).standard_normal())

    return lambda at: drawn(at.channel, at.nominal_degC, at.repeat, at.step[3])


TABLE: tuple[tuple[str, str, Where, tuple[float, ...]], ...] = (
    ("one_channel_steps", "unit", lambda at: at.channel == 4 and at.share > 0.5, (1e-6, 1e-5, 2e-4)),
    ("exchanged", "exchange", lambda at: at.share > 0.5, (0.005, 0.05, 1.0)),
    ("calibrator_cycle", "gain", lambda at: np.sin(2.0 * np.pi * at.hours / 24.0), (1e-6, 8e-6, 1e-4)),
    ("calibrator_warms_up", "gain", lambda at: np.exp(-at.hours / 3.0), (1e-6, 1e-5, 2e-4)),
    ("unit_warms_up", "unit", lambda at: np.exp(-at.hours / 3.0), (1e-6, 1e-5, 2e-4)),
    ("range_changes", "gain", _of_visit(1.0), (3e-7, 3e-6, 1e-4)),
    ("cubic_of_all", "unit", lambda at: 1e-6 * _rest(at) ** 3, (3e-5, 3e-4, 3e-3)),
    ("cubic_by_channel", "unit", lambda at: 1e-6 * (-1) ** at.channel * _rest(at) ** 3, (1e-5, 3e-4, 1e-3)),
    ("gradient_of_asymmetry", "n", lambda at: 1e-6 * (at.channel - 3), (0.3, 2.0, 20.0)),
    ("shunt", "part", lambda at: -1.0, (5e-7, 1e-5, 1e-4)),
    ("self_heating", "part", lambda at: (at.step[1] / sim.KIND[KINDS[at.channel]]["full_scale_A"]) ** 2,
     (3e-6, 3e-5, 5e-4)),
    ("memory", "current", lambda at: 1e-6 * at.before_A, (1.0, 20.0, 500.0)),
)  # fmt: skip

_LABELS: dict[str, Callable[[np.random.Generator], Where]] = {
    "all": lambda rng: _always,
    "channel": lambda rng: (lambda n: lambda at: at.channel == n)(rng.choice(list(KINDS))),
    "kind": lambda rng: (lambda k: lambda at: KINDS[at.channel] == k)(rng.choice(["gyro", "accelerometer"])),
    "polarity": lambda rng: (lambda s: lambda at: at.step[2] == s)(rng.choice([1, -1])),
    "range": lambda rng: (lambda r: lambda at: at.step[3] == r)(rng.choice([2.2e-3, 2.2e-2])),
    "temperature": lambda rng: (lambda t: lambda at: at.nominal_degC == t)(rng.choice(sim.TEMPERATURES_degC)),
    "level": lambda rng: (lambda n: lambda at: at.step[1] == sim.KIND[KINDS[at.channel]]["levels_A"][n])(
        rng.integers(1, 6)
    ),
    "sign of the step": lambda rng: lambda at: np.sign(at.before_A),
}
_SHAPES: dict[str, Callable[[np.random.Generator], Where]] = {
    "constant": lambda rng: _always,
    "step": lambda rng: (lambda s: lambda at: at.share > s)(rng.uniform(0.2, 0.8)),
    "ramp": lambda rng: lambda at: at.share - 0.5,
    "decay": lambda rng: (lambda h: lambda at: np.exp(-at.hours / h))(rng.uniform(1.0, 6.0)),
    "cycle": lambda rng: (lambda h, p: lambda at: np.sin(2.0 * np.pi * at.hours / h + p))(
        rng.uniform(4.0, 24.0), rng.uniform(0.0, 2.0 * np.pi)
    ),
    "telegraph": lambda rng: (lambda n: lambda at: np.random.default_rng([n, int(at.hours / 2.0)]).integers(2))(
        rng.integers(2**31)
    ),
    "cubic in temperature": lambda rng: lambda at: (_rest(at) / 30.0) ** 3,
    "absolute temperature": lambda rng: lambda at: abs(_rest(at)) / 30.0,
    "in proportion to the level": lambda rng: lambda at: at.step[1] / sim.KIND[KINDS[at.channel]]["levels_A"][-1],
}
_WHAT = {"gain": 1e-6, "unit": 1e-6, "n": 1e-6, "p": 1e-6, "part": 1e-6, "current": 3e-9}


def drawn_world(number: int) -> Switch:
    """Return the world that a seed draws, in sizes that are ten times apart."""
    rng = np.random.default_rng([46, number])
    what, label, shape = (str(rng.choice(list(names))) for names in (_WHAT, _LABELS, _SHAPES))
    here, how = _LABELS[label](rng), _SHAPES[shape](rng)
    sizes = tuple(float(_WHAT[what] * 10.0**power) for power in (0, 1, 2))
    name = f"{number}: {what}, {label}, {shape}"
    return Switch(name, lambda size: Departed(size, what, lambda at: float(here(at) * how(at))), sizes)


def _of_table(name: str, what: str, where: Where, sizes: tuple[float, ...]) -> Switch:
    return Switch(name, lambda size: Departed(size, what, where), sizes)


SWITCHES = (*(_of_table(*row) for row in TABLE), *map(drawn_world, range(30)))


def simulated(seed: int, world: sim.World | None, switches: sim.Switches = sim.Switches()) -> sim.SimulatedCampaign:
    """Return the campaign of a seed in a world."""
    return sim.simulate(seed, switches, KINDS, repeat_channel=REPEATED, world=world)


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what a campaign states in a world, and its truth; ``chi2`` of a noise-free one is the judge's."""
    world = None if switch is None else switch.world(size)
    campaign = simulated(seed, world, _QUIET if noise_free else sim.Switches())
    with without_budgets():
        analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    document = build_results("doubt", analysis, {"records": len(campaign.rows)}, PROVENANCE)
    wanted = [entry for entry in estimates_of(document) if entry.quantity in QUANTITIES]
    trace = left_over(campaign, simulated(seed, None, _QUIET)) if noise_free else 0.0
    return Seen(wanted, [campaign.truth(entry) for entry in wanted], trace**2, 1, len(QUANTITIES[:3]) * 5 * len(KINDS))


def left_over(wrong: sim.SimulatedCampaign, right: sim.SimulatedCampaign) -> float:
    """Return |P d|: what a world changes in the readings, by their noise, behind all that the model leaves free.

    Free are the coefficients of both counters of each channel, an offset of each polarity of each visit, a steady
    drift of the calibrator, and, within what they are specified to, its offsets and its errors at each level.
    """
    pairs = [(one, other) for one, other in zip(wrong.rows, right.rows, strict=True) if _is_closed(other)]
    change = np.array([_reading(one) - _reading(other) for one, other in pairs])
    rows = [other for _, other in pairs]
    free, held = _columns(rows)
    noise = _noise(rows)
    factor = np.linalg.inv(np.linalg.cholesky(noise + held @ held.T))
    design = factor @ free
    design = design[:, np.linalg.norm(design, axis=0) > 0.0]
    left, singular, _ = np.linalg.svd(design / np.linalg.norm(design, axis=0), full_matrices=False)
    left = left[:, singular > 1e-9 * singular[0]]
    white = factor @ change
    return float(np.linalg.norm(white - left @ (left.T @ white)))


def _is_closed(row: sim.Row) -> bool:
    return bool(row.window.conditions["route"] == "closed")


def _reading(row: sim.Row) -> float:
    """Return the current of a record by nominal constants, ampere."""
    at, gate_s = row.window.conditions["channel"], row.sums["master_count"] / sim.MASTER_Hz
    ratio = sim.F_AF0_Hz * gate_s / row.sums["af_clock"]
    pulses = row.sums["npp"][at - 1] - row.sums["ppp"][at - 1]
    return float(sim.KIND[KINDS[at]]["k0_C"] * ratio * pulses / gate_s)


def _columns(rows: list[sim.Row]) -> tuple[np.ndarray, np.ndarray]:
    given = [row.window.conditions for row in rows]
    channel, polarity, level_A, range_A, repeat = (
        np.array([one[name] for one in given]) for name in ("channel", "polarity", "current_A", "range_A", "repeat")
    )
    nominal_degC = np.array([one["temperature_degC"] for one in given])
    rest_degC = np.array([row.context["unit_temperature_degC"] for row in rows]) - sim.REFERENCE_degC
    hours = np.array([row.window.t_start_ns for row in rows]) / 3.6e12
    signed_A = polarity * level_A
    free = [signed_A * hours]
    for number in KINDS:
        for sign in (1, -1):
            free += [signed_A * (channel == number) * (polarity == sign) * rest_degC**order for order in range(3)]
            free += [1.0 * ((channel == number) & (polarity == sign) & (nominal_degC == t) & (repeat == again))
                     for t in sim.TEMPERATURES_degC for again in (0, 1)]  # fmt: skip
    held = [0.5 * sim.FLOOR_A[full] * polarity * (range_A == full) for full in sorted(set(range_A))]
    held += [0.5 * sim.FLOOR_A[sim.smallest_range(one)] * polarity * (level_A == one) for one in set(level_A) - {0.0}]
    return np.column_stack(free), np.column_stack(held)


def _noise(rows: list[sim.Row]) -> np.ndarray:
    quantum_A = np.array([sim.KIND[row.window.conditions["kind"]]["k0_C"] / 100.0 for row in rows])
    clock = np.array([_reading(row) / row.sums["af_clock"] for row in rows])
    white_A2 = sim.NOISE["white_A_rtHz"] ** 2 / 200.0
    middle_h = np.array([row.window.t_start_ns for row in rows]) / 3.6e12
    walk = sim.NOISE["walk_A_rth"] ** 2 * np.minimum.outer(middle_h, middle_h)
    same = np.equal.outer(*(np.array([row.window.conditions["channel"] for row in rows]),) * 2)
    return np.asarray(walk * same + np.diag((quantum_A**2 + clock**2) / 6.0 + white_A2))
