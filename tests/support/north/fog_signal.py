"""The earth signal of a turning gyroscope and the outputs of two lock-ins, simulated directly: no bench, no clock.

    U(t) = k w . s(t) + noise,   s turns with theta(t) = 360 f0 t - delta + theta0 sin(phase of the swing)

w is Earth's rate, s the sensing axis; k is such that the amplitude is ``ke_V`` with all tilts zero. Level, and with the
heading H0 of the axis at t = 0, that is ke sin(theta + phi_e), phi_e = 90 deg - H0. Many runs at once: leading axis.

Source: FOG paper (digital north finding), equations (1) to (14); its (7) replaced by the projection, and the phase of a
swing of varying frequency is the integral of the frequency.
"""

import importlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pyvisa
from numpy.typing import NDArray
from pyvisa.resources import MessageBasedResource

from bench.model.clock import VirtualClock
from sim_instruments.synchronous_detection import SAMPLE_NS, LockIn
from sim_instruments.worlds.north.sensor import (
    Constant,
    Linear,
    Sine,
    Variation,
    drawn_slow,
    drawn_steps,
    earth_rate_rad_s,
    sensed_rad_s,
    tilted,
)
from sim_instruments.worlds.simulation import open_world

Float = NDArray[np.float64]

POSITIONS_DEG = (0.0, 90.0, 180.0, 270.0)  # of the index
_AT_ONCE = 64  # runs simulated together: 10 MB for 20 s at 1 kHz


@dataclass(frozen=True)
class FogParameters:
    """One gyroscope on one table; the defaults are the paper's.

    Attributes:
        ke_V: amplitude of the earth signal.   f0_Hz: turns per second.   phi_e_deg: its phase, one or (runs,).
        wobble_deg, wobble_Hz: swing about the uniform rotation.   load_angle_deg: delta.
        random_walk_V, vibration_V: standard deviation of the noise of one sample, whatever the sampling rate is.
        variation: "constant", "slow" (sine of 0.02 to 0.1 Hz), "step" (new each turn), "linear" (-20 to +20 % over the
            run), "white" (new each sample): ke, wobble_deg and wobble_Hz, each of its own, within 20 %;
            "double": ke only, by a sine at 2 f0.
        harmonics: relative amplitudes by order; they go with the phase of the signal, as a distortion does.
        axis_tilt_deg: sensing axis up out of the table's plane.   table_rate: whether it then feels the table turn.
        rotation_tilt_east_deg, rotation_tilt_north_deg: tilt of the rotation axis about these, right-handed.
    """

    ke_V: float = 1.0
    f0_Hz: float = 1.0
    phi_e_deg: float | Float = 0.0
    wobble_deg: float = 0.05
    wobble_Hz: float = 60.0
    random_walk_V: float = 0.5
    vibration_V: float = 0.5
    variation: str = "constant"
    harmonics: Mapping[int, float] = field(default_factory=dict)
    axis_tilt_deg: float = 0.0
    table_rate: bool = False
    rotation_tilt_east_deg: float = 0.0
    rotation_tilt_north_deg: float = 0.0
    load_angle_deg: float = 0.0
    latitude_deg: float = 37.0

    @property
    def sigma_V(self) -> float:
        """Standard deviation of all noise of one sample, volt."""
        return float(np.hypot(self.random_walk_V, self.vibration_V))


def mid_samples_s(fs_Hz: float, seconds: float) -> Float:
    """Mid-sample grid, (n + 1/2)/fs: no sample falls on an edge of a square reference if fs/f0 is a multiple of 4."""
    return np.asarray((np.arange(round(fs_Hz * seconds)) + 0.5) / fs_Hz)


