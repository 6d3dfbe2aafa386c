"""Wrong worlds of a GNC module's calibration: what the models say is not so, in one respect and by a stated size.

Inputs, sensors and noise are written here from their definitions, with the attitude of ``imu_material``; nothing of the
product or its simulators makes them. One world is two sets of positions and turns, a turn in the Earth's field and
seven attitudes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import imu_material as imu
import numpy as np
from doubt_classes import PROVENANCE, Seen, Switch, changed
from scipy import linalg

from bench.analysis import Material, build_results, estimates_of
from bench.model.errors import FitError
from bench.record import RecordRow
from bench.systems.gnc.calibration.analysis import analyse as analyse_calibration
from bench.systems.gnc.magnetometer import analyse as analyse_magnetometer

SYSTEM = "gnc"
FIELD_gauss = 0.45
RATE_Hz, SPIN_s, CONE_s = 200.0, 8.0, 3.0
POSITION_s, TURN_s, MOVING_s, TURN_deg = 3.0, 8.0, 5.0, 1080.0
RATE_deg_s = 370.0
POSE = {"middle": -37.5, "outer": -20.0}  # inner axis along that of the Earth
MAG_NOISE_gauss = 5e-4
HARD_gauss = np.array([0.05, -0.1, 0.2])
IRON = np.array([[1.05, 0.03, -0.02], [0.01, 0.96, 0.04], [-0.03, 0.0, 1.02]])
CONES_deg = (50.0, 20.0, -10.0, -35.0, -60.0, -85.0, 70.0)
FINE, FREE = 1e-9, 1e-3  # step of the output, and part of the noise that is left, in a noise-free world
TRIADS = ("accel_matrix", "accel_bias", "accel_scale_error", "accel_cross_coupling",
          "gyro_matrix", "gyro_bias", "gyro_scale_error", "gyro_cross_coupling")  # fmt: skip
OF_TRIADS, OF_FIELD = 2 * (9 + 3 + 3 + 6), 2 * 4 + 3 + 6  # estimates that are promised
FIELDS = ("mag_offset", "mag_gain", "mag_angle", "mag_hard_iron", "mag_soft_iron")


@dataclass(frozen=True)
class World:
    """The right world; a wrong one changes one of its parts. Positions, turns and fields are counted from 0 each."""

    size: float = 0.0

    def gravity_g(self, pose_g: Any, record: int) -> Any:
        """Specific force (3,) of a position, g, body axes."""
        return pose_g

    def turned_deg(self, turn_deg: float, record: int) -> float:
        """Return by how much the table really turns."""
        return turn_deg

    def accelerometer(self, output_g: Any, force_g: Any, record: int) -> Any:
        """Output (n, 3) without noise."""
        return output_g

    def gyro(self, output_deg_s: Any, rate_deg_s: Any, record: int) -> Any:
        """Output (n, 3) without noise."""
        return output_deg_s

    def field_gauss(self, field_gauss: Any, record: int, rng: np.random.Generator) -> Any:
        """Return the field in body axes, (n, 3); record 0 is the turn."""
        return field_gauss

    def magnetometer(self, output_gauss: Any, record: int) -> Any:
        """Output (n, 3) without noise."""
        return output_gauss

    def read(self, kind: str, output: Any, record: int) -> Any:
        """Readings with noise, (n, 3)."""
        return output


wrong = partial(changed, World)


def tilted(w: World, pose_g: Any, record: int = 0) -> Any:
    return imu.turned(2, w.size) @ pose_g


def table_tilted(w: World, pose_g: Any, record: int) -> Any:
    """The base of the table leans, so that up in the body differs by what its axes turn it into."""
    outer, middle, inner = list(imu.POSES.values())[record % len(imu.POSES)]
    up_g = imu.turned(0, w.size) @ np.array([0.0, 0.0, imu.SITE["gravity_m_s2"] / 9.80665])
    return imu.to_local(outer, middle, inner, "x").T @ up_g


def bumped(w: World, output_g: Any, force_g: Any, record: int) -> Any:
    late = np.arange(len(output_g)) > 0.6 * len(output_g)
    return output_g + w.size * (late * (record == 3))[:, None] * np.array([0.0, 1.0, 0.5])


def scale_changed(w: World, output: Any, _: Any, record: int) -> Any:
    """Between the sets: an impact, or another temperature."""
    return output * (1.0 + w.size * (record >= 6))


def bad_samples(w: World, kind: str, output: Any, record: int) -> Any:
    """One sample of a position and one of a turn, at rest and on the move."""
    odd = output.copy()
    if (kind, record) in (("accel", 2), ("gyro", 4)):
        odd[(500, 1) if kind == "accel" else (900, 0)] += w.size * (1.0 if kind == "accel" else 8.0)
    return odd


def hung(w: World, kind: str, output: Any, record: int) -> Any:
    """An axis holds what it showed in the record before, through some positions."""
    return output * [1.0, 0.0, 1.0] if kind == "accel" and 1 <= record <= w.size else output


def bad_reading(w: World, kind: str, output: Any, record: int) -> Any:
    odd = output.copy()
    odd[300, 0] += w.size if kind == "mag" and record in (0, 3) else 0.0
    return odd


def wandering(w: World, field: Any, record: int, rng: np.random.Generator) -> Any:
    """The field stays off by the same over 700 readings, then by another size."""
    off = np.repeat(rng.normal(0.0, w.size, (1 + len(field) // 700, 3)), 700, axis=0)
    return field + off[: len(field)]


def magnetised(w: World, output: Any, record: int) -> Any:
    """Between the turn and the attitudes."""
    return output + w.size * (record == 0) * np.array([1.0, 0.5, 0.0])


def steel(w: World, field: Any, record: int, rng: np.random.Generator) -> Any:
    """Magnetised along the field as it lies in the unit: an induced field of third order in the direction."""
    unit = field / FIELD_gauss
    return field + w.size * unit * (unit[:, :1] * unit[:, 1:2])


SWITCHES = (
    Switch("gravity_wrong", wrong(gravity_g=lambda w, up, _: up * (1.0 + w.size)), (1e-6, 1e-4, 1e-2), "local_gravity"),
    Switch(
        "table_turns_more", wrong(turned_deg=lambda w, deg, _: deg * (1.0 + w.size)), (1e-6, 1e-4, 1e-2), "table_angle"
    ),
    Switch("mounted_askew", wrong(gravity_g=tilted), (1e-4, 1e-2, 1.0), "mounting"),
    Switch(
        "one_turn_short", wrong(turned_deg=lambda w, deg, n: deg - w.size * (n == 2)), (1e-3, 0.1, 10.0), "table_angle"
    ),
    Switch(
        "one_pose_tilted", wrong(gravity_g=lambda w, up, n: up if n else tilted(w, up)), (1e-4, 2e-2, 2.0), "mounting"
    ),
    Switch("table_tilted", wrong(gravity_g=table_tilted), (1e-4, 1e-2, 0.2), "mounting"),
    Switch(
        "upside_down", wrong(gravity_g=lambda w, up, n: -up if n < w.size else up), (1.0, 2.0, 12.0)
    ),  # the first poses are not what the records say
    Switch("even_order", wrong(accelerometer=lambda w, out, force, _: out + w.size * force**2), (1e-5, 3e-4, 1e-2)),
    Switch("bias_step", wrong(accelerometer=lambda w, out, _, n: out + w.size * (n > 2)), (1e-5, 3e-4, 1e-2)),
    Switch("bumped_at_rest", wrong(accelerometer=bumped), (1e-5, 1e-3, 1e-1)),
    Switch("gyro_asymmetry", wrong(gyro=lambda w, out, rate, _: out + w.size * abs(rate)), (1e-6, 1e-4, 1e-2)),
    Switch("gyro_bias_step", wrong(gyro=lambda w, out, _, n: out + w.size * (n in (1, 2, 5))), (1e-4, 1e-2, 1.0)),
    Switch("scale_changes", wrong(accelerometer=scale_changed, gyro=scale_changed), (1e-5, 3e-4, 1e-2)),
    Switch("bad_samples", wrong(read=bad_samples), (1e-2, 1.0, 30.0)),
    Switch("hung_axis", wrong(read=hung), (1.0, 2.0, 4.0)),
    Switch("bad_reading", wrong(read=bad_reading), (2e-3, 3e-2, 0.7)),
    Switch("field_wanders", wrong(field_gauss=wandering), (1e-5, 1e-4, 1e-3), "magnetic_surroundings"),
    # a tool is put down near the table before the last three attitudes
    Switch(
        "field_steps",
        wrong(field_gauss=lambda w, field, n, _: field + w.size * (n > 4) * field[0] / FIELD_gauss),
        (1e-5, 1e-3, 1e-1),
    ),
    Switch(
        "field_drifts",
        wrong(field_gauss=lambda w, field, n, _: field * (1.0 + w.size * n)),
        (1e-5, 1e-3, 1e-1),
        "magnetic_surroundings",
    ),
    Switch(
        "axis_saturates",
        wrong(magnetometer=lambda w, out, _: out - w.size * out**3 / FIELD_gauss**2),
        (1e-5, 1e-3, 1e-1),
    ),
    Switch("magnetised_between", wrong(magnetometer=magnetised), (1e-6, 1e-3, 1e-1)),
    Switch("steel_on_the_table", wrong(field_gauss=steel), (1e-5, 1e-3, 1e-1), "magnetic_surroundings"),
)


SIGMA = {
    "accel": imu.Unit().vrw_g_rtHz * RATE_Hz**0.5,
    "gyro": imu.Unit().arw_deg_s_rtHz * RATE_Hz**0.5,
    "mag": MAG_NOISE_gauss,
}  # of one sample


@dataclass
class Bench:
    """Makes the records of one campaign; ``stated``: what kind each shows, and its input by the conditions, (n, 3)."""

    rng: np.random.Generator
    world: World
    noisy: bool
    unit: imu.Unit = field(default_factory=imu.Unit)
    rows: list[RecordRow] = field(default_factory=list)
    stated: list[tuple[str, Any]] = field(default_factory=list)
    t_s: float = 100.0

    def number(self, kind: str) -> int:
        """Return how many records of a kind there are."""
        return sum(before == kind for before, _ in self.stated)

    def position(self, up: str, seconds: float) -> None:
        outer, middle, inner = imu.POSES[up]
        number, n = self.number("accel"), round(seconds * RATE_Hz)
        stated = imu.to_local(outer, middle, inner, "x").T @ np.array([0.0, 0.0, imu.SITE["gravity_m_s2"] / 9.80665])
        force = np.tile(self.world.gravity_g(stated, number), (n, 1))
        output = self.world.accelerometer(force @ self.unit.accel_S.T + self.unit.accel_bias_g, force, number)
        about = {"item": "position", "up": up, "mounting": "x"}
        about |= {"outer_deg": outer, "middle_deg": middle, "inner_deg": inner}
        self.add("accel", output, number, np.tile(stated, (n, 1)), about)

    def turn(self, axis: str, turn_deg: float) -> None:
        number, n = self.number("gyro"), round(TURN_s * RATE_Hz)
        true = self.rates(axis, self.world.turned_deg(turn_deg, number), n)
        output = self.world.gyro((true + self.unit.gyro_bias_deg_s) @ self.unit.gyro_S.T, true, number)
        about = {"item": "rotation", "axis": axis, "turn_deg": turn_deg, "turned": "inner", "mounting": axis}
        about |= {"outer_deg": POSE["outer"], "middle_deg": POSE["middle"], "inner_deg": 0.0}
        self.add("gyro", output, number, self.rates(axis, turn_deg, n), about)

    def rates(self, axis: str, turn_deg: float, n: int) -> Any:
        """Return rates in body axes, (n, 3), of whole turns after 1 s of rest."""
        angle = np.interp(np.arange(n + 1) / RATE_Hz, [1.0, 1.0 + MOVING_s], [0.0, turn_deg])
        rates = np.zeros((n, 3))
        rates[:, "xyz".index(axis)] = np.diff(angle) * RATE_Hz
        middle = (angle[1:] + angle[:-1]) / 2.0
        return rates + imu.seen_while_turned(imu.earth_rate(), POSE["outer"], POSE["middle"], middle, axis)

    def magnetic(self, item: str, height_deg: float, seconds: float) -> None:
        """Turn about z with the field at an angle above the plane of the turn."""
        number, n = self.number("mag"), round(seconds * RATE_Hz)
        angle = np.deg2rad(RATE_deg_s * np.arange(n) / RATE_Hz + 40.0 * number)
        flat, height = np.cos(np.deg2rad(height_deg)), np.sin(np.deg2rad(height_deg))
        stated = FIELD_gauss * np.column_stack((flat * np.cos(angle), -flat * np.sin(angle), 0.0 * angle + height))
        seen = self.world.field_gauss(stated, number, self.rng) @ IRON.T + HARD_gauss
        about = {"item": item, "table": "non_magnetic", "rate_deg_s": RATE_deg_s, "mounting": "z"}
        about |= {"outer_deg": 90.0, "middle_deg": height_deg, "inner_deg": 0.0}
        self.add("mag", self.world.magnetometer(seen, number), number, stated, about)

    def add(self, kind: str, output: Any, number: int, stated: Any, about: Mapping[str, Any]) -> None:
        """Add a record of one sensor with noise; the others show nothing but theirs."""
        n, columns, scales = len(output), {"temperature": np.full(len(output), 2500, np.int16)}, dict(imu.SCALES)
        for name, sigma in SIGMA.items():
            clean = output if name == kind else np.zeros((n, 3))
            seen = clean + self.rng.normal(0.0, sigma if self.noisy else FREE * sigma, (n, 3))
            seen = self.world.read(kind, seen, number) if name == kind else seen
            step = imu.SCALES[name][0] if self.noisy else FINE
            scales[name] = (step, *imu.SCALES[name][1:])
            columns[name] = np.rint(seen / step).astype(np.int64)
        columns["tick"] = ((np.arange(n) * 5000 + round(self.t_s * 1e6)) % (1 << 32)).astype(np.uint32)
        t_ns = ((self.t_s + np.arange(n) / RATE_Hz) * 1e9).astype(np.int64)
        row = imu.record_of(len(self.rows) + 1, round(self.t_s * RATE_Hz), t_ns, columns, about, scales)
        self.rows.append(row)
        self.stated.append((kind, stated))
        self.t_s += n / RATE_Hz + 5.0

    def material(self, analysis: str, kinds: tuple[str, ...]) -> Material:
        """What an analysis sees; without noise no step and no range of the output is declared."""
        rows = [row for row, (kind, _) in zip(self.rows, self.stated, strict=True) if kind in kinds]
        campaign = {"analysis": analysis, "uut": {"model": "GNC", "serial": "GNC-07"}, "site": imu.SITE}
        return Material(rows, campaign | ({"imu": imu.IMU} if self.noisy else {}), {})


def recorded(seed: int, world: World, *, noisy: bool = True, magnetic: bool = True) -> Bench:
    """Return the records of one campaign."""
    bench = Bench(np.random.default_rng(seed), world, noisy)
    for _ in range(2):
        for up in imu.POSES:
            bench.position(up, POSITION_s)
        for axis in "xyz":
            for sign in (1.0, -1.0):
                bench.turn(axis, sign * TURN_deg)
    if magnetic:
        bench.magnetic("magnetometer", 0.0, SPIN_s)
        for height_deg in CONES_deg:
            bench.magnetic("attitudes", height_deg, CONE_s)
    return bench


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one campaign states and its truth; without a switch that of the same seed in a right world."""
    bench = recorded(seed, World() if switch is None else switch.world(size), noisy=not noise_free)
    entries: list[Any] = []
    fitted: dict[tuple[Any, ...], Any] = {}
    for analyse, name, kinds, quantities in (
        (analyse_calibration, "imu_calibration", ("accel", "gyro"), TRIADS),
        (analyse_magnetometer, "magnetometer", ("mag",), FIELDS),
    ):
        try:
            analysis = analyse(bench.material(name, kinds))
        except FitError:
            continue  # refused: promised and not there
        fitted |= {place_of(entry): entry.value for entry in analysis.estimates}
        document = build_results("doubt", analysis, {"records": len(bench.rows)}, PROVENANCE)
        entries += [entry for entry in estimates_of(document) if entry.quantity in quantities]
    chi2 = trace(bench, fitted)
    return Seen(entries, [truth(bench.unit, entry) for entry in entries], chi2, OF_TRIADS + OF_FIELD)


