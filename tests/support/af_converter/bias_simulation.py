"""Bias-ramp campaigns for the tests of the fit, from the physics: heat flow, slack, charge and whole pulses.

Temperatures are integrated step by step (trapezoidal rule, 2 s), the play moves by its literal definition, and the
counts are whole quanta of the charge that really flowed. Nothing of bench.systems or sim_instruments is used.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.signal import lfilter

from bench.analysis import Trace
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow
from bench.systems.af_converter.bias_ramp.estimates import channel_estimates, compensated_A, master_clock_estimates
from bench.systems.af_converter.bias_ramp.fit import (
    JOINT,
    ChannelFit,
    channel_readings,
    drive_of,
    fit_channel,
    fit_master_clock,
    ramp_records,
)
from bench.systems.af_converter.bias_ramp.noise import channel_noise, noise_estimates
from bench.systems.af_converter.constants import Campaign, Typical, read_campaign

STEP_s, GATE_s, FRAME_s = 2.0, 100.0, 0.01
AIR_LAG_s, REFERENCE_degC = 120.0, 20.0
WHITE_A_rtHz, WALK_A_rth = 2e-9, 3e-10
K0_C = {"gyro": 1.25e-6, "accelerometer": 1e-7}
# set-point: hours and degC at the corners; the preparation from 23 to -10 degC comes first
PREPARATION_h = 3.1
CORNERS_h = np.array([0, 1.1, PREPARATION_h, 5.1, 15.1, 16.1, 26.1, 28.1])
CORNERS_degC = np.array([23.0, -10.0, -10.0, -10.0, 50.0, 50.0, -10.0, -10.0])


@dataclass(frozen=True)
class Unit:
    """Truth of one channel; ``polynomial`` in ampere per degC^k about 20 degC, of i_AFbias."""

    kind: str
    polynomial: tuple[float, ...]
    width_A: float
    half_width_degC: float
    lag_s: float = 1500.0
    dsf: float = 0.0


def draw(rng: np.random.Generator, kind: str, *, dsf: bool = False, hysteresis: bool = True) -> Unit:
    gyro = kind == "gyro"
    bias = rng.normal(4e-7, 2.5e-8) if gyro else rng.normal(-2.55e-7, 8e-9)
    slope = (2e-9 if gyro else 1e-9) * rng.uniform(0.9, 1.1) * rng.choice((-1, 1))
    curve = rng.uniform(1e-12, 4e-12) * rng.choice((-1, 1)), rng.uniform(3e-14, 1e-13) * rng.choice((-1, 1))
    width = (2e-8 if gyro else 1.8e-8) * rng.uniform(0.8, 1.2) * rng.choice((-1, 1))
    half = (2.5 if gyro else 3.0) * rng.uniform(0.8, 1.2)
    error = float(rng.normal(0, 4e-4)) if dsf else 0.0
    return Unit(kind, (bias, slope, *curve), width if hysteresis else 0.0, half, dsf=error)


@dataclass(frozen=True)
class Heat:
    """Temperatures every 2 s from the start of the preparation, and where the windows of 100 s begin."""

    t_s: np.ndarray
    air_degC: np.ndarray
    unit_degC: np.ndarray
    windows: np.ndarray = field(repr=False)  # index of the first step of each window, and the end of the last


@cache
def heat(lag_s: float = 1500.0) -> Heat:
    t_s = np.arange(0.0, CORNERS_h[-1] * 3600.0 + STEP_s, STEP_s)
    set_point = np.interp(t_s / 3600.0, CORNERS_h, CORNERS_degC)
    air = follow(set_point, AIR_LAG_s)
    first = round(PREPARATION_h * 3600.0 / STEP_s)
    count = round((CORNERS_h[-1] - PREPARATION_h) * 3600.0 / GATE_s)
    windows = first + np.arange(count + 1) * round(GATE_s / STEP_s)
    return Heat(t_s, air, follow(air, lag_s), windows)


def follow(drive: np.ndarray, lag_s: float) -> np.ndarray:
    """lag dT/dt = drive - T by the trapezoidal rule, in equilibrium at first."""
    a = STEP_s / (2.0 * lag_s)
    gain = a / (1.0 + a)  # T1 (1 + a) = T0 (1 - a) + a (u0 + u1)
    return lfilter([gain, gain], [1.0, -(1.0 - a) / (1.0 + a)], drive, zi=[drive[0] * (1.0 - gain)])[0]


def slack(temperature: np.ndarray, half_width: float) -> np.ndarray:
    """Play by its definition: the piston stands still until the slack is taken up; in the middle at first.

    From one turn of the temperature to the next it is pushed by one wall only.
    """
    warmer = np.diff(temperature) > 0
    up = np.concatenate((warmer[:1], warmer))
    turns = np.flatnonzero(up[1:] != up[:-1]) + 1
    piston, path = temperature[0], []
    for stretch, pushed_up in zip(np.split(temperature, turns), up[[0, *turns]], strict=True):
        moved = np.maximum(piston, stretch - half_width) if pushed_up else np.minimum(piston, stretch + half_width)
        path.append(moved)
        piston = moved[-1]
    return np.concatenate(path)


@dataclass(frozen=True)
class Flow:
    """What one channel did: true bias and net charge at every step, from the start of the preparation."""

    bias_A: np.ndarray
    charge_C: np.ndarray
    walk_A: np.ndarray


def flow(
    unit: Unit, rng: np.random.Generator, *, noise: bool = True, walk: bool = True, added_A: np.ndarray | float = 0.0
) -> Flow:
    """``added_A``: a further bias at every step."""
    world = heat(unit.lag_s)
    x = world.unit_degC - REFERENCE_degC
    bias = np.polynomial.polynomial.polyval(x, unit.polynomial)
    if unit.width_A:
        h = unit.width_A / (2.0 * unit.half_width_degC)
        bias = bias + h * (slack(world.unit_degC, unit.half_width_degC) - world.unit_degC)
    steps = rng.standard_normal((2, x.size))
    wander = np.cumsum(steps[0]) * WALK_A_rth * np.sqrt(STEP_s / 3600.0) * (noise and walk)
    bias = bias + wander + added_A
    current = -(bias[1:] + bias[:-1]) / 2.0 + steps[1, 1:] * WHITE_A_rtHz / np.sqrt(2.0 * STEP_s) * noise
    charge = np.concatenate(([0.0], np.cumsum(current) * STEP_s))
    return Flow(bias, charge, wander)


@dataclass(frozen=True)
class Ramp:
    """Readings of one channel over the 25 hours, and the temperatures that the bench has recorded."""

    unit: Unit
    start_s: np.ndarray
    end_s: np.ndarray
    bias_A: np.ndarray  # gated: negative of the net count rate times the nominal charge
    trace_t_s: np.ndarray
    air_degC: np.ndarray
    sensor_degC: np.ndarray
    mean_walk_A: float
    flow: Flow = field(repr=False)

    def truth(self, order: int) -> float:
        """Coefficient of the centre curve, with the mean of the walk over the windows, as the nominal K0 sees it."""
        value = self.unit.polynomial[order] + (self.mean_walk_A if order == 0 else 0.0)
        return value / (1.0 + self.unit.dsf)


def ramp(seed: int, kind: str = "gyro", unit: Unit | None = None, *, noise: bool = True, walk: bool = True,
         quantised: bool = True, added_A: np.ndarray | float = 0.0) -> Ramp:  # fmt: skip
    rng = np.random.default_rng([seed, len(kind)])
    unit = unit or draw(rng, kind)
    world, run = heat(unit.lag_s), flow(unit, rng, noise=noise, walk=walk, added_A=added_A)
    phase = run.charge_C[world.windows] / (K0_C[unit.kind] * (1.0 + unit.dsf))
    if quantised:
        phase = np.trunc(phase + np.sign(phase[-1]) * rng.uniform())
    edges = world.t_s[world.windows]
    minute = slice(None, None, round(60.0 / STEP_s))
    noise_degC = rng.normal(0, 0.01, (2, world.t_s[minute].size)) * noise
    inside = slice(world.windows[0], world.windows[-1])
    return Ramp(
        unit=unit,
        start_s=edges[:-1],
        end_s=edges[1:],
        bias_A=-np.diff(phase) * K0_C[unit.kind] / GATE_s,
        trace_t_s=world.t_s[minute],
        air_degC=np.round(world.air_degC[minute] + noise_degC[0], 2 if noise else 9),
        sensor_degC=np.round(world.unit_degC[minute] + noise_degC[1], 2 if noise else 9),
        mean_walk_A=float(np.mean(run.walk_A[inside])),
        flow=run,
    )


def covariance(kind: str) -> np.ndarray:
    """Covariance of the 900 gated readings, dense, from the physics."""
    m = 900
    quantum = (K0_C[kind] / GATE_s) ** 2 / 6.0
    found = np.eye(m) * (quantum + WHITE_A_rtHz**2 / (2.0 * GATE_s))
    found -= 0.5 * quantum * (np.eye(m, k=1) + np.eye(m, k=-1))
    middle = (np.arange(m) + 0.5) * GATE_s
    return found + WALK_A_rth**2 / 3600.0 * (np.minimum.outer(middle, middle) - np.eye(m) * GATE_s / 6.0)


BRANCHES = (("hold_start", 72), ("up", 360), ("hold_top", 36), ("down", 360), ("hold_end", 72))
F_AF0_Hz, MASTER_Hz, FG_Hz, FRAMES = 256e3, 1e7, 1e7, 10000
AF_ERROR, MASTER_ppm = 20.3e-6, (1.5, 0.015, 0.0, 4.5e-5)  # dMSTR about 20 degC


def rows(ramps: dict[int, Ramp], *, timed: bool = True) -> list[RecordRow]:
    """Records of ten channels with their pulses timed to a frame; channels that are not simulated count nothing."""
    world = next(iter(ramps.values()))
    pulses = {number: _pulse_frames(one) for number, one in ramps.items()}
    unit = np.interp((world.start_s + world.end_s) / 2.0, world.trace_t_s, world.sensor_degC)
    clocks = _clock_counts(unit)
    branch = [name for name, count in BRANCHES for _ in range(count)]
    found = []
    for index, start_s in enumerate(world.start_s):
        first = 1000 + index * FRAMES
        window = RecordWindow(
            number=index + 1,
            link="port_a",
            first_counter=first,
            frames=FRAMES,
            t_start_ns=round(start_s * 1e9),
            t_end_ns=round((start_s + GATE_s) * 1e9),
            conditions={"route": "open", "branch": branch[index], "window_index": index, "purpose": "measurement"},
        )
        counts = {name: np.zeros(10, np.int64) for name in ("npp", "ppp")}
        timing = {f"{name}.{key}": np.zeros(10, np.int64) for name in counts for key in ("moment1", "moment2")}
        timing |= {f"{name}.{key}": np.full(10, -1) for name in counts for key in ("first", "last")}
        timing |= {f"{name}.{key}": np.zeros(10, np.int64) for name in counts for key in ("at_first", "at_last")}
        for number, (name, frames) in pulses.items():
            _time(frames[index], number - 1, name, first, counts, timing)
        sums = {**counts, **{name: np.int64(values[index]) for name, values in clocks.items()}}
        context = {"unit_temperature_degC": float(unit[index])}
        found.append(RecordRow(window, sums, FRAMES, 0, 0, Quality.GOOD, context, timing=timing if timed else {}))
    return found


def _pulse_frames(one: Ramp) -> tuple[str, list[np.ndarray]]:
    """Polarity, and the frame (1 ...) of each pulse of each window: whenever the charge has grown by a quantum."""
    world = heat(one.unit.lag_s)
    phase = np.abs(one.flow.charge_C) / (K0_C[one.unit.kind] * (1.0 + one.unit.dsf))
    grown = np.maximum.accumulate(phase)
    instants = np.interp(np.arange(1, int(grown[-1]) + 1), grown, world.t_s)
    edges = np.searchsorted(instants, world.t_s[world.windows])
    frames = [
        np.minimum(((instants[low:high] - start) / FRAME_s).astype(np.int64), FRAMES - 1) + 1
        for low, high, start in zip(edges[:-1], edges[1:], one.start_s, strict=True)
    ]
    return ("npp" if one.flow.charge_C[-1] > 0 else "ppp"), frames


def _time(frames: np.ndarray, at: int, name: str, first: int, counts: dict, timing: dict) -> None:
    counts[name][at] = frames.size
    timing[f"{name}.moment1"][at], timing[f"{name}.moment2"][at] = frames.sum(), (frames**2).sum()
    if frames.size:
        for key, frame in (("first", frames[0]), ("last", frames[-1])):
            timing[f"{name}.{key}"][at] = first + frame - 1
            timing[f"{name}.at_{key}"][at] = int(np.count_nonzero(frames == frame))


def _clock_counts(unit_degC: np.ndarray) -> dict[str, np.ndarray]:
    """Clocks of each gate of 1e9 nominal master pulses: phases that run on from window to window."""
    master = 1e-6 * np.polynomial.polynomial.polyval(unit_degC - REFERENCE_degC, MASTER_ppm)
    edges_s = np.concatenate(([0.123], 0.123 + np.cumsum(GATE_s / (1.0 + master))))
    found = {"af_clock": F_AF0_Hz * (1.0 + AF_ERROR), "fg_count": FG_Hz}
    counts = {name: np.diff(np.floor(edges_s * rate_Hz)) for name, rate_Hz in found.items()}
    return counts | {"master_count": np.full(unit_degC.size, GATE_s * MASTER_Hz)}


def campaign(ramps: dict[int, Ramp]) -> dict[str, Any]:
    """The manifest's section."""
    kinds = {"gyro": (0.299, 83.0, "deg/s", 2.4e-8), "accelerometer": (0.0242, 20.2, "g", 7.2e-8)}
    channels = []
    for number, one in ramps.items():
        full, sensor, unit, limit = kinds[one.unit.kind]
        channels.append(
            {
                "number": number,
                "kind": one.unit.kind,
                "k0_C": K0_C[one.unit.kind],
                "full_scale_A": full,
                "sensor_full_scale": sensor,
                "sensor_unit": unit,
                "noise": {"white_A_rtHz": WHITE_A_rtHz, "walk_A_rth": WALK_A_rth},
                "bias_stability_limit_A": limit,
            }
        )
    return {
        "analysis": "bias_ramp",
        "reference_temperature_degC": REFERENCE_degC,
        "af_clock_Hz": F_AF0_Hz,
        "fg_Hz": FG_Hz,
        "master_Hz": MASTER_Hz,
        "uut": {"model": "NGU", "serial": "SIM-1"},
        "channels": channels,
        "temperature_sensor_u95_degC": 0.1,
    }