def earth_signal(
    parameters: FogParameters, t_s: Float, rng: np.random.Generator, index_deg: float | Float = 0.0
) -> tuple[Float, Float]:
    """Samples of the earth signal with its noise.

    Args:
        parameters: with one phi_e, or (runs,).
        t_s: times of the samples, equally spaced, (n,).
        rng: of noise and of what varies; each run draws its own.
        index_deg: how far the table stands ahead, one or (n,): the position of the index.
    Returns: U in volt and the table's true angle in degrees, not wrapped, index included; (n,) or (runs, n).
    Raises: ValueError, a variation that does not exist.
    """
    phi_e_deg = np.asarray(parameters.phi_e_deg, float)[..., None]
    shape = (*phi_e_deg.shape[:-1], len(t_s))
    gain, swing, frequency = (_variation(parameters, t_s, rng, shape) for _ in range(3))
    if parameters.variation == "double":
        swing = frequency = Constant()
    alpha = 2.0 * np.pi * parameters.wobble_Hz
    phase = alpha * (t_s + frequency.integral_s(t_s))
    wobble_deg = parameters.wobble_deg * (1.0 + swing.at(t_s))
    theta_deg = 360.0 * parameters.f0_Hz * t_s - parameters.load_angle_deg + wobble_deg * np.sin(phase) + index_deg
    signal = _unit_signal(parameters, theta_deg, phi_e_deg)
    if parameters.table_rate and parameters.axis_tilt_deg:
        swing_deg_s = wobble_deg * alpha * (1.0 + frequency.at(t_s)) * np.cos(phase)
        signal = signal + _felt_of_table(parameters, 360.0 * parameters.f0_Hz + swing_deg_s)
    u_V = np.asarray(parameters.ke_V * (1.0 + gain.at(t_s)) * signal)
    for sigma_V in (parameters.random_walk_V, parameters.vibration_V):
        if sigma_V:
            u_V += sigma_V * rng.standard_normal(shape)
    return u_V, np.broadcast_to(theta_deg, shape)


def eight_records(
    parameters: FogParameters, fs_Hz: float, tau_s: float, rng: np.random.Generator
) -> tuple[Float, Float, Float]:
    """Four windows of ``tau_s`` one behind the other, the index stepped by 90 degrees before each.

    Returns: U (..., 4, n) in volt; true angle (..., 4, n) and angle of a reference that follows the once-per-turn pulse
        (4, n), degrees: U = ke sin(angle + phi_e), the reference counts from the index as it stands in its window.
    """
    t_s = mid_samples_s(fs_Hz, 4.0 * tau_s)
    each = len(t_s) // 4
    index_deg = np.repeat(POSITIONS_DEG, each)
    u_V, theta_deg = earth_signal(parameters, t_s[: 4 * each], rng, index_deg)
    windows = (*u_V.shape[:-1], 4, each)
    reference_deg = 360.0 * parameters.f0_Hz * t_s[: 4 * each] - parameters.load_angle_deg
    return u_V.reshape(windows), theta_deg.reshape(windows), reference_deg.reshape(4, each)


def lock_in_averages(
    u_V: Float, theta_deg: Float, fs_Hz: float, tau_s: float, reference: str = "square"
) -> tuple[Float, Float]:
    """Outputs of both lock-ins, equation (11): mean of U times a reference of amplitude 1 over ``tau_s``.

    Args:
        u_V: (..., n), the first ``tau_s`` of it are used.   theta_deg: angle the references follow, (n,) or (..., n);
            lock-in 2 takes its sine, lock-in 1 its cosine, 90 degrees ahead.
        reference: "square" as in the paper, 2/pi ke sin(phi_e) and 2/pi ke cos(phi_e); "sine": 1/2 instead of 2/pi.
    Returns: U_LA1, U_LA2, volt, (...).
    Raises: ValueError, another reference.
    """
    n = round(fs_Hz * tau_s)
    angle = np.deg2rad(np.asarray(theta_deg)[..., :n])
    sine, cosine = np.sin(angle), np.cos(angle)
    if reference == "square":
        sine, cosine = np.sign(sine), np.sign(cosine)
    elif reference != "sine":
        raise ValueError(f"reference {reference!r} is neither square nor sine")
    first, second = (np.einsum("...n,...n->...", u_V[..., :n], one) / n for one in (cosine, sine))
    return first, second


