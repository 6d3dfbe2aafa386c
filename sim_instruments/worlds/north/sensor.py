"""The simulated fibre-optic gyroscope on its turning table, as functions of bench time.

Whatever is asked, in whatever pieces and order, is the same: the past is what motion and heading were, noise is a
function of the number of the sample. Nothing later than now may be asked for, since somebody may still change it.

A sample is the mean of the output over one millisecond of the bench clock, [n, n + 1) ms, taken at two nodes (Gauss);
that is within 5e-9 of the amplitude at 360 deg/s with a swing of 3 arcmin at 60 Hz (against 100 points).

Earth's rate is turned by matrices, no small angles. Local frame: x East, y North, z Up, right-handed. The frame of the
table follows from it by the tilt of the rotation axis, one turn about a horizontal axis. In the table's plane angles
count counter-clockwise, as seen from above, from the table's own east: a sensing axis of heading H (clockwise from
north) stands at 90 deg - H.

Variations of a parameter, relative to its value, within +-20 %: functions of time, with integrals in closed form.

The integral is what a varying frequency needs: the phase is the integral of the frequency, never frequency times time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.attitude import EARTH_RATE_RAD_S, cross_matrix
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.sensor_noise import WhiteNoise
from sim_instruments.worlds.north.options import FogOptions

SHARE = 0.2
SLOWEST_HZ, FASTEST_HZ = 0.02, 0.1  # of what is called slow


@dataclass(frozen=True)
class Variation:
    """Relative change of a parameter at times in seconds, (n,), and its integral from 0 to each of them, seconds."""

    at: Callable[[Floats], Floats]
    integral_s: Callable[[Floats], Floats]


CONSTANT = Variation(np.zeros_like, np.zeros_like)


def sine(frequency_Hz: float, phase_rad: float) -> Variation:
    """Return 0.2 sin(2 pi f t + phase)."""
    omega = 2.0 * np.pi * frequency_Hz

    def integral_s(t_s: Floats) -> Floats:
        return SHARE / omega * (np.cos(phase_rad) - np.cos(omega * t_s + phase_rad))

    return Variation(lambda t_s: SHARE * np.sin(omega * t_s + phase_rad), integral_s)


def linear(ramp_s: float) -> Variation:
    """Return a triangle: from -20 % to +20 % in ``ramp_s``, back again in as long, and so on."""

    def place(t_s: Floats) -> Floats:
        """Return ramps since the last lowest point, 0 to 2."""
        return np.mod(t_s / ramp_s, 2.0)

    def integral_s(t_s: Floats) -> Floats:
        """Return zero after each ramp."""
        at = place(t_s)
        return SHARE * ramp_s * np.where(at <= 1.0, at * (at - 1.0), (2.0 - at) * (at - 1.0))

    return Variation(lambda t_s: SHARE * (1.0 - 2.0 * np.abs(1.0 - place(t_s))), integral_s)


def drawn_steps(rng: np.random.Generator, count: int, step_s: float) -> Variation:
    """Return a new value each ``step_s``, uniform within +-20 %, from a table of ``count`` that repeats itself."""
    values = rng.uniform(-SHARE, SHARE, count)
    sums = np.concatenate(([0.0], np.cumsum(values)))

    def integral_s(t_s: Floats) -> Floats:
        """Return sum of the steps so far."""
        place = t_s / step_s
        rounds, step = np.divmod(np.floor(place).astype(np.int64), count)
        inside = sums[step] + (place - np.floor(place)) * values[step]
        return np.asarray(step_s * (inside + rounds * sums[-1]))

    return Variation(lambda t_s: values[np.floor(t_s / step_s).astype(np.int64) % count], integral_s)


def drawn_slow(rng: np.random.Generator) -> Variation:
    """Return a sine of 0.02 to 0.1 Hz with a drawn phase."""
    return sine(rng.uniform(SLOWEST_HZ, FASTEST_HZ), rng.uniform(0.0, 2.0 * np.pi))


SAMPLE_NS = 1_000_000
TURN_DEG = 360.0
NOMINAL_DEG_S = 360.0  # the swing has its full size there, and falls with the rate
INDEX_DEG = {"a": 0.0, "b": 270.0}  # where the marks should be
_NODE_NS = (211_325, 788_675)  # (1 -+ 1/sqrt 3)/2 of a millisecond
_TURNS, _SAMPLES = 4096, 2**20  # length of the tables of drawn steps: 1.1 h and 17 min
_BISECTIONS = 20  # of a millisecond: 1 ns


def earth_rate_rad_s(latitude_deg: float) -> Floats:
    """Return Earth's rate in the local frame (East, North, Up), rad/s, (3,)."""
    latitude = np.deg2rad(latitude_deg)
    return EARTH_RATE_RAD_S * np.array([0.0, np.cos(latitude), np.sin(latitude)])


