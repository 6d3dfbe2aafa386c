"""What six positions and turns of 1,080 deg recover of simulated units, by plain formulas written here."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from gnc_sensor_bench import Table, at, times_ns, trapezoid

from bench.model.clock import NS
from bench.model.ports import RecordWindow
from sim_instruments.worlds.gnc.imu import GncImu, ImuOptions
from sim_instruments.worlds.gnc.truth import estimates

SEED = 5
G = 9.7969 / 9.80665
POSES = {"+x": (-90, 0), "-x": (90, 0), "+y": (0, 90), "-y": (0, -90), "+z": (0, 0), "-z": (0, 180)}  # middle, inner
EARTH_DEG_S = 360.0 / 86_164.0905
POSITION_S, TURN_S, FIRST_S = 60.0, 16.3, 320.0
SQUARE, CROSS = np.eye(3, dtype=bool), ~np.eye(3, dtype=bool)


class Errors(NamedTuple):
    """Found minus true: S (3, 3) ppm of both triads, accelerometer bias in mg, gyro bias in units of N/sqrt(4T)."""

    accel_ppm: np.ndarray
    gyro_ppm: np.ndarray
    accel_bias_mg: np.ndarray
    gyro_bias: np.ndarray


class Recovery:
    """One unit, calibrated."""

    def __init__(self, serial: str, tilt_arcmin: float) -> None:
        self._table = Table()
        self._unit = GncImu(SEED, serial, ImuOptions(tilt_arcmin=tilt_arcmin), surroundings=self._table)
        self._unit.power.on(0)
        self._windows: list[RecordWindow] = []
        self._now_s = FIRST_S

    def errors(self) -> Errors:
        accel, accel_bias = self._positions()
        gyro, gyro_bias = self._turns()
        truth: dict[str, list[float]] = {}
        for one in estimates({"": self._unit}, self._windows):
            truth.setdefault(one["quantity"], []).append(one["value"])
        inverse = [np.linalg.inv(np.reshape(truth[name], (3, 3))) for name in ("accel_matrix", "gyro_matrix")]
        theory = self._unit.errors.gyro.white * 3600 / np.sqrt(4 * TURN_S)
        return Errors(
            (accel - inverse[0]) * 1e6,
            (gyro - inverse[1]) * 1e6,
            (accel_bias - truth["accel_bias"]) * 1e3,
            (gyro_bias * 3600 - truth["gyro_bias"]) / theory,
        )

    def _record(self, length_s: float, **conditions: str) -> np.ndarray:
        begin_s, self._now_s = self._now_s, self._now_s + length_s
        span = round(begin_s * NS), round(self._now_s * NS)
        self._windows.append(RecordWindow(1, "rs422", 0, round(length_s * 200), *span, conditions))
        return times_ns(length_s, first_s=begin_s)

    def _positions(self) -> tuple[np.ndarray, np.ndarray]:
        """S and the bias of a = K N + bias."""
        forces, rows = [], []
        for up, (middle, inner) in POSES.items():
            self._table.motion = (at(0), at(middle), at(inner))
            counts = self._unit.sample(self._record(POSITION_S, item="position"))
            rows.append([*(counts.accel.mean(axis=0) * 1e-3), 1.0])
            forces.append((1 if up[0] == "+" else -1) * G * np.eye(3)["xyz".index(up[1])])
            self._now_s += 20.0
        solution = np.linalg.lstsq(np.array(rows), np.array(forces), rcond=None)[0]
        return np.linalg.inv(solution[:3].T), solution[3]

    def _turns(self) -> tuple[np.ndarray, np.ndarray]:
        """S and b of N = S (w + b); the axis that turns lies along the Earth's axis."""
        sums = np.empty((3, 2, 3))
        for axis, mounting in enumerate("xyz"):
            for sense, turn in enumerate((1080.0, -1080.0)):
                self._now_s += 30.0
                self._table.mounting = mounting
                self._table.motion = (at(90), at(-34.2), trapezoid(self._now_s + 1.0, turn, 270.0, 270.0))
                counts = self._unit.sample(self._record(TURN_S, item="rotation", axis=mounting))
                sums[axis, sense] = counts.gyro.sum(axis=0) * 0.005 * 0.005
        matrix = (sums[:, 0] - sums[:, 1]).T / 2160.0
        both = sums.sum(axis=1) / (2 * TURN_S) - EARTH_DEG_S * matrix.T  # row: axis that turned, column: sensor
        cross = np.array([both[np.arange(3) != sensor, sensor].mean() for sensor in range(3)])
        return matrix, np.linalg.solve(matrix, cross)


def recovered(units: int, tilt_arcmin: float) -> Errors:
    each = [Recovery(f"GNC-{number:02d}", tilt_arcmin).errors() for number in range(units)]
    return Errors(*(np.array(column) for column in zip(*each, strict=True)))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("units", [6, pytest.param(50, marks=pytest.mark.sweep)])
def test_a_table_without_tilt(units: int) -> None:
    """Scale and cross terms within 50 ppm, gyro bias as its random walk allows (docs/gnc-simulation.md)."""
    found = recovered(units, 0.0)
    for ppm, expected in ((found.accel_ppm, 10.0), (found.gyro_ppm, 13.0)):
        assert np.abs(ppm).max() < 50.0
        assert rms(ppm[:, SQUARE]) == pytest.approx(expected, rel=0.35)
        assert rms(ppm[:, CROSS]) == pytest.approx(expected, rel=0.35)
    assert rms(found.accel_bias_mg) < 0.008
    assert rms(found.gyro_bias) == pytest.approx(1.0, abs=0.17 if units == 50 else 0.4)
    assert np.abs(found.gyro_bias).max() < 4.5


@pytest.mark.parametrize("units", [3, pytest.param(50, marks=pytest.mark.sweep)])
def test_what_a_tilt_of_1_arcmin_costs(units: int) -> None:
    found = recovered(units, 1.0)
    for ppm in (found.accel_ppm, found.gyro_ppm):
        assert np.abs(ppm[:, SQUARE]).max() < 50.0
        assert 100.0 < rms(ppm[:, CROSS]) < 350.0
