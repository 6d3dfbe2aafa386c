"""Logs of other people, right ones and the same spoiled in twelve ways by size and seed, with what is true of them.

Made by physics of their own: nothing of the product is used but the form in which an analysis sees a log.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Estimate, Material, analyse, stated_estimates
from bench.maths.verdict import NON_BINARY
from bench.model.errors import BenchError

Floats = NDArray[np.float64]
Columns = dict[str, Floats]
G = 9.80665
RATE_Hz = 25.0


@dataclass(frozen=True)
class Log:
    """``columns``: by name, "t_s" among them.   ``campaign``: as of the manifest.   ``truth``: by quantity and axis."""

    columns: Columns
    campaign: dict[str, Any]
    truth: Callable[[Estimate], float | None]


def _campaign(analysis: str, roles: dict[str, tuple[str, str, str]], **more: Any) -> dict[str, Any]:
    columns = [
        {"header": name, "name": name, "role": role, "axis": axis, "unit": unit}
        for name, (role, axis, unit) in roles.items()
    ]
    return {"analysis": analysis, "uut": {"model": "M", "serial": "1"}, "columns": columns, **more}


def at_rest(rng: np.random.Generator) -> Log:
    """A gyroscope and three accelerometers, five minutes at rest, white noise in fine steps."""
    t_s = np.arange(0.0, 300.0, 1.0 / RATE_Hz)
    means = {"gz": 0.1, "ax": 0.2, "ay": -0.3, "az": 9.79}
    density = {"gz": 0.005, "ax": 0.002, "ay": 0.002, "az": 0.002}
    values = {name: mean + density[name] * RATE_Hz**0.5 * rng.standard_normal(t_s.size) for name, mean in means.items()}
    roles = {"gz": ("gyro", "z", "deg/s")} | {f"a{k}": ("accelerometer", k, "m/s2") for k in "xyz"}

    def truth(entry: Estimate) -> float | None:
        gyro = entry.conditions["kind"] == "gyro"
        name, factor = ("gz", 3600.0) if gyro else (f"a{entry.conditions['axis']}", 1.0)
        return {
            "mean_output": factor * means[name],
            "next_mean_output": factor * means[name],
            "angle_random_walk": 60.0 * density[name],
            "velocity_random_walk": density[name],
            "bias_stability": factor * density[name] / 10.0**0.5,
        }.get(entry.quantity, 0.0)

    return Log({"t_s": t_s, **{name: np.round(part, 6) for name, part in values.items()}},
               _campaign("bias_log", roles), truth)  # fmt: skip


def ramp(rng: np.random.Generator) -> Log:
    """A voltage with a temperature coefficient, over a ramp up and down, a reading each ten seconds."""
    t_s = np.arange(0.0, 25_200.0, 10.0)
    chamber = np.interp(
        t_s, [0.0, 3600.0, 10_800.0, 14_400.0, 21_600.0, 25_200.0], [20.0, 20.0, 60.0, 60.0, 20.0, 20.0]
    )
    sensor = np.round(chamber + 0.01 * rng.standard_normal(t_s.size), 3)
    voltage = np.round(1.0 + 2e-6 * (chamber - 20.0) + 3e-8 * rng.standard_normal(t_s.size), 9)
    roles = {"chamber": ("set_point", "", "degC"), "sensor": ("temperature", "", "degC"), "U": ("reading", "", "V")}
    true = {"voltage_tc1": 2e-6}
    return Log({"t_s": t_s, "chamber": np.round(chamber, 3), "sensor": sensor, "U": voltage},
               _campaign("temperature_ramp", roles, reference_temperature_degC=20.0),
               lambda entry: None if entry.quantity in ("thermal_lag", "play_half_width") else
               2e-6 if entry.quantity.endswith("_tc1") else true.get(entry.quantity, 0.0))  # fmt: skip


def six_positions(rng: np.random.Generator) -> Log:
    """Three accelerometers in six positions of half a minute, with biases and scale errors."""
    rows, scale, bias = 750, np.array([1.002, 0.997, 1.001]), np.array([0.05, -0.08, 0.03])
    ups = [sign * np.eye(3)[k] for k in range(3) for sign in (1.0, -1.0)]
    force = np.repeat(np.array(ups) * G, rows, axis=0)
    read = scale * force + bias + 0.02 * rng.standard_normal(force.shape)
    segments = [
        {"item": "position", "up": f"{'+-'[k % 2]}{'xyz'[k // 2]}", "first": k * rows, "last": (k + 1) * rows - 1}
        for k in range(6)
    ]
    roles = {f"a{axis}": ("accelerometer", axis, "m/s2") for axis in "xyz"}

    def truth(entry: Estimate) -> float | None:
        if entry.quantity == "accel_bias":
            return float(-bias["xyz".index(entry.conditions["axis"])])  # what the reading lacks
        row, column = ("xyz".index(entry.conditions[name]) for name in ("row", "column"))
        return float(1.0 / scale[row]) if row == column else 0.0

    columns = {f"a{axis}": np.round(read[:, k], 5) for k, axis in enumerate("xyz")}
    return Log({"t_s": np.arange(6.0 * rows) / RATE_Hz, **columns},
               _campaign("imu_six_position", roles, segments=segments, site={"gravity_m_s2": G}), truth)  # fmt: skip


def magnetometer(rng: np.random.Generator) -> Log:
    """Three magnetometers turned through all directions, with hard iron, microtesla in gauss."""
    count, iron = 1500, np.array([0.05, -0.08, 0.03])
    height, turn = np.linspace(-0.98, 0.98, count), np.arange(count) * 2.39996
    level = np.sqrt(1.0 - height**2)
    field = 0.5 * np.column_stack([level * np.cos(turn), level * np.sin(turn), height])
    read = np.round(field + iron + 0.002 * rng.standard_normal(field.shape), 5)
    roles = {f"m{axis}": ("magnetometer", axis, "gauss") for axis in "xyz"}

    def truth(entry: Estimate) -> float | None:
        return float(iron["xyz".index(entry.conditions["axis"])]) if entry.quantity == "mag_hard_iron" else None

    columns = {f"m{axis}": read[:, k] for k, axis in enumerate("xyz")}
    return Log({"t_s": np.arange(count) / RATE_Hz, **columns}, _campaign("magnetometer_log", roles), truth)


LOGS = {
    "bias_log": at_rest,
    "temperature_ramp": ramp,
    "imu_six_position": six_positions,
    "magnetometer_log": magnetometer,
}


def _rows(columns: Columns, rows: Any) -> Columns:
    return {name: values[rows] for name, values in columns.items()}


def _one(columns: Columns, rng: np.random.Generator) -> str:
    return str(rng.choice([name for name in columns if name not in ("t_s", "chamber")]))


def pause(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    count = columns["t_s"].size
    begin = int(rng.uniform(0.2, 0.7) * count)
    return _rows(columns, np.delete(np.arange(count), slice(begin, begin + int(0.2 * size * count))))


def stopped(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    """The recorder's clock goes forward, and nothing is missing."""
    at = int(rng.uniform(0.3, 0.7) * columns["t_s"].size)
    return columns | {"t_s": columns["t_s"] + np.where(np.arange(columns["t_s"].size) > at, 3600.0 * size, 0.0)}