def tilted(east_deg: float, north_deg: float) -> Floats:
    """Return matrix of the turn by the vector (east, north, 0), degrees: columns are table axes in the local frame.

    Source: Rodrigues' formula.
    """
    vector = np.deg2rad([east_deg, north_deg, 0.0])
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    cross = cross_matrix(vector / angle)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def sensed_rad_s(in_table: Floats, angle_rad: Any, axis_tilt_deg: float) -> Floats:
    """Return component of a rate along the sensing axis.

    Args:
        in_table: the rate in the frame of the table, rad/s, (3,).
        angle_rad: where the sensing axis stands in the table's plane, any shape.
        axis_tilt_deg: its elevation above that plane.
    Returns: rad/s, shape of ``angle_rad``: the rate times Rz(angle) (cos tilt, 0, sin tilt).
    """
    east, north, up = in_table
    in_plane = east * np.cos(angle_rad) + north * np.sin(angle_rad)
    tilt = np.deg2rad(axis_tilt_deg)
    return np.cos(tilt) * in_plane + np.sin(tilt) * up


def variation(kind: str, seed: int, parameter: str, ramp_s: float) -> Variation:
    """Return how one parameter varies with bench time; "double" is none of these, it goes with the table's angle."""
    rng = generator(seed, f"fog variation of {parameter}")
    if kind == "slow":
        return drawn_slow(rng)
    if kind == "linear":
        return linear(ramp_s)
    if kind == "step":
        return drawn_steps(rng, _TURNS, 1.0)
    if kind == "white":
        return drawn_steps(rng, _SAMPLES, SAMPLE_NS / NS)
    return CONSTANT


