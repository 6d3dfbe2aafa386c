"""Count-level campaigns for the tests of the fit: exact pulse counts of a charge-balance converter at DC.

Written from the physics alone: the charge of each gate is integrated and pulses are whole quanta of the running
charge, so counts are floors of a phase. Nothing of bench.systems is used to make them; ``analysed`` is what the
product makes of them.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.analysis import Analysis, Material, analyse
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow

F_AF0_Hz, MASTER_Hz, FG_Hz = 256e3, 1e7, 1e7
FLOOR_A = {2.2e-4: 6e-9, 2.2e-3: 7e-9, 2.2e-2: 40e-9, 2.2e-1: 0.7e-6}
KIND = {
    "gyro": {
        "k0_C": 1.25e-6,
        "full_scale_A": 0.299,
        "sensor_full_scale": 83.0,
        "sensor_unit": "deg/s",
        "levels_A": (30e-6, 100e-6, 1e-3, 10e-3, 100e-3, 200e-3),
        "stability_limit_ppm": 100.0,
        "bias_A": 400e-9,
        "bias_slope": 2e-9,
    },
    "accelerometer": {
        "k0_C": 1e-7,
        "full_scale_A": 0.0242,
        "sensor_full_scale": 20.2,
        "sensor_unit": "g",
        "levels_A": (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3),
        "stability_limit_ppm": 200.0,
        "bias_A": -250e-9,
        "bias_slope": 1e-9,
    },
}
NOISE = {"white_A_rtHz": 2e-9, "walk_A_rth": 3e-10}  # declared in the manifest
TEMPERATURES_degC = (-10.0, 5.0, 20.0, 35.0, 50.0)
REFERENCE_degC = 20.0


FRAMES = 10_000
Step = tuple[str, float, int, float]  # route, level, polarity, calibrator range
Row = RecordRow


@dataclass(frozen=True)
class Switches:
    """What the simulated campaign contains; all on is the design's truth."""

    gain: bool = True
    calibrator_errors: bool = True
    noise: bool = True
    quantised: bool = True
    af_error: float = 20e-6
    master_error: float = 1.5e-6
    zero_in_every_range: bool = False
    dsf_sigma_ppm: float = 400.0
    tc1_sigma_ppm_degC: float = 8.0
    lag: bool = True
    offset_A: float | None = None  # the same in every range, instead of a draw
    white_A_rtHz: float = 2e-9
    sensor_sigma_degC: float = 0.0  # offset of the unit's thermometer, one draw per campaign
    gain_drift_sigma: float = 0.0  # of the calibrator over the campaign, linear in time, one draw
    cubic_ppm_degC3: float = 0.0  # of DSF_N and DSF_P: what a parabola cannot compensate
    generator_sigma: float = 0.0  # of the function generator's frequency, relative, one draw per campaign
    same_cut: bool = False  # every gate cuts the pulses of a clock at the same place, one draw per campaign


@dataclass
class Unit:
    """Truth of one channel."""

    kind: str
    dsf_ppm: np.ndarray  # (2,) at the reference temperature
    tc1: np.ndarray
    tc2: np.ndarray
    bias_A: float
    bias_slope: float
    cubic_ppm_degC3: float
    bias_curve: float  # a straight bias would make whole-pulse combinations of the readings exactly zero

    def dsf(self, temperature_degC: float) -> np.ndarray:
        step = temperature_degC - REFERENCE_degC
        return self.dsf_ppm + self.tc1 * step + self.tc2 * step**2 + self.cubic_ppm_degC3 * step**3

    def bias(self, temperature_degC: float) -> float:
        step = temperature_degC - REFERENCE_degC
        return self.bias_A + self.bias_slope * step + self.bias_curve * step**2


