"""Options of the simulated bench of two navigation units with clocks of their own, and its constants."""

from __future__ import annotations

from dataclasses import dataclass

from sim_instruments.seeds import generator

MOST_OFFSET_S, MOST_DRIFT_PPM, MOST_CLOCK_PPM = 0.03, 5.0, 20.0  # of the draws

OPTIONS = {"noise": "errors of the sensors, of the navigation solution and of the radar's receiver, default on"}
NUMBERS = {
    "offset_s": ("clock of the EGI minus clock of the IMU at power-on, default a draw within 0.03", -1.0, 1.0),
    "drift_ppm": ("rate of the EGI's clock against the IMU's, default a draw within 5", -100.0, 100.0),
    "imu_clock_ppm": ("rate of the IMU's clock against the bench's, default a draw within 20", -100.0, 100.0),
    "egi_latency_s": ("from the validity of a solution to its first byte, default 0.008", 0.0, 1.0),
    "imu_latency_s": ("from the end of an IMU's interval to its first byte, default 0.0008", 0.0, 1.0),
    "jitter_s": ("mean of what all latencies are longer now and then, exponential, default 0.0003", 0.0, 0.1),
    "tag_noise_s": ("white noise of the time tags of EGI and IMU, standard deviation, default 1e-5", 0.0, 0.001),
}
TEXTS: dict[str, tuple[str, tuple[str, ...]]] = {}


@dataclass(frozen=True)
class SyncOptions:
    """Options of one bench; names and meaning as in ``OPTIONS`` and ``NUMBERS``; None is drawn."""

    noise: bool = True
    offset_s: float | None = None
    drift_ppm: float | None = None
    imu_clock_ppm: float | None = None
    egi_latency_s: float = 0.008
    imu_latency_s: float = 0.0008
    jitter_s: float = 0.0003
    tag_noise_s: float = 1e-5

    def rates_ppm(self, seed: int) -> tuple[float, float]:
        """Return drift of EGI's clock against the IMU's and rate of the IMU's, ppm; of the units: always the same."""
        drawn = generator(seed, "time sync rates").uniform(-1.0, 1.0, 2)
        drift_ppm = self.drift_ppm if self.drift_ppm is not None else MOST_DRIFT_PPM * float(drawn[0])
        imu_ppm = self.imu_clock_ppm if self.imu_clock_ppm is not None else MOST_CLOCK_PPM * float(drawn[1])
        return drift_ppm, imu_ppm

    def first_offset_s(self, seed: int, power: int) -> float:
        """Return clock of the EGI minus clock of the IMU at a switching-on, numbered from 0."""
        drawn = generator(seed, "time sync offset", power).uniform(-MOST_OFFSET_S, MOST_OFFSET_S)
        return self.offset_s if self.offset_s is not None else drawn
