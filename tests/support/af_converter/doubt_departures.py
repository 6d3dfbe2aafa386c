"""Further wrong worlds of a scale-factor campaign: those of a table, and drawn ones of label, shape and size.

What departs (the calibrator's gain, a counter, the current that arrives, the thermometer) does so where a label has a
value, in a shape of time, temperature, level or history. Physics and judge share no line with the product.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import fit_simulation as sim
import numpy as np
from doubt_classes import PROVENANCE, Seen, Switch
from trials import without_budgets

from bench.analysis import Estimate, Material, build_results, estimates_of
from bench.systems.af_converter.scale_factor.analysis import analyse

SYSTEM = "departures"
KINDS = {1: "gyro", 3: "gyro", 4: "gyro", 7: "accelerometer"}
REPEATED = 1
QUANTITIES = ("dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_tc0", "dsf_n_tc1", "dsf_n_tc2", "dsf_p_tc0", "dsf_p_tc1",
              "dsf_p_tc2")  # fmt: skip
TAIL_s = 45.0
_NOT_SEEN = "not_seen"  # the table of the report that computes what a campaign cannot show
SEEN = 7.5  # of |P d|: a threshold of about 4.5 and a power of 99.9 %
BETWEEN_ppm = 1.0  # standard, of a counter from visit to visit: what the plan declares, its curve beyond a parabola too
QUIET = sim.Switches(gain=False, calibrator_errors=False, noise=False, quantised=False)

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

    def halves_A(self, at: sim.Place, seconds: float) -> tuple[float, float]:
        if self.what not in ("tail", "onset") or at.step[0] == "open":
            return 0.0, 0.0
        begin_A = self.size * self.where(at) * (at.step[1] * at.step[2] - at.before_A * (self.what == "tail"))
        left = np.exp(-seconds / 2.0 / TAIL_s)
        mean_A = begin_A * TAIL_s / (seconds / 2.0) * (1.0 - left)
        return mean_A, mean_A * left

    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        factors = {"n": ("n", "unit"), "p": ("p", "unit")}
        change = 1.0 + self.size * self.where(at)
        return counts | {name: counts[name] * change for name, of in factors.items() if self.what in of}

    def units(self, units: dict[int, sim.Unit]) -> dict[int, sim.Unit]:
        if self.what != "curve":
            return units
        at = {number: sim.Place(0.0, number, sim.REFERENCE_degC + 1.0, 0, ("closed", 0.0, 1, 0.0)) for number in units}
        return {
            number: replace(one, cubic_ppm_degC3=self.size * self.where(at[number])) for number, one in units.items()
        }

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
    ("cubic_of_all", "curve", _always, (3e-5, 3e-4, 3e-3)),
    ("cubic_by_channel", "curve", lambda at: (-1.0) ** at.channel, (1e-5, 3e-4, 1e-3)),
    ("gradient_of_asymmetry", "n", lambda at: 1e-6 * (at.channel - 3), (0.3, 2.0, 20.0)),
    ("shunt", "part", lambda at: -1.0, (5e-7, 1e-5, 1e-4)),
    ("self_heating", "part", lambda at: (at.step[1] / sim.KIND[KINDS[at.channel]]["full_scale_A"]) ** 2,
     (3e-6, 3e-5, 5e-4)),
    ("settling_tail", "tail", _always, (5e-7, 5e-6, 4e-5)),
    ("settling_onset", "onset", _always, (5e-7, 5e-6, 4e-5)),
    ("memory", "current", lambda at: 1e-6 * at.before_A, (1.0, 20.0, 500.0)),
)  # fmt: skip

_LABELS: dict[str, tuple[Any, ...]] = {
    "all": (0,),
    "channel": tuple(KINDS),
    "kind": ("gyro", "accelerometer"),
    "polarity": (1, -1),
    "range": (2.2e-3, 2.2e-2),
    "temperature": sim.TEMPERATURES_degC,
    "level": (1, 2, 3, 4, 5),
    "sign of the step": (0,),
}
_SHAPES = ("constant", "step", "ramp", "decay", "cycle", "telegraph", "cubic in temperature", "absolute temperature",
           "in proportion to the level")  # fmt: skip
_OF_TEMPERATURE = ("cubic in temperature", "absolute temperature")
_WHAT = {"gain": 1e-6, "unit": 1e-6, "n": 1e-6, "p": 1e-6, "part": 1e-6, "current": 3e-9}


@dataclass(frozen=True)
class Drawn:
    """Where a drawn world departs: at one value of a label, in a shape with two numbers from 0 to 1."""

    what: str
    label: str
    value: Any
    shape: str
    one: float
    two: float

    def __call__(self, at: sim.Place) -> float:
        """Return by what part of its size the world departs at a place."""
        return float(self._here(at) * self._shape(at))

    @property
    def is_of_unit(self) -> bool:
        """Whether it is as if the unit had other scale factors over temperature: those are true then."""
        return (
            self.what != "current" and self.shape in _OF_TEMPERATURE and self.label not in ("sign of the step", "level")
        )

    def _here(self, at: sim.Place) -> float:
        levels_A = sim.KIND[KINDS[at.channel]]["levels_A"]
        return {
            "all": 1.0,
            "channel": at.channel == self.value,
            "kind": KINDS[at.channel] == self.value,
            "polarity": at.step[2] == self.value,
            "range": at.step[3] == self.value,
            "temperature": at.nominal_degC == self.value,
            "level": self.label == "level" and at.step[1] == levels_A[self.value],
            "sign of the step": np.sign(at.before_A),
        }[self.label]

    def _shape(self, at: sim.Place) -> float:
        largest_A = sim.KIND[KINDS[at.channel]]["levels_A"][-1]
        coin = np.random.default_rng([int(1e9 * self.one), int(at.hours / 2.0)])
        return {
            "constant": 1.0,
            "step": at.share > 0.2 + 0.6 * self.one,
            "ramp": at.share - 0.5,
            "decay": np.exp(-at.hours / (1.0 + 5.0 * self.one)),
            "cycle": np.sin(2.0 * np.pi * (at.hours / (4.0 + 20.0 * self.one) + self.two)),
            "telegraph": coin.integers(2),
            "cubic in temperature": (_rest(at) / 30.0) ** 3,
            "absolute temperature": abs(_rest(at)) / 30.0,
            "in proportion to the level": at.step[1] / largest_A,
        }[self.shape]


def drawn_world(number: int) -> Switch:
    """Return the world that a seed draws, in sizes that are ten times apart."""
    rng = np.random.default_rng([46, number])
    what, label, shape = (str(rng.choice(list(names))) for names in (_WHAT, _LABELS, _SHAPES))
    value = _LABELS[label][rng.integers(len(_LABELS[label]))]
    where = Drawn(what, label, value, shape, *rng.uniform(size=2))
    sizes = tuple(float(_WHAT[what] * 10.0**power) for power in (0, 1, 2))
    return Switch(f"{number}: {what}, {label}, {shape}", lambda size: Departed(size, what, where), sizes, _NOT_SEEN)


def _of_table(name: str, what: str, where: Where, sizes: tuple[float, ...]) -> Switch:
    return Switch(name, lambda size: Departed(size, what, where), sizes, _NOT_SEEN)


SWITCHES = (*(_of_table(*row) for row in TABLE), *map(drawn_world, range(30)))


def simulated(seed: int, world: sim.World | None, switches: sim.Switches | None = None) -> sim.SimulatedCampaign:
    """Return the campaign of a seed in a world."""
    return sim.simulate(seed, switches or sim.Switches(), KINDS, repeat_channel=REPEATED, world=world)


def truth_of(entry: Estimate, campaign: sim.SimulatedCampaign, world: sim.World | None) -> float:
    """Return the truth of an estimate; a unit whose scale factors follow a shape of temperature really has those."""
    true, where = campaign.truth(entry), getattr(world, "where", None)
    if not isinstance(where, Drawn) or not where.is_of_unit or "_tc" in entry.quantity:
        return true
    number, at_degC = entry.conditions["channel"], entry.conditions["temperature_degC"]
    level_A = sim.KIND[KINDS[number]]["levels_A"][-1]
    more = {
        side: where(sim.Place(0.0, number, at_degC, 0, ("closed", level_A, sign, sim.smallest_range(level_A))))
        * (where.what not in ("n", "p") or where.what == side)
        for side, sign in (("n", 1), ("p", -1))
    }
    more_ppm = {side: -1e6 * world.size * part for side, part in more.items()}
    return true + (more_ppm["n"] - more_ppm["p"] if entry.quantity == "dsf_asymmetry" else more_ppm[entry.quantity[-1]])


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what a campaign states in a world, and its truth; ``chi2`` of a noise-free one is the judge's."""
    world = None if switch is None else switch.world(size)
    campaign = simulated(seed, world, QUIET if noise_free else None)
    with without_budgets():
        analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    document = build_results("doubt", analysis, {"records": len(campaign.rows)}, PROVENANCE)
    wanted = [entry for entry in estimates_of(document) if entry.quantity in QUANTITIES]
    trace = left_over(campaign, simulated(seed, None, QUIET)) if noise_free else 0.0
    return Seen(
        wanted,
        [truth_of(entry, campaign, world) for entry in wanted],
        trace**2,
        len(QUANTITIES[:3]) * 5 * len(KINDS),
    )