@dataclass
class SimulatedCampaign:
    """Rows of a campaign, the truth behind them and the manifest sections."""

    rows: list[Row]
    units: dict[int, Unit]
    gain: float
    af_error: float
    master_error: float
    campaign: dict[str, Any]
    standards: dict[str, Any]
    biases_A: dict[tuple[int, float], float]  # of the first open row by channel and temperature, walk included
    drift: float  # of the calibrator over the campaign, relative

    @property
    def windows(self) -> list[RecordWindow]:
        """The records as a plan has them: what was asked for, nothing of what came out."""
        return [row.window for row in self.rows]

    def truth(self, estimate: dict[str, Any]) -> float:
        """True value of an estimate in its unit, at the temperature the estimate itself names."""
        conditions = estimate.conditions
        quantity = estimate.quantity
        if quantity == "master_clock_error":
            return 1e6 * self.master_error
        if quantity == "clock_ratio_error":
            return 1e6 * ((1.0 + self.master_error) / (1.0 + self.af_error) - 1.0)
        unit = self.units[conditions["channel"]]
        index = 0 if "_n" in quantity else 1
        if "_tc" in quantity:
            order = int(quantity[-1])
            if quantity.startswith("bias"):
                return (unit.bias_A, unit.bias_slope, unit.bias_curve)[order]
            return (unit.dsf_ppm, unit.tc1, unit.tc2)[order][index]
        if quantity == "bias":
            return self.biases_A[conditions["channel"], conditions["temperature_degC"]]
        at = unit.dsf(conditions["unit_temperature_degC"])
        return at[0] - at[1] if quantity == "dsf_asymmetry" else at[index]


@dataclass(frozen=True)
class Place:
    """Where a campaign is: its share of time, channel, set temperature, repeat, step.

    ``hours``: since its begin.   ``before_A``: signed current of the step before, 0 before the first of a visit.
    """

    share: float
    channel: int
    nominal_degC: float
    repeat: int
    step: Step
    hours: float = 0.0
    before_A: float = 0.0


class World:
    """What the model says of the world; a wrong one differs in one of these."""

    def gain(self, at: Place) -> float:
        """Return a further relative error of the calibrator."""
        return 0.0

    def input_A(self, current_A: float, at: Place) -> float:
        """Return what reaches the integrator of a current into the input."""
        return current_A

    def halves_A(self, at: Place, seconds: float) -> tuple[float, float]:
        """Return the mean further current in each half of a record."""
        return 0.0, 0.0

    def units(self, units: dict[int, Unit]) -> dict[int, Unit]:
        """Return what the units really are."""
        return units

    def unit(self, units: dict[int, Unit], at: Place) -> Unit:
        """Return the unit whose counts arrive where those of a channel are expected."""
        return units[at.channel]

    def counted(self, counts: dict[str, float], at: Place) -> dict[str, float]:
        """Return what the unit reports of its counts."""
        return counts

    def sensed_degC(self, unit_degC: float) -> float:
        """Return what the unit's thermometer reads."""
        return unit_degC


def smallest_range(level_A: float) -> float:
    return next(full for full in FLOOR_A if level_A <= full)


def manifest(kinds: dict[int, str]) -> tuple[dict[str, Any], dict[str, Any]]:
    names = ("k0_C", "full_scale_A", "sensor_full_scale", "sensor_unit", "stability_limit_ppm")
    campaign = {
        "analysis": "scale_factor",
        "temperature_sensor_u95_degC": 0.0,
        "reference_temperature_degC": REFERENCE_degC,
        "rate_Hz": 100.0,
        "af_clock_Hz": F_AF0_Hz,
        "fg_Hz": FG_Hz,
        "master_Hz": MASTER_Hz,
        "uut": {"model": "NGU", "serial": "SIM-1"},
        "channels": [
            {"number": number, "kind": kind, "levels_A": list(KIND[kind]["levels_A"]), "noise": dict(NOISE)}
            | {name: KIND[kind][name] for name in names}
            for number, kind in kinds.items()
        ],
    }
    uncertainty = [{"range_A": full, "relative": 20e-6, "floor_A": floor} for full, floor in FLOOR_A.items()]
    corrections = [{"range_A": full, "gain": 0.0, "offset_A": 0.0} for full in FLOOR_A]
    entry = {"driver": "fluke_5720a", "serial": "1", "uncertainty": uncertainty, "corrections": corrections}
    return campaign, {"calibrator": entry}


