"""Campaigns of a plan straight from the physics of simulated modules: no instrument, no wire, no file.

Motions are closed forms of the planned calls, written here; the fits see rows as they see those of a session.
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from imu_material import record_of
from plan_sample import reworded
from rehearsal import ROOT
from scipy.linalg import sqrtm
from scipy.spatial.transform import Rotation
from spread_study import Key, Study, key_of, name_of

from bench.analysis import CONTINUES, Analysis, Estimates, Material
from bench.model.clock import NS
from bench.plan import Plan, PlannedCall, PlannedRecord, compile_sequence
from bench.record import RecordRow
from bench.session.designed import problem_of
from bench.session.predicted import predicted
from bench.systems.gnc.calibration import analysis as calibration
from bench.systems.gnc.calibration.design import Calibrations, Candidate
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.gnc import imu_errors
from sim_instruments.worlds.gnc.imu import ACCEL_LSB_G, GYRO_LSB_DEG_S, GncImu, ImuOptions
from sim_instruments.worlds.gnc.truth import estimates

SITE = Site()
KINDS = {"accel": "accelerometer", "gyro": "gyro"}


@dataclass(frozen=True)
class Taken:
    """A record of a plan: begin and end in seconds of the bench, conditions, what turns the table in it."""

    begin_s: float
    end_s: float
    conditions: dict[str, Any]
    table: "Table"


def plan_of(sequence: str, rate_Hz: float = 200.0, **settings: str) -> Plan:
    """A shipped sequence, its samples at another rate."""
    plan = compile_sequence(ROOT / "sequences" / f"{sequence}.yaml", None, settings)
    return replace(plan, campaign={**plan.campaign, "rate_Hz": rate_Hz})


def rewritten(tmp_path: Path, name: str, *cuts: tuple[str, str], **settings: str) -> Plan:
    """A shipped sequence with other words in it."""
    path = tmp_path / f"{name}.yaml"
    path.write_text(
        reworded((ROOT / "sequences" / f"{name}.yaml").read_text(encoding="utf-8"), *cuts), encoding="utf-8"
    )
    return compile_sequence(path, None, settings)


def records_of(plan: Plan) -> list[Taken]:
    """The measuring records; what continues one is part of it."""
    turns = [(plan.prepare_s + step.at_s, step.arguments) for step in plan.phase("campaign")
             if isinstance(step, PlannedCall) and step.name == "turn"]  # fmt: skip
    found: list[Taken] = []
    for step in plan.phase("campaign"):
        if isinstance(step, PlannedRecord):
            begin_s = plan.prepare_s + step.at_s
            if CONTINUES in step.conditions:
                begin_s = found.pop().begin_s
            end_s = plan.prepare_s + step.at_s + step.seconds
            inside = [turn for turn in turns if begin_s < turn[0] < end_s]
            found.append(Taken(begin_s, end_s, dict(step.conditions), _table(step.conditions, begin_s, inside)))
            found[-1].conditions.pop(CONTINUES, None)
    return found


def _table(conditions: Any, begin_s: float, turns: list[tuple[float, Any]]) -> "Table":
    motion = [at(conditions[f"{name}_deg"]) for name in ("outer", "middle", "inner")]
    if "rate_deg_s" in conditions:
        motion[2].angle = lambda t_s: conditions["inner_deg"] + conditions["rate_deg_s"] * (t_s - begin_s)
    for at_s, turn in turns:
        place = turn["axis"] - 1
        start_deg = conditions[f"{('outer', 'middle', 'inner')[place]}_deg"]
        moved = trapezoid(at_s + 1.0, turn["angle"], turn["rate"], turn["acceleration"])
        motion[place].angle = lambda t_s, moved=moved, start_deg=start_deg: start_deg + moved.angle(t_s)
    return Table(tuple(motion), str(conditions["mounting"]), str(conditions.get("table", "non_magnetic")))


@dataclass
class Module:
    """One simulated unit that was switched on at second 2 of the bench, and the rows of its campaign."""

    imu: GncImu
    rows: list[RecordRow] = field(default_factory=list)
    taken: list[Taken] = field(default_factory=list)
    rate_Hz: float = 200.0

    def mean_bias(self, kind: str, taken: list[Taken]) -> np.ndarray:
        """Mean bias (3,) of N = S (input + b) over records, deg/s or g."""
        means = [getattr(self.imu, kind)(_spread_ns(one)).mean(axis=0) for one in taken]
        return np.average(means, axis=0, weights=[one.end_s - one.begin_s for one in taken])

    def degC(self, taken: list[Taken]) -> np.ndarray:
        return np.array([np.mean([self.imu.temperature_degC(_spread_ns(one)).mean() for one in taken])])


def _spread_ns(one: Taken) -> np.ndarray:
    count = round(2.0 * (one.end_s - one.begin_s))
    return ((one.begin_s + (np.arange(count) + 0.5) / 2.0) * NS).astype(np.int64)


def campaign(
    records: list[Taken], seed: int, rate_Hz: float = 200.0, options: imu_errors.ImuOptions | None = None
) -> Module:
    """The records of one unit."""
    imu = GncImu(seed, f"GNC-{seed}", options or imu_errors.ImuOptions(), Table(), SITE)
    imu.power.on(2 * NS)
    module = Module(imu, taken=records, rate_Hz=rate_Hz)
    interval_ns = round(NS / rate_Hz)
    for number, one in enumerate(records, 1):
        count = round((one.end_s - one.begin_s) * rate_Hz)
        t_ns = round(one.begin_s * NS) + np.arange(1, count + 1, dtype=np.int64) * interval_ns
        imu.surroundings = one.table
        counts = imu.sample(t_ns, interval_ns)
        columns = {
            "gyro": counts.gyro, "accel": counts.accel, "mag": counts.mag, "temperature": counts.temperature,
            "tick": (t_ns // 1000 % (1 << 32)).astype(np.uint32),
        }  # fmt: skip
        module.rows.append(record_of(number, round(one.begin_s * rate_Hz), t_ns, columns, one.conditions))
    return module


def truth_of(module: Module, taken: list[Taken]) -> dict[Key, float]:
    """True values of some records, as the simulator states them."""
    windows = [row.window for row, one in zip(module.rows, module.taken, strict=True) if one in taken]
    truths = estimates({"": module.imu}, windows)
    return {name_of(entry["quantity"], entry["conditions"]): float(entry["value"]) for entry in truths}


def calibration_truth(module: Module) -> dict[Key, float]:
    """True values of a calibration: sensors and biases over the records of each first set."""
    truth = truth_of(module, [one for item in ("position", "rotation") for one in _sets(module.taken, item)[0]])
    places = [(prefix, {"kind": kind, "axis": axis}) for prefix, kind in KINDS.items() for axis in "xyz"]
    return truth | {name_of(f"{prefix}_scale_repeatability", place): 0.0 for prefix, place in places}


def left_by(module: Module, found_estimates: Estimates) -> dict[Key, float]:
    """True coupling that a calibration leaves: K S at the temperature of the check."""
    found = {key_of(entry): entry.value for entry in found_estimates}
    left: dict[Key, float] = {}
    for prefix, kind, item, errors in (
        ("accel", "accelerometer", "position", module.imu.errors.accel),
        ("gyro", "gyro", "rotation", module.imu.errors.gyro),
    ):
        _, check = _sets(module.taken, item)
        places = {(row, column): {"kind": kind, "row": "xyz"[row], "column": "xyz"[column]}
                  for row, column in np.ndindex(3, 3)}  # fmt: skip
        matrix = np.array([found[name_of(f"{prefix}_matrix", place)] for place in places.values()]).reshape(3, 3)
        product = matrix @ errors.sensitivity_at(module.degC(check))[0]
        left |= {name_of(f"{prefix}_coupling_compensated", place): product[where]
                 for where, place in places.items() if where[0] != where[1]}  # fmt: skip
    return left


def _sets(taken: list[Taken], item: str) -> tuple[list[Taken], list[Taken]]:
    """The records of the first and of the second time."""
    first: dict[str, Taken] = {}
    second = []
    for one in taken:
        if one.conditions["item"] == item:
            name = str((one.conditions.get("up"), one.conditions.get("axis"), one.conditions.get("direction")))
            if name in first:
                second.append(one)
            first.setdefault(name, one)
    return list(first.values()), second


def bias_truth(module: Module) -> dict[Key, float]:
    """True biases of a unit at rest, and the expected scatter of means by the noise of the simulator."""
    by_item = {item: [one for one in module.taken if one.conditions["item"] == item]
               for item in ("bias", "flip", "stability", "repeatability")}  # fmt: skip
    truth: dict[Key, float] = {}
    for kind, prefix, item, factor, errors in (
        ("gyro", "gyro", "bias", 3600.0, module.imu.errors.gyro),
        ("accelerometer", "accel", "flip", -1.0, module.imu.errors.accel),
    ):
        name = "gyro_bias_deg_s" if kind == "gyro" else "accel_bias_g"
        sensitivity = errors.sensitivity_at(module.degC(by_item[item]))[0]
        bias = factor * sensitivity @ module.mean_bias(name, by_item[item])
        (stable,) = by_item["stability"]
        begins = stable.begin_s + 10.0 * np.arange(360)
        windows = by_item["repeatability"]
        for axis in range(3):
            noise = _noise(kind, sensitivity[axis], 1.0 / module.rate_Hz)
            unit = 3600.0 if kind == "gyro" else 1e3
            place = {"kind": kind, "axis": "xyz"[axis]}
            truth[name_of(f"{prefix}_bias", place | {"output": "indicated"})] = bias[axis]
            truth[name_of(f"{prefix}_bias_stability", place)] = unit * _scatter(noise, begins, np.full(360, 10.0))
            lengths = np.array([one.end_s - one.begin_s for one in windows])
            starts = np.array([one.begin_s for one in windows])
            truth[name_of(f"{prefix}_bias_repeatability", place)] = unit * _scatter(noise, starts, lengths)
    return truth


def _noise(kind: str, row: np.ndarray, interval_s: float) -> tuple[float, list[tuple[float, float]]]:
    """White variance of a mean over a second, and variance and time of each slow part, as the simulator makes them."""
    gain = float(row @ row)
    if kind == "gyro":
        return (imu_errors.ARW_DEG_RT_H / 60.0) ** 2 + GYRO_LSB_DEG_S**2 / 12.0 * interval_s, [
            (gain * imu_errors.SLOW_GYRO_DEG_S**2, imu_errors.SLOW_GYRO_S)
        ]
    white = imu_errors.VRW_G_RTS**2 + ACCEL_LSB_G**2 / 12.0 * interval_s
    return white, [(gain * imu_errors.SLOW_ACCEL_G**2, time_s) for time_s in imu_errors.SLOW_ACCEL_S]


def _scatter(noise: tuple[float, list[tuple[float, float]]], begin_s: np.ndarray, length_s: np.ndarray) -> float:
    """Root of the expected sample variance of means."""
    covariance = np.diag(noise[0] / length_s)
    for variance, time_s in noise[1]:
        covariance = covariance + variance * _together(time_s, tuple(begin_s), tuple(length_s))
    count = len(begin_s)
    return float(np.sqrt((np.trace(covariance) - covariance.sum() / count) / (count - 1)))


@cache
def _together(time_s: float, begin_s: tuple[float, ...], length_s: tuple[float, ...]) -> np.ndarray:
    """Covariance of the means of slow noise of unit variance, summed up over ten points of each."""
    points = np.array(begin_s)[:, None] + (np.arange(10) + 0.5) / 10.0 * np.array(length_s)[:, None]
    apart = np.abs(points.ravel()[:, None] - points.ravel())
    return np.exp(-apart / time_s).reshape(len(begin_s), 10, -1, 10).mean(axis=(1, 3))


def magnetometer_truth(module: Module) -> dict[Key, float]:
    """True ellipse of the turn about z by both methods, and the ellipsoid that keeps volumes."""
    turns = [one for one in module.taken if one.conditions["item"] == "magnetometer"]
    module.imu.surroundings = turns[0].table
    truth: dict[Key, float] = {}
    for (quantity, place), value in truth_of(module, turns).items():
        methods = ("ellipsoid",) if quantity == "mag_hard_iron" else ("ellipse", "extremes")
        truth |= {name_of(quantity, json.loads(place) | {"method": method}): value for method in methods}
    kind = {"kind": "magnetometer", "method": "ellipsoid"}
    inverse = np.linalg.inv(module.imu.magnetometer.matrix)
    soft = np.real(sqrtm(inverse.T @ inverse)) / np.linalg.det(inverse) ** (1 / 3)
    for row, column in zip(*np.tril_indices(3), strict=True):
        place = kind | {"row": "xyz"[row], "column": "xyz"[column]}
        truth[name_of("mag_soft_iron", place)] = float(soft[row, column])
    return truth


def study(
    plan: Plan,
    analyse: Callable[[Material], Analysis],
    truth: Callable[[Module, Analysis], Mapping[Key, float]],
    first_seed: int,
    units: int,
) -> Study:
    """Units of seeds that follow each other."""
    found = Study(predicted(plan))
    records = records_of(plan)
    for seed in range(first_seed, first_seed + units):
        module = campaign(records, seed, plan.campaign["rate_Hz"])
        analysis = analyse(Material(rows=module.rows, campaign=plan.campaign, standards={}))
        found.add(analysis.estimates, truth(module, analysis))
    return found


def calibration_study(plan: Plan, first_seed: int, units: int) -> Study:
    """Calibrations of units of seeds that follow each other."""
    return study(
        plan,
        calibration.analyse,
        lambda module, analysis: calibration_truth(module) | left_by(module, analysis.estimates),
        first_seed,
        units,
    )


IDEAL = ImuOptions(errors=False, noise=False)
QUIET = ImuOptions(noise=False)
# v_table = M v_body, from the words "body axis along the inner axis, the other two follow cyclically"
MOUNTINGS = {
    "x": np.eye(3),
    "y": np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], float),
    "z": np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float),
}


@dataclass
class Formula:
    """An axis whose angle is a function of seconds."""

    angle: Callable[[np.ndarray], np.ndarray]
    step_s: float = 1e-5

    def angle_deg(self, t_ns: np.ndarray) -> np.ndarray:
        return self.angle(np.asarray(t_ns) / NS)

    def rate_deg_s(self, t_ns: np.ndarray) -> np.ndarray:
        t_s = np.asarray(t_ns) / NS
        return (self.angle(t_s + self.step_s) - self.angle(t_s - self.step_s)) / (2 * self.step_s)


def at(angle_deg: float) -> Formula:
    return Formula(lambda t_s: np.full(np.shape(t_s), float(angle_deg)))


def turning(rate_deg_s: float) -> Formula:
    return Formula(lambda t_s: rate_deg_s * t_s)


def trapezoid(start_s: float, turn_deg: float, rate_deg_s: float, acceleration_deg_s2: float) -> Formula:
    """From rest to rest by ``turn_deg``, rate and acceleration without sign."""
    ramp_s = rate_deg_s / acceleration_deg_s2
    cruise_s = abs(turn_deg) / rate_deg_s - ramp_s
    assert cruise_s > 0

    def angle(t_s: np.ndarray) -> np.ndarray:
        up = np.clip(t_s - start_s, 0.0, ramp_s)
        flat = np.clip(t_s - start_s - ramp_s, 0.0, cruise_s)
        down = np.clip(t_s - start_s - ramp_s - cruise_s, 0.0, ramp_s)
        way = acceleration_deg_s2 * (up**2 / 2 + ramp_s * down - down**2 / 2) + rate_deg_s * flat
        return np.copysign(way, turn_deg)

    return Formula(angle)


@dataclass
class Table:
    """Surroundings of a module on a table; angles or motions are (outer, middle, inner)."""

    motion: tuple[Formula, Formula, Formula] = field(default_factory=lambda: (at(0), at(0), at(0)))
    mounting: str = "x"
    table: str = "non_magnetic"


def posed(outer: float, middle: float, inner: float, mounting: str = "x") -> Table:
    return Table((at(outer), at(middle), at(inner)), mounting)


def module(table: Table, options: ImuOptions = IDEAL, serial: str = "GNC-01", site: Site | None = None) -> GncImu:
    return GncImu(11, serial, options, table, site or Site())


def times_ns(seconds: float, first_s: float = 0.0, rate_hz: float = 200.0) -> np.ndarray:
    """Time stamps of contiguous samples, the first interval of which begins at ``first_s``."""
    return round(first_s * NS) + np.arange(1, round(seconds * rate_hz) + 1, dtype=np.int64) * round(NS / rate_hz)


def body_to_local(table: Table, t_ns: np.ndarray, site: Site) -> Rotation:
    """Attitude by scipy alone: v_n = Rz(90 - azimuth) Rz(outer) Ry(middle) Rx(inner) M v_b."""
    outer, middle, inner = (axis.angle_deg(t_ns) for axis in table.motion)
    angles = np.stack((outer + 90.0 - site.azimuth_deg, middle, inner), axis=-1)
    return Rotation.from_euler("ZYX", angles, degrees=True) * Rotation.from_matrix(MOUNTINGS[table.mounting])


GIVEN = "gnc_imu_calibration"
SHORTEST = Candidate(check_s=20.0, turn_s=20.3, turns=3), 300.0  # what 'bench plan gnc_imu_calibration' finds


@cache
def given() -> Plan:
    return compile_sequence(ROOT / "sequences" / f"{GIVEN}.yaml", None, {})


@cache
def written() -> Plan:
    """Return the shortest calibration as it is written and compiled again."""
    problem: Calibrations | Any = problem_of(given(), None)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shorter.yaml"
        path.write_text(problem.written(*SHORTEST, "shorter", ["Shorter."]), encoding="utf-8")
        return compile_sequence(path, None, {})