Place = tuple[str, str, float | None]  # quantity, kind, temperature
SENSOR_STD_degC, DSF_STD, GENERATOR = 0.05, 4e-4, 3e-6  # declared: 95 % of 0.1 degC; design; rectangular
WHITE_A_rts = 2e-9 / np.sqrt(2.0)  # two-sided


def place(entry: Mapping[str, Any]) -> Place:
    conditions = entry.conditions
    return entry.quantity, conditions.get("kind", ""), conditions.get("temperature_degC")


def errors_of(seed: int, kinds: Mapping[str, Typical], lag_s: float) -> dict[Place, float]:
    """Return estimate minus truth of every quantity of a campaign: one channel of each kind."""
    ramps, records, constants, fits = _fitted(seed, kinds, lag_s)
    pairs: list[tuple[Mapping[str, Any], float]] = []
    for fit, one in zip(fits, ramps, strict=True):
        pairs += [(entry, _truth(entry, fit, one, constants)) for entry in channel_estimates(fit, constants, 0)]
    for entry in noise_estimates(channel_noise(fits, records)):
        pairs.append((entry, {"white_noise": WHITE_A_rts, "random_walk": WALK_A_rth}.get(entry.quantity, 0.0)))
    clock = fit_master_clock(records, constants, {})
    for entry in master_clock_estimates(clock, (-10.0, 20.0, 50.0), 0):
        at = entry.conditions.get("temperature_degC", 20.0)
        order = int(entry.quantity[-1]) if "_tc" in entry.quantity else None
        true_ppm = np.polynomial.polynomial.polyval(at - 20.0, MASTER_ppm) if order is None else MASTER_ppm[order]
        pairs.append((entry, float(true_ppm)))
    return {place(entry): entry.value - truth for entry, truth in pairs}