def held(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    every = 1 + max(1, round(4 * size))
    index = np.arange(columns["t_s"].size)
    return {name: values if name == "t_s" else values[index // every * every] for name, values in columns.items()}


def twice(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    return _rows(columns, np.repeat(np.arange(columns["t_s"].size), 2))


def dead(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    name = _one(columns, rng)
    return columns | {name: np.zeros_like(columns[name])}


def sentinels(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    name, count = _one(columns, rng), max(1, round(60 * size))
    value = float(rng.choice([0.0, 85.0, -127.0, 9.9e37, 32767.0]))
    values = columns[name].copy()
    begin = int(rng.uniform(0.1, 0.8) * values.size)
    values[begin : begin + count] = value
    return columns | {name: values}


def spikes(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    name = _one(columns, rng)
    values = columns[name].copy()
    at = rng.choice(values.size, max(1, round(8 * size)), replace=False)
    values[at] += rng.uniform(20.0, 2000.0, at.size) * np.std(np.diff(values)) * rng.choice([-1.0, 1.0], at.size)
    return columns | {name: values}


def clipped(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    name = _one(columns, rng)
    return columns | {name: np.minimum(columns[name], np.quantile(columns[name], 1.0 - 0.2 * size))}


def dropped(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    return _rows(columns, np.flatnonzero(rng.random(columns["t_s"].size) > 0.4 * size))


def bursts(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    length = max(2, round(10 * size))
    index = np.arange(columns["t_s"].size)
    last = np.minimum((index // length + 1) * length - 1, index[-1])
    return columns | {"t_s": columns["t_s"][last] + 1e-4 * (index % length)}


def frozen(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    name = _one(columns, rng)
    values = columns[name].copy()
    begin = int(rng.uniform(0.2, 0.7) * values.size)
    values[begin : begin + int(0.2 * size * values.size)] = values[begin]
    return columns | {name: values}


def in_g(columns: Columns, size: float, rng: np.random.Generator) -> Columns:
    return {name: values / G if name in ("ax", "ay", "az") else values for name, values in columns.items()}


SPOILT = (pause, stopped, held, twice, dead, sentinels, spikes, clipped, dropped, bursts, frozen, in_g)
SIZES = (0.2, 0.5, 1.0)


def outcome(log: Log, columns: Columns) -> tuple[str, dict[tuple[Any, ...], Estimate]]:
    """Return the code of a refusal, "" without one, and the sound estimates by quantity and conditions."""
    material = Material((), log.campaign, {}, series=columns)
    try:
        entries = stated_estimates(analyse(material), NON_BINARY)
    except BenchError as error:
        return error.code, {}
    return "", {
        (
            entry.quantity,
            *sorted((name, str(value)) for name, value in entry.conditions.items() if name != "length_s"),
        ): entry
        for entry in entries
        if entry.quality == "sound"
    }


def wrong(analysis: str, kind: Callable[..., Columns], size: float, seed: int) -> list[str]:
    """Return a line for each sound estimate of a spoiled log beyond 1.5 U, more than U from that of the right log."""
    rng = np.random.default_rng([seed, list(LOGS).index(analysis), SPOILT.index(kind), round(10 * size)])
    log = LOGS[analysis](rng)
    if "segments" in log.campaign and kind in (pause, twice, dropped):
        return []  # whoever names rows names those of the file
    right, spoilt = outcome(log, log.columns)[1], outcome(log, kind(log.columns, size, rng))[1]
    lines = []
    for place, entry in spoilt.items():
        true, wide = log.truth(entry), entry.expanded_uncertainty
        if kind is held and ("walk" in entry.quantity or "stability" in entry.quantity):
            continue  # a sensor that gives fewer readings of the same scatter has more noise
        before = right[place].value if place in right else true
        if true is not None and abs(entry.value - true) > 1.5 * wide and abs(entry.value - before) > wide:
            lines.append(
                f"{analysis} {kind.__name__} {size} seed {seed}: {place} {entry.value:.6g} +- {wide:.2g} for {true:.6g}"
            )
    return lines