def eight_samples(
    parameters: FogParameters, fs_Hz: float, tau_s: float, rng: np.random.Generator, reference: str = "square"
) -> tuple[Float, Float]:
    """The eight samples (13a-d), (14a-d): u1 (..., 4) of lock-in 1, u2 (..., 4) of lock-in 2, volt."""
    found = [
        lock_in_averages(u_V, reference_deg, fs_Hz, tau_s, reference)
        for u_V, _, reference_deg in (eight_records(some, fs_Hz, tau_s, rng) for some in in_parts(parameters))
    ]
    u1, u2 = (np.concatenate([np.atleast_2d(one[which]) for one in found]) for which in (0, 1))
    single = np.ndim(parameters.phi_e_deg) == 0
    return (u1[0], u2[0]) if single else (u1, u2)


def in_parts(parameters: FogParameters, most: int = _AT_ONCE) -> Iterator[FogParameters]:
    """The same with fewer runs at once, so that memory does not grow with them."""
    phi_e_deg = np.asarray(parameters.phi_e_deg, float)
    if phi_e_deg.ndim == 0:
        yield parameters
        return
    for first in range(0, len(phi_e_deg), most):
        yield replace(parameters, phi_e_deg=phi_e_deg[first : first + most])


def _unit_signal(parameters: FogParameters, theta_deg: Float, phi_e_deg: Float) -> Float:
    """The signal without noise and variation, relative to its amplitude with all tilts zero."""
    earth = earth_rate_rad_s(parameters.latitude_deg)
    in_table = tilted(parameters.rotation_tilt_east_deg, parameters.rotation_tilt_north_deg).T @ earth
    angle_rad = np.deg2rad(theta_deg + phi_e_deg)
    found = sensed_rad_s(in_table, angle_rad, parameters.axis_tilt_deg) / earth[1]
    for order, size in parameters.harmonics.items():
        found = found + size * np.sin(order * angle_rad)
    return np.asarray(found)


def _felt_of_table(parameters: FogParameters, rate_deg_s: Float) -> Float:
    """What a tilted sensing axis feels of the table's own rate, relative to the amplitude of the earth signal."""
    horizontal_rad_s = earth_rate_rad_s(parameters.latitude_deg)[1]
    return np.asarray(np.deg2rad(rate_deg_s) * np.sin(np.deg2rad(parameters.axis_tilt_deg)) / horizontal_rad_s)


def _variation(parameters: FogParameters, t_s: Float, rng: np.random.Generator, shape: tuple[int, ...]) -> Variation:
    kind, runs, step_s = parameters.variation, shape[:-1], float(t_s[1] - t_s[0])
    end_s = float(t_s[-1]) + step_s / 2.0
    if kind == "slow":
        return drawn_slow(rng, (*runs, 1))
    if kind == "step":
        return drawn_steps(rng, (*runs, int(np.ceil(end_s * parameters.f0_Hz))), 1.0 / parameters.f0_Hz)
    if kind == "linear":
        return Linear(end_s)
    if kind == "white":
        return drawn_steps(rng, shape, step_s)
    if kind == "double":
        return Sine(2.0 * parameters.f0_Hz, rng.uniform(0.0, 2.0 * np.pi, (*runs, 1)))
    if kind != "constant":
        raise ValueError(f"variation {kind!r} does not exist")
    return Constant()


MS = SAMPLE_NS
Signal = Callable[[NDArray[np.float64]], NDArray[np.float64]]