def _fitted(
    seed: int, kinds: Mapping[str, Typical], lag_s: float
) -> tuple[list[Ramp], Any, Campaign, list[ChannelFit]]:
    """Return the ramps of a campaign, its records, its constants, and the fits to them."""
    rng = np.random.default_rng([seed, 46])
    sensor_degC, generator = rng.normal(0, SENSOR_STD_degC), rng.uniform(-GENERATOR, GENERATOR)
    ramps = {
        number: _ramp(seed, kind, typical, lag_s, float(rng.normal(0, DSF_STD)))
        for number, (kind, typical) in enumerate(kinds.items(), start=1)
    }
    read = {number: replace(one, sensor_degC=one.sensor_degC + sensor_degC) for number, one in ramps.items()}
    found = [_off_nominal(row, generator, sensor_degC, rng) for row in rows(ramps)]  # clocks are of the true unit
    constants = read_campaign(campaign(ramps))
    any_ramp = next(iter(read.values()))
    trace = Trace(any_ramp.trace_t_s, any_ramp.air_degC, any_ramp.sensor_degC)
    records = ramp_records(found, constants.master_Hz)
    drive = drive_of(trace, records, JOINT)
    fits = [
        fit_channel(readings, records, trace, drive, constants, JOINT)
        for readings in channel_readings(records, constants).values()
    ]
    return list(ramps.values()), records, constants, fits