def place_of(entry: Any) -> tuple[Any, ...]:
    """Return what tells an estimate from the others."""
    about = entry.conditions
    return entry.quantity, about.get("method"), *(about[name] for name in ("row", "column", "axis") if name in about)


def truth(unit: imu.Unit, entry: Any) -> float:
    """Return the true value of an estimate."""
    quantity, about = entry.quantity, entry.conditions
    found = truths(unit)[quantity]
    if "row" in about:
        return float(found["xyz".index(about["row"]), "xyz".index(about["column"])])
    return float(found["xyz".index(about["axis"])] if "axis" in about else found)


def truths(unit: imu.Unit) -> dict[str, Any]:
    """Return the true values by quantity: of the unit, and of the section z = 0 of the field's ellipsoid."""
    found: dict[str, Any] = {}
    for name, matrix in (("accel", unit.accel_S), ("gyro", unit.gyro_S)):
        found[f"{name}_matrix"] = np.linalg.inv(matrix)
        found[f"{name}_scale_error"] = 1e6 * (np.diag(matrix) - 1.0)
        found[f"{name}_cross_coupling"] = matrix
    found["accel_bias"] = -np.linalg.inv(unit.accel_S) @ unit.accel_bias_g
    found["gyro_bias"] = 3600.0 * unit.gyro_bias_deg_s
    found["mag_hard_iron"] = HARD_gauss
    square = np.linalg.inv(IRON @ IRON.T)
    found["mag_soft_iron"] = linalg.sqrtm(square / np.linalg.det(square) ** (1.0 / 3.0))
    turn = np.linalg.inv(IRON[:2, :2] @ IRON[:2, :2].T)  # x and y of a field in the plane
    found["mag_offset"] = HARD_gauss[:2]
    found["mag_gain"] = np.sqrt(turn[1, 1] / turn[0, 0])
    found["mag_angle"] = np.rad2deg(np.arcsin(-turn[0, 1] / np.sqrt(turn[0, 0] * turn[1, 1])))
    return found


