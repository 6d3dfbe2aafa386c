"""Records and readings of a north finder for tests of its analysis: the Earth's rate turned by matrices, white noise.

Nothing here comes from bench.systems or sim_instruments. East, north, up.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Material, Reading
from bench.maths.verdict import coverage_factor
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow, Samples
from bench.systems.north.estimators.formulas import literal_north, propagated, quadrant_north
from bench.systems.north.estimators.likelihood import likelihood_north
from bench.systems.north.estimators.phasors import (
    North,
    eight_sample_north,
    half_width_deg,
    lock_in_phasors,
    wrapped_deg,
)
from bench.systems.north.sets import NorthSet
from bench.systems.north.solution import Site, Solution
from bench.systems.north.solve import solve

FS_Hz, RECORD_s = 1000.0, 5.0
LATITUDE_DEG, AZIMUTH_DEG = 37.0, 20.0
SCALES = {
    "output": (1e-6, 0.0, "V"), "encoder": (360.0 / 2**24, 0.0, "deg"), "temperature": (0.01, 0.0, "degC")
}  # fmt: skip


@dataclass(frozen=True)
class Gyro:
    """A FOG of 1 V at this latitude and what is wrong with it and with its table; noise in V per sample."""

    noise_V: float = 0.0
    offset_V: float = 0.3
    placement_deg: tuple[float, float] = (0.0, 0.0)  # of index A and B
    gains: tuple[float, float] = (1.0, 1.0)  # of lock-in 1 and 2
    lock_in_offset_V: tuple[float, float] = (0.0, 0.0)
    tilt_mrad: tuple[float, float] = (0.0, 0.0)  # about the sensing axis at encoder zero and 90 degrees clockwise of it
    harmonics: Mapping[int, float] = field(default_factory=dict)  # of the table angle, V
    swing_deg: float = 0.0  # of the table, 60 times a turn: its phase at the index is another one after each start


def about(axis: Any, angle_rad: float) -> Any:
    """Right-handed rotation matrix about a unit vector (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle_rad) * cross + (1.0 - np.cos(angle_rad)) * cross @ cross


def level_vector(heading_deg: float) -> Any:
    """Unit vector of a heading in the level plane."""
    return np.array([np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg)), 0.0])


def signal_V(gyro: Gyro, heading_deg: float, theta_deg: Any) -> Any:
    """1 V times the Earth's rate along the sensing axis over its horizontal part, plus harmonics and offset."""
    latitude = np.deg2rad(LATITUDE_DEG)
    earth = np.array([0.0, 1.0, np.tan(latitude)])
    x, y = (1e-3 * one for one in gyro.tilt_mrad)
    turn = x * level_vector(heading_deg) + y * level_vector(heading_deg + 90.0)
    size = float(np.linalg.norm(turn))
    platform = about(turn / size, size) if size else np.eye(3)
    start, side = platform @ level_vector(heading_deg), platform @ level_vector(heading_deg - 90.0)
    theta = np.deg2rad(theta_deg)  # counter-clockwise: towards the heading 90 degrees less
    u_V = np.cos(theta) * (earth @ start) + np.sin(theta) * (earth @ side) + gyro.offset_V
    for order, amplitude_V in gyro.harmonics.items():
        u_V = u_V + amplitude_V * np.sin(order * theta)
    return u_V