def left_over(wrong: sim.SimulatedCampaign, right: sim.SimulatedCampaign) -> float:
    """Return |P d|: what a world changes in the readings, by their noise, behind all that the model leaves free.

    Free are the coefficients of both counters of each channel, an offset of each polarity of each visit, a steady
    drift of the calibrator, and, within what they are specified to, its offsets and its errors at each level.
    """
    both = zip(wrong.rows, right.rows, strict=True)
    pairs = [(one, other) for one, other in both if other.window.conditions["route"] == "closed"]
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
    halves = np.array([(_more(one) - _more(other)) / _more_std_A(other) for one, other in pairs])
    return float(np.hypot(np.linalg.norm(white - left @ (left.T @ white)), np.linalg.norm(halves)))


def _reading(row: sim.Row) -> float:
    """Return the current of a record by nominal constants, ampere."""
    at, gate_s = row.window.conditions["channel"], row.sums["master_count"] / sim.MASTER_Hz
    ratio = sim.F_AF0_Hz * gate_s / row.sums["af_clock"]
    pulses = row.sums["npp"][at - 1] - row.sums["ppp"][at - 1]
    return float(sim.KIND[KINDS[at]]["k0_C"] * ratio * pulses / gate_s)


def _more(row: sim.Row) -> float:
    """Return how much more current the first half of a record has than the second, ampere."""
    rest = {name: row.sums[name] - row.first_half[name] for name in row.sums}
    return _reading(replace(row, sums=row.first_half)) - _reading(replace(row, sums=rest))


def _more_std_A(row: sim.Row) -> float:
    """Return the noise of that: the residues of a pulse at both ends and twice in the middle, and white noise."""
    quantum_A = sim.KIND[row.window.conditions["kind"]]["k0_C"] / 50.0
    return float(np.hypot(quantum_A * np.sqrt(6.0 / 12.0), sim.NOISE["white_A_rtHz"] / np.sqrt(50.0)))


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
    places = ("channel", "temperature_degC", "repeat", "polarity")
    visit = np.array([hash(tuple(row.window.conditions[name] for name in places)) for row in rows])
    current_A = np.array([_reading(row) for row in rows])
    between = (1e-6 * BETWEEN_ppm) ** 2 * np.outer(current_A, current_A) * np.equal.outer(visit, visit)
    return np.asarray(walk * same + between + np.diag((quantum_A**2 + clock**2) / 6.0 + white_A2))