class _Bench:
    """The calibrator and the clocks of one campaign."""

    def __init__(self, rng: np.random.Generator, switches: Switches) -> None:
        self.rng, self.switches = rng, switches
        self.gain = rng.normal(0, 10e-6) if switches.gain else 0.0
        on = 1.0 if switches.calibrator_errors else 0.0
        self.offset = {full: on * rng.normal(0, floor / 2) for full, floor in FLOOR_A.items()}
        if switches.offset_A is not None:
            self.offset = dict.fromkeys(FLOOR_A, switches.offset_A)
        self.drift = 0.0
        self.generator = rng.normal(0, switches.generator_sigma) if switches.generator_sigma else 0.0
        self.cut = dict(zip(("af", "fg"), rng.uniform(size=2), strict=True)) if switches.same_cut else {}
        self.linearity: dict[float, float] = {}
        self.on = on
        # whole pulses per gate would lock every count to the same fraction of a pulse
        self.af_error, self.master_error = (
            error + (rng.uniform(-1e-7, 1e-7) if switches.quantised else 0.0)
            for error in (switches.af_error, switches.master_error)
        )

    def current_A(self, level_A: float, range_A: float, polarity: int) -> float:
        if level_A and level_A not in self.linearity:
            self.linearity[level_A] = self.on * self.rng.normal(0, FLOOR_A[range_A] / 2)
        error = self.offset[range_A] + (self.linearity[level_A] if level_A else 0.0)
        return polarity * (level_A * (1 + self.gain + self.drift) + error)

    def input_A(self, step: Step, leak_A: np.ndarray) -> float:
        """Current into the converter's input: nothing when open, else the calibrator's and the switch's leakage."""
        route, level, polarity, full = step
        return 0.0 if route == "open" else self.current_A(level, full, polarity) + leak_A[0 if polarity > 0 else 1]

    def floor(self, phases: np.ndarray, clock: str = "") -> np.ndarray:
        """Pulses of the first half and of the whole of a gate whose phase, (2,), starts anywhere."""
        if not self.switches.quantised:
            return phases
        start = self.cut[clock] if clock in self.cut else self.rng.uniform()
        return np.floor(start + phases)

    def counts(self, current_A: np.ndarray, unit: Unit, temperature_degC: float, nominal_s: float) -> list[dict]:
        """Counts of the first half and of the whole of one gate of ``nominal_s`` by the master clock, the net current
        into the integrator in both, (2,), given.
        """
        true_s = nominal_s / (1 + self.master_error) * np.array([0.5, 1.0])
        side = 0 if current_A[1] > 0 else 1
        per_pulse_C = KIND[unit.kind]["k0_C"] * (1 + 1e-6 * unit.dsf(temperature_degC)[side]) / (1 + self.af_error)
        pulses = self.floor(np.abs(current_A) * true_s / per_pulse_C)
        counted = {
            "n": pulses if side == 0 else np.zeros(2),
            "p": pulses if side else np.zeros(2),
            "af": self.floor(F_AF0_Hz * (1 + self.af_error) * true_s, "af"),
            "fg": self.floor(FG_Hz * (1 + self.generator) * true_s, "fg"),
        }
        return [{name: float(column[part]) for name, column in counted.items()} for part in range(2)]


def schedule(kind: str, switches: Switches) -> list[Step]:
    """(route, level, polarity, range) in the order of the paper's table 3."""
    levels = KIND[kind]["levels_A"]
    steps: list[Step] = [("open", 0.0, 0, 0.0)]
    zeros = sorted({smallest_range(level) for level in levels}) if switches.zero_in_every_range else None
    for full in zeros or [smallest_range(levels[0])]:
        steps += [("closed", 0.0, sign, full) for sign in (1, -1)]
    return steps + [("closed", level, sign, smallest_range(level)) for level in levels for sign in (1, -1)]