def _ramp(seed: int, kind: str, typical: Typical, lag_s: float, dsf: float) -> Ramp:
    curve = (typical.bias_A, typical.bias_tc1_A_degC, 0.0, 0.0)
    return ramp(seed, unit=Unit(kind, curve, typical.hysteresis_width_A, typical.play_half_width_degC, lag_s, dsf))


def _off_nominal(row: Any, generator: float, sensor_degC: float, rng: np.random.Generator) -> Any:
    """Return a window whose generator and sensor are off, each of its counts cut anywhere."""
    count = np.int64(np.floor(row.sums["fg_count"] * (1.0 + generator) + rng.uniform()))
    context = {name: value + sensor_degC for name, value in row.context.items()}
    return replace(row, sums={**row.sums, "fg_count": count}, context=context)


def _truth(entry: Mapping[str, Any], fit: ChannelFit, one: Ramp, constants: Campaign) -> float:
    quantity, at = entry.quantity, entry.conditions.get("temperature_degC")
    if quantity == "bias":
        curve = (one.unit.polynomial[0] + one.mean_walk_A, *one.unit.polynomial[1:])
        return float(np.polynomial.polynomial.polyval(at - 20.0, curve))
    if quantity.startswith("bias_tc"):
        return one.unit.polynomial[int(quantity[-1])]
    if quantity == "bias_residual":
        return entry.value - _residual_error(fit, one, constants)
    lag_min = one.unit.lag_s / 60.0
    return {"hysteresis_width": one.unit.width_A, "play_half_width": one.unit.half_width_degC, "thermal_lag": lag_min}[
        quantity
    ]


def _residual_error(fit: ChannelFit, one: Ramp, constants: Campaign) -> float:
    """Return the error of the largest mean over an hour: of its readings, for the polynomial is as it is used."""
    gates, t_s = fit.readings.gates, heat(one.unit.lag_s).t_s
    charge = np.concatenate(([0.0], np.cumsum((one.flow.bias_A[1:] + one.flow.bias_A[:-1]) / 2.0 * np.diff(t_s))))
    gate_s = gates.end_s - gates.start_s
    true_A = (np.interp(gates.end_s, t_s, charge) - np.interp(gates.start_s, t_s, charge)) / gate_s
    seen_A = true_A / (1.0 + one.unit.dsf)
    left_A = compensated_A(fit)
    hour = ((gates.middle_s - gates.start_s[0]) // 3600.0).astype(int)
    length_s = np.bincount(hour, gate_s)
    means = np.bincount(hour, left_A * gate_s) / length_s * (length_s >= 1800.0)  # less than half an hour is none
    error_A = fit.readings.bias_A - seen_A - one.unit.dsf * (left_A - fit.readings.bias_A + seen_A)
    inside = hour == np.argmax(np.abs(means))
    return float(np.average(error_A[inside], weights=gate_s[inside]))