class FogSensor:
    """Gyroscope, table and index marks.

    Args:
        seed: seed of the run.   options: see FogOptions.
        motion: of the table about the vertical axis, without its swing.
        latitude_deg: of the place.
        heading_deg: heading of the sensing axis at encoder zero, at bench times, (n,) to (n,).
    Attributes: placement_deg: of the index marks: a pulse comes where the table's angle is that much larger.
        varies: how the parameters vary, from which bench time on, ns.
    """

    def __init__(
        self,
        seed: int,
        options: FogOptions,
        motion: AxisMotion,
        latitude_deg: float,
        heading_deg: Callable[[Integers], Floats],
    ) -> None:
        self.options = options
        self._motion, self._heading_deg = motion, heading_deg
        earth = earth_rate_rad_s(latitude_deg)
        tilt = tilted(options.rotation_tilt_east_arcmin / 60.0, options.rotation_tilt_arcmin / 60.0)
        self._horizontal_rad_s, self._earth = float(earth[1]), tilt.T @ earth
        self._axis_tilt_deg = options.axis_tilt_arcmin / 60.0
        self._seed, self._variations = seed, dict[tuple[str, str], Variation]()
        self.varies: list[tuple[int, str]] = [(-1, options.parameters)]
        self._double_rad = generator(seed, "fog double").uniform(0.0, 2.0 * np.pi)
        self._noise = WhiteNoise(seed, "fog noise", 2)
        drawn = generator(seed, "fog index marks").standard_normal(2).clip(-2.5, 2.5)
        self.placement_deg = dict(zip("ab", drawn * options.placement_arcmin / 60.0, strict=True))

    @property
    def amplitude_V(self) -> float:
        """True amplitude of the earth signal with its tilts, without variation, volt."""
        share = np.hypot(*self._earth[:2]) / self._horizontal_rad_s * np.cos(np.deg2rad(self._axis_tilt_deg))
        return float(self.options.scale_V * share)

    @property
    def noise_V(self) -> float:
        """Standard deviation of the noise of one sample, volt."""
        return float(np.hypot(self.options.random_walk_V, self.options.vibration_V)) if self.options.noise else 0.0

    # --- the table ---------------------------------------------------------------------------------------------

    def table_deg(self, t_ns: Integers) -> Floats:
        """Return True angle of the table at bench times (n,), not wrapped at a turn; the encoder reads it."""
        t_ns = np.asarray(t_ns, np.int64)
        angle = self._motion.angle_deg(t_ns)
        if self.options.wobble_arcmin == 0.0:
            return angle
        t_s = t_ns / NS
        slipped_s = self._varied("frequency of the swing", t_ns, lambda kind: kind.integral_s)
        phase = 2.0 * np.pi * self.options.wobble_Hz * (t_s + slipped_s)
        share = np.minimum(np.abs(self._motion.rate_deg_s(t_ns)) / NOMINAL_DEG_S, 1.0)
        swing = self.options.wobble_arcmin / 60.0 * (1.0 + self._varied("swing", t_ns, lambda kind: kind.at))
        return angle + share * swing * np.sin(phase)

    def pulses(self, index: str, t0_ns: int, t1_ns: int) -> Integers:
        """Return times of the pulses of mark "a" or "b" in [t0, t1), in order, to 1 ns; one per turn either way."""
        first, last = t0_ns // SAMPLE_NS, -(-t1_ns // SAMPLE_NS)
        edges = np.arange(first, last + 1, dtype=np.int64) * SAMPLE_NS
        mark_deg = INDEX_DEG[index] + self.placement_deg[index]
        turns = np.floor((self.table_deg(edges) - mark_deg) / TURN_DEG)
        cells = np.flatnonzero(np.diff(turns))
        low, high, before = edges[cells], edges[cells + 1], turns[cells]
        for _ in range(_BISECTIONS):
            middle = (low + high) // 2
            passed = np.floor((self.table_deg(middle) - mark_deg) / TURN_DEG) != before
            low, high = np.where(passed, low, middle), np.where(passed, middle, high)
        return high[(high >= t0_ns) & (high < t1_ns)]

    # --- the output --------------------------------------------------------------------------------------------

    def output_V(self, number: Integers) -> Floats:
        """Return output of a supplied gyroscope: means over the milliseconds ``number`` (n,), volt."""
        start_ns = np.asarray(number, np.int64) * SAMPLE_NS
        mean = sum(self._signal(start_ns + node_ns) for node_ns in _NODE_NS) / len(_NODE_NS)
        if self.options.table_rate and self._axis_tilt_deg:
            turned_rad = np.deg2rad(self.table_deg(start_ns + SAMPLE_NS) - self.table_deg(start_ns))
            along_rad_s = turned_rad / (SAMPLE_NS / NS) * np.sin(np.deg2rad(self._axis_tilt_deg))
            mean = mean + along_rad_s / self._horizontal_rad_s
        volts = self.options.scale_V * self._gain_at(start_ns + SAMPLE_NS // 2) * mean
        if self.options.noise:
            volts = volts + self._noise.at(number) @ np.array([self.options.random_walk_V, self.options.vibration_V])
        return volts

    def _gain_at(self, t_ns: Integers) -> Floats:
        if self.options.parameters == "double":
            double = 2.0 * np.deg2rad(self.table_deg(t_ns)) + self._double_rad
            return 1.0 + 0.2 * np.sin(double)
        return 1.0 + self._varied("amplitude", t_ns, lambda kind: kind.at)

    def _varied(
        self, parameter: str, t_ns: Integers, value: Callable[[Variation], Callable[[Floats], Floats]]
    ) -> Floats:
        """Return a value of the variation of a parameter, each time by the kind that held then, (n,)."""
        since_ns = np.array([since for since, _ in self.varies])
        which = np.searchsorted(since_ns, t_ns, side="right") - 1
        varied = np.zeros(np.shape(t_ns))
        for place in np.unique(which).tolist():
            kind, now = self.varies[max(place, 0)][1], which == place
            if (kind, parameter) not in self._variations:
                self._variations[kind, parameter] = variation(kind, self._seed, parameter, self.options.ramp_s)
            varied[now] = value(self._variations[kind, parameter])(t_ns[now] / NS)
        return varied

    def _signal(self, t_ns: Integers) -> Floats:
        """Return Earth signal of unit amplitude and its harmonics."""
        angle_rad = np.deg2rad(90.0 - self._heading_deg(t_ns) + self.table_deg(t_ns))
        signal = sensed_rad_s(self._earth, angle_rad, self._axis_tilt_deg) / self._horizontal_rad_s
        for order, size in self.options.harmonics.items():
            signal = signal + size * np.sin(order * angle_rad)
        return signal