def trace(bench: Bench, values: Mapping[tuple[Any, ...], Any]) -> float:
    """Return the chi-square of what the estimates leave over, in the noise of the right world.

    Of each record: the means of its halves (of positions), the integrals of its rest and of its movement (of turns),
    the size of the corrected field in each of 40 parts, and the sample that is furthest from its neighbours.
    """
    chi2 = 0.0
    for row, (kind, stated) in zip(bench.rows, bench.stated, strict=True):
        left = left_over(kind, row.samples.scaled(kind), stated, values, row.window.conditions["item"])
        if left is None:
            continue
        sigma, parts = SIGMA[kind], 40 if kind == "mag" else 2
        for part in np.array_split(left, parts):
            chi2 += float(np.sum(part.sum(axis=0) ** 2)) / len(part) / sigma**2
        spike = np.abs(left[1:-1] - (left[2:] + left[:-2]) / 2.0).max(axis=0) / sigma / 1.5**0.5
        chi2 += float(np.sum(spike**2)) * (bench.noisy is False)
    return chi2


def left_over(kind: str, output: Any, stated: Any, values: Mapping[tuple[Any, ...], Any], item: str) -> Any:
    """Return what the estimates leave of a record, (n, 1) or (n, 3); None where there are none or they say nothing."""
    try:
        if kind == "mag":
            hard = np.array([values["mag_hard_iron", "ellipsoid", axis] for axis in "xyz"])
            soft = np.array([[values["mag_soft_iron", "ellipsoid", *sorted((a, b), reverse=True)] for b in "xyz"]
                             for a in "xyz"])  # fmt: skip
            size = np.linalg.norm((output - hard) @ soft.T, axis=1)[:, None]
            return size - (size.mean() if item == "magnetometer" else FIELD_gauss * np.linalg.det(IRON) ** (1.0 / 3.0))
        matrix = np.array([[values[f"{kind}_matrix", None, a, b] for b in "xyz"] for a in "xyz"])
        factor, sign = (1.0, 1.0) if kind == "accel" else (3600.0, -1.0)
        bias = np.array([values[f"{kind}_bias", None, axis] for axis in "xyz"]) / factor
    except KeyError:
        return None
    return output @ matrix.T + sign * bias - stated
