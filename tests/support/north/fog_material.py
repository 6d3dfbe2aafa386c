"""Records and readings of a north finder for tests of its analysis: the Earth's rate turned by matrices, white noise.

Nothing here comes from bench.systems or sim_instruments. East, north, up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.analysis import Material, Reading
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import RecordRow, Samples

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