@dataclass(frozen=True)
class Point:
    """One record of a campaign: where it is, when its input is set and for how long it records, how it is labelled.

    ``arrived_s``: when its temperature was set.   ``lead_s``: from its input to the record.
    """

    place: Place
    at_s: float
    arrived_s: float
    conditions: dict[str, Any]
    lead_s: float = 20.0
    seconds: float = 100.0


def points_of(
    kinds: dict[int, str], temperatures: tuple[float, ...], repeat_channel: int | None, switches: Switches
) -> list[Point]:
    """Return the records of the 38-hour plan in its order."""
    visits = [(t, number, 0) for t in temperatures for number in kinds]
    visits += [] if repeat_channel is None else [(temperatures[-1], repeat_channel, 1)]
    length_s = len(temperatures) * 9000.0 + len(visits) * 15 * 120.0
    points: list[Point] = []
    now_s, arrived_s, slot = 0.0, 0.0, None
    for nominal, number, repeat in visits:
        if slot != nominal:
            slot, now_s, arrived_s = nominal, now_s + 9000.0, now_s + 9000.0
        before_A = 0.0
        for step in schedule(kinds[number], switches):
            at = Place(now_s / length_s, number, nominal, repeat, step, now_s / 3600.0, before_A)
            points.append(Point(at, now_s, arrived_s, _conditions(kinds[number], at)))
            now_s, before_A = now_s + 120.0, step[1] * step[2]
    return points


def simulate(
    seed: int,
    switches: Switches = Switches(),
    kinds: dict[int, str] | None = None,
    temperatures: tuple[float, ...] = TEMPERATURES_degC,
    repeat_channel: int | None = None,
    world: World | None = None,
) -> SimulatedCampaign:
    """One campaign in the order of the 38-hour plan, seeded."""
    kinds = kinds or {1: "gyro", 2: "accelerometer"}
    return simulate_points(seed, points_of(kinds, temperatures, repeat_channel, switches), kinds, switches, world)


def simulate_points(
    seed: int, points: list[Point], kinds: dict[int, str], switches: Switches, world: World | None
) -> SimulatedCampaign:
    """One campaign of these records, seeded."""
    world = world or World()
    rng = np.random.default_rng(seed)
    bench = _Bench(rng, switches)
    units = world.units({number: _unit(rng, kind, switches) for number, kind in kinds.items()})
    leak = rng.uniform(-1e-10, 1e-10, 2) * bench.on
    walk, within = _Walk(rng, switches.noise), np.random.default_rng([seed, 1])
    sensor_degC = rng.normal(0, switches.sensor_sigma_degC) if switches.sensor_sigma_degC else 0.0
    drift = rng.normal(0, switches.gain_drift_sigma) if switches.gain_drift_sigma else 0.0
    rows: list[Row] = []
    biases_A: dict[tuple[int, float], float] = {}
    for point in points:
        at = point.place
        unit = world.unit(units, at)
        left = 0.43 * float(np.exp(-(point.at_s - point.arrived_s) / 1500.0)) if switches.lag else 0.0
        unit_degC = at.nominal_degC - left
        bias_A = unit.bias(unit_degC) + walk.at(point.at_s, at.channel)
        biases_A.setdefault((at.channel, at.nominal_degC), bias_A)
        bench.drift = drift * (at.share - 0.5) + world.gain(at)
        net_A = world.input_A(bench.input_A(at.step, leak), at) - bias_A
        std_A = switches.white_A_rtHz / np.sqrt(2.0 * point.seconds) if switches.noise else 0.0
        net_A += rng.normal(0, std_A) if switches.noise else 0.0
        halves_A = net_A + np.array(world.halves_A(at, point.seconds)) + [1.0, -1.0] * within.normal(0, std_A, 1)
        counted = bench.counts(np.array([halves_A[0], halves_A.mean()]), unit, unit_degC, point.seconds)
        counts = [world.counted(one, at) for one in counted]
        rows.append(_row(len(rows) + 1, point, counts, world.sensed_degC(unit_degC + sensor_degC)))
    errors = bench.gain, bench.af_error, bench.master_error
    return SimulatedCampaign(rows, units, *errors, *manifest(kinds), biases_A, drift)