class NorthRig:
    """Makes sets one after the other; ``t_s`` is the bench clock."""

    def __init__(self, seed: int, gyro: Gyro | None = None) -> None:
        self.rng, self.gyro, self.t_s = np.random.default_rng(seed), gyro or Gyro(), 100.0
        self.rows: list[RecordRow] = []
        self.readings: list[Reading] = []

    def level(self, **conditions: Any) -> None:
        """A reading of the level."""
        x, y = self.gyro.tilt_mrad
        self._read("level", {"x_mrad": x, "y_mrad": y, "temperature_degC": 24.0}, conditions)

    def set(
        self, item: str, heading_deg: float, *, head_deg: float = 0.0, repeat: int = 1, rate_deg_s: float = 360.0,
        place: str = "mark", **wrong: Any,
    ) -> None:  # fmt: skip
        """Four records with eight readings; ``wrong`` is put into the first reading of lock-in 1."""
        for index in range(1, 5):
            conditions = {
                "item": item, "head_deg": head_deg, "repeat": repeat, "index": index, "place": place,
                "rate_deg_s": rate_deg_s,
            }  # fmt: skip
            n = round(FS_Hz * RECORD_s)
            theta_deg = rate_deg_s * (np.arange(n) + 0.5) / FS_Hz + 90.0 * self.rng.integers(4)
            theta_deg = theta_deg + self.gyro.swing_deg * np.sin(60.0 * np.deg2rad(theta_deg) + 1.0)
            u_V = signal_V(self.gyro, heading_deg, theta_deg) + self.rng.normal(0.0, self.gyro.noise_V, n)
            self._row(conditions, u_V, theta_deg)
            for number, value in zip((1, 2), self._lock_ins(u_V, theta_deg, rate_deg_s, index), strict=True):
                flags = wrong if (number, index) == (1, 1) else {}
                read = {"x_V": value, "y_V": 0.0, "frequency_Hz": abs(rate_deg_s) / 360.0, "overload": False,
                        "unlocked": False}  # fmt: skip
                loops = {key: conditions[key] for key in ("item", "head_deg", "repeat", "index")}
                self._read(f"lock_in_{number}", read | flags, loops)

    def _lock_ins(self, u_V: Any, theta_deg: Any, rate_deg_s: float, index: int) -> tuple[float, float]:
        """X of both, volt RMS: reference sines that begin where pulse A (at 0) and B (at 270 degrees) come."""
        sense = np.sign(rate_deg_s)
        found = []
        for number, pulse_deg in ((0, 270.0 + self.gyro.placement_deg[1]), (1, self.gyro.placement_deg[0])):
            reference = np.deg2rad(sense * (theta_deg - pulse_deg) - 90.0 * (index - 1))
            x_V = np.sqrt(2.0) * float(np.mean(u_V * np.sin(reference)))
            found.append(self.gyro.gains[number] * x_V + self.gyro.lock_in_offset_V[number])
        return found[0], found[1]

    def _read(self, role: str, value: Any, conditions: Mapping[str, Any]) -> None:
        self.readings.append(Reading(self.t_s, len(self.readings) + 1, role, "measure", value, dict(conditions)))

    def _row(self, conditions: Mapping[str, Any], u_V: Any, theta_deg: Any) -> None:
        self.rows.append(record_row(self.t_s, self.rows, u_V, theta_deg, dict(conditions), FS_Hz))
        self.t_s += len(u_V) / FS_Hz + 0.01

    def material(self, **more: Any) -> Material:
        """What the analysis sees."""
        campaign = {
            "analysis": "fog_north", "uut": {"model": "FOG", "serial": "FOG-1"},
            "site": {"latitude_deg": LATITUDE_DEG, "azimuth_deg": AZIMUTH_DEG, "gravity_m_s2": 9.799},
        }  # fmt: skip
        return Material(rows=self.rows, campaign=campaign | more, standards={}, readings=self.readings)


def campaign(rig: NorthRig, heads: tuple[float, ...] = (0.0, 45.0, 90.0, 180.0, 270.0), repeats: int = 2,
             rate_deg_s: float = 360.0, field_deg: float = 213.4) -> NorthRig:  # fmt: skip
    """Calibration at the mark, known heads, an unknown place."""
    rig.level(item="calibration", head_deg=0.0)
    for repeat in range(1, repeats + 1):
        rig.set("calibration", AZIMUTH_DEG, repeat=repeat, rate_deg_s=rate_deg_s)
    for head_deg in heads:
        rig.level(item="test", head_deg=head_deg)
        for repeat in range(1, repeats + 1):
            rig.set("test", AZIMUTH_DEG + head_deg, head_deg=head_deg, repeat=repeat, rate_deg_s=rate_deg_s)
    rig.level(item="search", head_deg=0.0)
    for repeat in range(1, repeats + 1):
        rig.set("search", field_deg, repeat=repeat, rate_deg_s=rate_deg_s, place="field")
    return rig


def record_row(
    t_s: float, before: list[RecordRow], u_V: Any, theta_deg: Any, conditions: dict[str, Any], fs_Hz: float
) -> RecordRow:
    """One record of volt against degrees, as the analysis sees it."""
    n = len(u_V)
    columns = {
        "output": np.rint(1e6 * u_V).astype(np.int64),
        "encoder": (np.rint(theta_deg / 360.0 * 2**24).astype(np.int64) % 2**24).astype(np.uint32),
        "temperature": np.full(n, 2500, np.int16),
    }
    t_ns = ((t_s + np.arange(n) / fs_Hz) * 1e9).astype(np.int64)
    counter = np.arange(n, dtype=np.int64) + round(t_s * fs_Hz)
    end_ns = int(t_ns[0]) + round(1e9 * n / fs_Hz)  # of the last sample, not its middle
    window = RecordWindow(len(before) + 1, "fog", int(counter[0]), n, int(t_ns[0]), end_ns, dict(conditions))
    return RecordRow(window, {}, n, 0, 0, Quality.GOOD, samples=Samples(columns, counter, t_ns, SCALES))