class Turning:
    """A table at ``rate_Hz`` from 0 s on; pulse "a" where its angle is 0, "b" a quarter of a turn earlier.

    ``stops_s``: no pulses from then on.   ``signal``: volt of the angle in turns.   ``noise_V``: white, per sample.
    """

    def __init__(self, signal: Signal, rate_Hz: float = 1.0, noise_V: float = 0.0, stops_s: float = 1e9) -> None:
        self.signal, self.rate_Hz, self.noise_V, self.stops_s = signal, rate_Hz, noise_V, stops_s
        self.asked: list[tuple[int, int]] = []

    def waveform(self, first: int, last: int) -> NDArray[np.float64]:
        """Volt of samples [first, last)."""
        self.asked.append((first, last))
        found = self.signal((np.arange(first, last) + 0.5) * 1e-3 * self.rate_Hz)
        if not self.noise_V:
            return found
        noise = [np.random.default_rng([7, second]).normal(0.0, 1.0, 1000) for second in self._seconds(first, last)]
        start = first - first // 1000 * 1000
        return found + self.noise_V * np.concatenate(noise)[start : start + last - first]

    @staticmethod
    def _seconds(first: int, last: int) -> range:
        return range(first // 1000, (last - 1) // 1000 + 1)

    def pulses(self, index: str, t0_ns: int, t1_ns: int) -> NDArray[np.int64]:
        """Nanoseconds of the pulses in [t0, t1)."""
        period_ns = 1e9 / self.rate_Hz
        shift = 0.0 if index == "a" else 0.75
        turns = np.arange(max(0, int(t0_ns / period_ns - 2)), int(t1_ns / period_ns + 2))
        times_ns = np.round((turns + shift) * period_ns).astype(np.int64)
        inside = (times_ns >= t0_ns) & (times_ns < t1_ns) & (times_ns < self.stops_s * 1e9)
        return times_ns[inside]


def amplifier(world: Turning, index: str = "a", **settings: Any) -> LockIn:
    """A lock-in amplifier on that world, its reference one of the pulses."""
    made = LockIn(world.waveform, lambda t0_ns, t1_ns: world.pulses(index, t0_ns, t1_ns))
    made.change(**settings)
    return made


def trace(made: LockIn, last: int) -> NDArray[np.float64]:
    """X and Y behind the filters, (2, n), of each sample from the first one not yet processed to ``last``."""
    found = made._process(made._done, last)
    made._done = last
    return found


class NorthBench:
    """Two lock-in amplifiers, one behind the filter; the table turns at 1 Hz from the beginning."""

    def __init__(self, table: Turning, **options: Any) -> None:
        self.clock = VirtualClock()
        self.on_line: Callable[..., None] = lambda *_: None
        entries = {
            "direct": {"driver": "srs_sr830", "resource": "GPIB0::8::INSTR", "options": {"input": "fog"} | options},
            "filtered": {
                "driver": "srs_sr830", "resource": "GPIB0::9::INSTR",
                "options": {"input": "filter", "reference": "index_b"} | options,
            },
            "filter": {"driver": "krohn_hite_3988", "resource": "GPIB0::10::INSTR", "options": {}},
            "level": {"driver": "leica_nivel_220", "resource": "ASRL3::INSTR", "options": {}},
        }  # fmt: skip
        station = {"instruments": entries, "links": {}}
        self.world: Any = open_world(
            "af_converter", clock=self.clock, seed=1, station=station, unit_factory=lambda *_: MagicMock()
        )
        self.world.waveform, self.world.pulses = table.waveform, table.pulses
        self.visa = pyvisa.ResourceManager(self.world.visa_library)
        self.driver = {role: self._open(role, entry) for role, entry in entries.items()}

    def _open(self, role: str, entry: dict[str, Any]) -> Any:
        resource = self.visa.open_resource(entry["resource"], resource_pyclass=MessageBasedResource)
        made = importlib.import_module(f"instruments.{entry['driver']}").DRIVER
        return made(resource, role=role, clock=self.clock, transcript=self._line, options=entry["options"])

    def _line(self, *line: Any) -> None:
        self.on_line(*line)

    def close(self) -> None:
        self.visa.close()
        self.world.close()
