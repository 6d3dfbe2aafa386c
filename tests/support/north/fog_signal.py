"""The earth signal of a turning gyroscope as the simulator's sensor feels it, through two lock-ins: no bench, no clock.

A table, lock-in amplifiers and their bench for tests of these.
"""

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pyvisa
from numpy.typing import NDArray
from pyvisa.resources import MessageBasedResource
from scripted import Log
from sim_bench import bare_world

from sim_instruments.synchronous_detection import SAMPLE_NS, LockIn
from sim_instruments.worlds.north.sensor import earth_rate_rad_s, sensed_rad_s

Float = NDArray[np.float64]
FS_Hz, TURNS, WOBBLE_deg, WOBBLE_Hz, NOISE_V = 1000, 20, 0.05, 60.0, 0.5**0.5  # of the paper; a turn takes a second


def eight_samples(phi_e_deg: Float, rng: np.random.Generator, reference: str) -> tuple[Float, Float]:
    """The eight samples of lock-in 1 and 2, (runs, 4) in volt: means over 5 s at each of four positions of the index.

    U = sin(theta + phi_e) and noise, theta with its swing; lock-in 2 takes the sine of the uniform rotation, lock-in 1
    its cosine, ``reference``: "square" or "sine".   Source: FOG paper (002), equations (1) to (14).
    """
    t_s = (np.arange(FS_Hz * TURNS) + 0.5) / FS_Hz
    swing_deg = WOBBLE_deg * np.sin(2.0 * np.pi * WOBBLE_Hz * t_s)
    theta_deg = 360.0 * t_s + swing_deg + np.repeat([0.0, 90.0, 180.0, 270.0], len(t_s) // 4)
    waves = np.stack((np.cos(2.0 * np.pi * t_s), np.sin(2.0 * np.pi * t_s)))
    waves = np.sign(waves) if reference == "square" else waves
    earth, found = earth_rate_rad_s(37.0), []
    for phi_deg in phi_e_deg:
        u_V = sensed_rad_s(earth, np.deg2rad(theta_deg + phi_deg), 0.0) / earth[1]
        u_V = u_V + NOISE_V * rng.standard_normal(t_s.size)
        found.append((u_V * waves).reshape(2, 4, -1).mean(axis=-1))
    first, second = np.moveaxis(np.array(found), 1, 0)
    return first, second


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
        noise = [
            np.random.default_rng([7, second]).normal(0.0, 1.0, 1000)
            for second in range(first // 1000, (last - 1) // 1000 + 1)
        ]
        start = first - first // 1000 * 1000
        return found + self.noise_V * np.concatenate(noise)[start : start + last - first]

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
        self.world = bare_world(entries)
        self.clock, self.log = self.world.clock, Log()
        self.world.waveform, self.world.pulses = table.waveform, table.pulses
        self.visa = pyvisa.ResourceManager(self.world.visa_library)
        self.driver = {role: self._open(role, entry) for role, entry in entries.items()}

    def _open(self, role: str, entry: dict[str, Any]) -> Any:
        resource = self.visa.open_resource(entry["resource"], resource_pyclass=MessageBasedResource)
        made = importlib.import_module(f"instruments.{entry['driver']}").DRIVER
        return made(resource, role=role, clock=self.clock, transcript=self._line, options=entry["options"])

    def _line(self, *line: Any) -> None:
        self.log(*line)
        self.on_line(*line)

    def close(self) -> None:
        self.visa.close()
        self.world.close()