SIGMA_V = 0.5**0.5
TURNS = 20
KINDS = ("constant", "slow", "step", "linear", "white", "double")
OF_FITS = ("phi_deg", "std_deg", "white_std_deg", "bound_deg", "whiteness", "widened", "dof", "samples", "dropped")
half_widths_deg = np.vectorize(half_width_deg)


def single_north(u1: np.ndarray, u2: np.ndarray, f2_deg: float = 0.0) -> North:
    """Phase by (17) with atan2: lock-in 1 alone, as a scheme with one lock-in has it.

    Args:    u1, u2: oriented samples, (..., 4); lock-in 2 only for the noise.   f2_deg: placement of its index pulse.
    Returns: North.
    Source:  FOG paper (002) equation (17).
    """
    phasor = np.asarray(lock_in_phasors(u1, u2)[0] * np.exp(-1j * np.deg2rad(f2_deg)))
    noise, std_deg = propagated(lambda a, b: lock_in_phasors(a, b)[0], u1, u2)
    return North(phasor, std_deg, noise)


def likelihoods(u_V: np.ndarray, theta_deg: np.ndarray, **about: Any) -> Any:
    """Attributes of the fits of raw samples (r, n) against one encoder, (r,) each."""
    fits = [likelihood_north(one, theta_deg, **about) for one in u_V]
    return SimpleNamespace(**{name: np.array([getattr(fit, name) for fit in fits]) for name in OF_FITS})