class _Walk:
    """Random walk of every channel's bias, 0.3 nA after an hour, from one moment asked for to the next."""

    def __init__(self, rng: np.random.Generator, on: bool) -> None:
        self.rng, self.on = rng, on
        self.now_s = 0.0
        self.bias_A = np.zeros(11)

    def at(self, now_s: float, channel: int) -> float:
        if self.on:
            self.bias_A += self.rng.normal(0, 3e-10 * np.sqrt((now_s - self.now_s) / 3600.0), self.bias_A.size)
            self.now_s = now_s
        return float(self.bias_A[channel])


def _unit(rng: np.random.Generator, kind: str, switches: Switches) -> Unit:
    return Unit(
        kind,
        rng.normal(0, switches.dsf_sigma_ppm, 2),
        rng.normal(0, switches.tc1_sigma_ppm_degC, 2),
        rng.normal(0, 0.03, 2),
        KIND[kind]["bias_A"] * rng.uniform(0.8, 1.2),
        KIND[kind]["bias_slope"] * rng.uniform(0.8, 1.2),
        switches.cubic_ppm_degC3,
        rng.normal(0.0, 2e-11),
    )


def _conditions(kind: str, at: Place) -> dict[str, Any]:
    route, level, polarity, full = at.step
    return {
        "channel": at.channel,
        "kind": kind,
        "temperature_degC": at.nominal_degC,
        "current_A": level,
        "polarity": polarity,
        "range_A": full,
        "route": route,
        "repeat": at.repeat,
        "purpose": "measurement",
    }


def _row(number: int, point: Point, counts: list[dict[str, float]], unit_degC: float) -> Row:
    halves = []
    for counted, share in zip(counts, (0.5, 1.0), strict=True):
        npp, ppp = np.zeros(10), np.zeros(10)
        npp[point.place.channel - 1], ppp[point.place.channel - 1] = counted["n"], counted["p"]
        clocks = {"af_clock": np.float64(counted["af"]), "fg_count": np.float64(counted["fg"])}
        master = np.int64(round(share * point.seconds * MASTER_Hz))
        halves.append({"npp": npp, "ppp": ppp, **clocks, "master_count": master})
    start_ns = round((point.at_s + point.lead_s) * 1e9)
    end_ns = start_ns + round(point.seconds * 1e9)
    window = RecordWindow(number, "port_a", 0, FRAMES, start_ns, end_ns, point.conditions)
    context = {"unit_temperature_degC": unit_degC}
    return RecordRow(window, halves[1], FRAMES, 0, 0, Quality.GOOD, context, first_half=halves[0])


def analysed(
    campaign: SimulatedCampaign, method: str = "gls", standards: dict[str, Any] | None = None, **changes: Any
) -> Analysis:
    """Return the analysis of a campaign; ``changes`` are of the manifest."""
    given = campaign.standards if standards is None else standards
    return analyse(Material(campaign.rows, campaign.campaign | changes, given), method)


def repeated_off(campaign: SimulatedCampaign, ppm: float) -> list[Row]:
    """Return the rows of a campaign whose calibrator delivers more in the closing repeat."""
    rows = []
    for row in campaign.rows:
        factor = 1.0 + 1e-6 * ppm * row.window.conditions["repeat"]
        sums = dict(row.sums) | {name: row.sums[name] * factor for name in ("npp", "ppp")}
        rows.append(replace(row, sums=sums))
    return rows