def wander(kind: str, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Relative change of a parameter over the run, within 20 %."""
    if kind == "slow":
        return 0.2 * np.sin(2 * np.pi * (rng.uniform(0.02, 0.1) * t + rng.uniform()))
    if kind == "step":
        return rng.uniform(-0.2, 0.2, TURNS)[np.floor(t).astype(int)]
    if kind == "linear":
        return -0.2 + 0.4 * t / TURNS
    if kind == "white":
        return rng.uniform(-0.2, 0.2, t.size)
    if kind == "double":
        return 0.2 * np.sin(2 * np.pi * (2 * t + rng.uniform()))
    return np.zeros(t.size)


def turned(kind: str, fs: int, rng: np.random.Generator) -> np.ndarray:
    """Encoder angle in radian, (n,): steady rotation, its swing of 0.05 degrees at 60 Hz, the index of each window."""
    t = mid_samples_s(fs)
    swing, frequency = (wander(kind if kind != "double" else "constant", t, rng) for _ in range(2))
    phase = 2 * np.pi * np.cumsum(60.0 * (1.0 + frequency)) / fs
    index = np.repeat(np.arange(4), t.size // 4) * np.pi / 2
    return 2 * np.pi * t + np.deg2rad(0.05) * (1.0 + swing) * np.sin(phase) + index


@cache
def mid_samples_s(fs: int) -> np.ndarray:
    return (np.arange(TURNS * fs) + 0.5) / fs


@cache
def square_references(fs: int) -> tuple[np.ndarray, np.ndarray]:
    t = mid_samples_s(fs)
    return np.sign(np.cos(2 * np.pi * t)), np.sign(np.sin(2 * np.pi * t))


def lock_ins(u: np.ndarray, fs: int) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (..., 4) of lock-in 1 and 2 against a square reference."""
    first, second = ((u * one).reshape(*u.shape[:-1], 4, -1).mean(-1) for one in square_references(fs))
    return first, second


def runs(
    kind: str, count: int, *, fs: int = 1000, noise: float = SIGMA_V, seed: int = 0
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """True phase (r,), raw samples (r, n) and encoder angle (n,) in degrees; azimuths spread evenly over the circle."""
    rng = np.random.default_rng(seed)
    phi_deg = -180.0 + 360.0 * np.arange(count) / count
    for some in np.array_split(phi_deg, -(-count // 50) if kind == "constant" else count):
        theta, gain = turned(kind, fs, rng), 1.0 + wander(kind, mid_samples_s(fs), rng)
        angle = np.deg2rad(some)[:, None]
        signal = gain * (np.cos(angle) * np.sin(theta) + np.sin(angle) * np.cos(theta))
        yield some, signal + noise * rng.standard_normal(signal.shape), np.rad2deg(theta)


def errors_deg(
    kind: str, count: int, *, fs: int = 1000, noise: float = SIGMA_V, seed: int = 0
) -> dict[str, np.ndarray]:
    """Errors of every method, never modulo 180 but in "literal, half turns removed"."""
    found: dict[str, list[np.ndarray]] = {}
    for phi_deg, u, theta_deg in runs(kind, count, fs=fs, noise=noise, seed=seed):
        eight = lock_ins(u, fs)
        each = {
            "literal": literal_north(*eight)[0],
            "quadrant": quadrant_north(*eight).phi_deg,
            "single": single_north(*eight).phi_deg,
            "least_squares": eight_sample_north(*eight).phi_deg,
            "likelihood": likelihoods(u, theta_deg).phi_deg,
        }
        for name, one in each.items():
            found.setdefault(name, []).append(wrapped_deg(one - phi_deg))
    errors = {name: np.concatenate(some) for name, some in found.items()}
    return errors | {"literal, half turns removed": wrapped_deg(2 * errors["literal"]) / 2}


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def table(count: int, fs: int, seed: int, say: Callable[[str], None]) -> dict[str, dict[str, float]]:
    """RMS error in degrees of every method and kind of parameters."""
    found = {
        kind: {name: rms(one) for name, one in errors_deg(kind, count, fs=fs, seed=seed).items()} for kind in KINDS
    }
    for kind, row in found.items():
        say(f"{kind}: " + ", ".join(f"{name} {value:.3f}" for name, value in row.items()))
    return found


COVERAGE_FS_Hz, MARK_deg = 40, 20.0
Float = NDArray[np.float64]
Plan = dict[str, tuple[float, ...]]  # heads of each item, one for each set
METHODS = ("least_squares", "likelihood", "quadrant", "literal")
TIMES_S = np.arange(0.5 / COVERAGE_FS_Hz, TURNS, 1.0 / COVERAGE_FS_Hz)
RECORDS = np.repeat(np.arange(4), TURNS * COVERAGE_FS_Hz // 4)


def campaigns(kind: str, count: int, noise: float, plan: Plan, seed: int) -> Iterator[tuple[Solution, Float]]:
    """Yield solutions with the true heading of each set."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        field_deg = rng.uniform(-180.0, 180.0)
        sets, true_deg = [], []
        for item, heads in plan.items():
            for repeat, head_deg in enumerate(heads, 1):
                heading_deg = field_deg if item == "search" else MARK_deg + head_deg
                place = "field" if item == "search" else "mark"
                u_V, theta_deg = waveform_of(kind, heading_deg, noise, rng)
                u1, u2 = eight_of(u_V)
                t_s = float(len(sets))
                own = NorthSet(item, place, head_deg, repeat, 360.0, u1, u2, begin_s=t_s, end_s=t_s)
                own.rows = rows_of(u_V, theta_deg)
                sets.append(own)
                true_deg.append(heading_deg)
        yield solve(sets, Site(37.0, MARK_deg)), np.array(true_deg)


def waveform_of(kind: str, heading_deg: float, noise: float, rng: np.random.Generator) -> tuple[Float, Float]:
    """Output in volt and table angle in degrees of the four records of a set, one behind the other."""
    gain = 1.0 + wander(kind, TIMES_S, rng)
    theta = 2 * np.pi * TIMES_S + np.pi / 2 * RECORDS
    u_V = gain * np.cos(np.deg2rad(heading_deg) - theta) + noise * rng.standard_normal(TIMES_S.size)
    return u_V, np.rad2deg(theta)


def eight_of(u_V: Float) -> tuple[Float, Float]:
    """Eight samples (4,) of lock-in 1 and 2: references are sines, no index pulse is misplaced."""
    at = 2 * np.pi * TIMES_S
    means = [np.array([2.0 * np.mean((u_V * one)[k == RECORDS]) for k in range(4)]) for one in (np.cos(at), np.sin(at))]
    return means[0], means[1]


def rows_of(u_V: Float, theta_deg: Float) -> dict[int, RecordRow]:
    """The same as records by index position."""
    return {
        k + 1: record_row(0.0, [], u_V[k == RECORDS], theta_deg[k == RECORDS], {}, COVERAGE_FS_Hz) for k in range(4)
    }


def covered(kind: str, count: int, noise: float, plan: Plan, seed: int) -> tuple[dict[str, int], dict[str, float]]:
    """Return how many intervals hold the true heading and their median half-width, degrees, by method.

    One interval of each campaign: that of its last heading.
    """
    hits, widths = {}, {}
    for method in METHODS:
        hits[method], widths[method] = 0, []
    for solution, true_deg in campaigns(kind, count, noise, plan, seed):
        for method in METHODS:
            mean = solution.means(method)[-1]
            width_deg = coverage_factor(mean.dof) * mean.std_deg
            widths[method].append(width_deg)
            hits[method] += int(abs(wrapped_deg(mean.azimuth_deg - true_deg[-1])) <= width_deg)
    half = {method: float(np.median(each)) for method, each in widths.items()}
    print(
        f"{kind}, {noise:.3g} V, {count} campaigns: "
        + ", ".join(f"{method} {hits[method]} within {half[method]:.3g} deg" for method in METHODS)
    )
    return hits, half
