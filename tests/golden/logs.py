"""Small logs of other loggers, each made of a formula, and a mapping for each: what the golden sessions of logs hold.

``python tests/golden/logs.py FOLDER`` writes ``NAME.yaml`` and ``NAME.csv`` for each form that a session can keep
small; ``docs/history.md`` says how a release records them. One seed and few digits: the same on every machine.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
START = "start: 2024-01-01T00:00:00Z"
GRAVITY_m_s2 = 9.81
IMU = "".join(f"  w{axis}: {{role: gyro, axis: {axis}, unit: deg/s}}\n" for axis in "xyz")
IMU += "".join(f"  f{axis}: {{role: accelerometer, axis: {axis}, unit: m/s2}}\n" for axis in "xyz")
SITE = f"site: {{gravity: {GRAVITY_m_s2} m/s2, latitude: 37 deg}}\n"
UPWARDS = ("+x", "-x", "+y", "-y", "+z", "-z")


def mapping(analysis: str, columns: str, more: str = "", time: str = "format: elapsed, unit: s") -> str:
    """Return the text of a mapping whose first column is the time."""
    title = f"title: Golden log of the analysis {analysis.replace('_', ' ')}\n"
    serial = analysis.upper().replace("_", "-")
    head = f"mapping: golden\n{title}uut: {{model: LOG, serial: {serial}}}\nanalysis: {analysis}\n"
    return f"{head}{more}columns:\n  t: {{role: time, {time}, {START}}}\n{columns}"


def turned(axis: str, angle_rad: Array) -> Array:
    """Return the matrices that turn the body about one of its axes; shape (n, 3, 3)."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrices = np.tile(np.eye(3), (angle_rad.size, 1, 1))
    matrices[:, first, first] = matrices[:, second, second] = np.cos(angle_rad)
    matrices[:, first, second] = np.sin(angle_rad)
    matrices[:, second, first] = -np.sin(angle_rad)
    return matrices


def tumbled(turns: list[tuple[str, float]], rate_Hz: float, first_s: float) -> tuple[Array, Array, Array]:
    """Return times in s, rates in deg/s and specific forces in m/s2 of rests of 6 s and turns of 2 s between them.

    ``first_s``: length of the first rest, of which an analysis may take the noise.
    """
    rng = np.random.default_rng(3)
    rest, turn = round(6.0 * rate_Hz), round(2.0 * rate_Hz)
    profile = np.sin(np.pi * (np.arange(turn) + 0.5) / turn) ** 2  # begins and ends slowly, as a hand does
    attitude = np.eye(3)
    first = round(first_s * rate_Hz)
    rates, forces = [np.zeros((first, 3))], [np.tile(attitude[:, 2], (first, 1))]
    for axis, angle_deg in turns:
        step_deg = angle_deg * profile / profile.sum()
        way = turned(axis, np.radians(np.cumsum(step_deg))) @ attitude
        attitude = way[-1]
        rates += [np.eye(3)["xyz".index(axis)] * step_deg[:, None] * rate_Hz, np.zeros((rest, 3))]
        forces += [way[:, :, 2], np.tile(attitude[:, 2], (rest, 1))]
    rate, force = np.concatenate(rates), np.concatenate(forces) * GRAVITY_m_s2
    rate = rate * 1.01 + [0.2, -0.1, 0.05] + rng.normal(0.0, 0.03, rate.shape)
    force = force * [1.002, 0.999, 1.001] + [0.03, -0.02, 0.01] + rng.normal(0.0, 0.005, force.shape)
    return np.arange(len(rate)) / rate_Hz, rate, force


def imu_strapdown() -> tuple[str, Array]:
    """Rests, and hand turns between them that come back."""
    t_s, rate, force = tumbled([("x", 90.0), ("y", 90.0), ("z", -90.0), ("x", 90.0)], rate_Hz=40.0, first_s=9.0)
    return mapping("imu_strapdown", IMU, SITE), np.column_stack((t_s, rate, force))


def imu_multi_position() -> tuple[str, Array]:
    """Twenty rests in positions all round."""
    turns = [("xyz"[index % 3], 55.0 + 13.0 * index) for index in range(20)]
    t_s, _, force = tumbled(turns, rate_Hz=10.0, first_s=60.0)
    columns = "".join(IMU.splitlines(keepends=True)[3:])
    return mapping("imu_multi_position", columns, SITE), np.column_stack((t_s, force))


def imu_six_position() -> tuple[str, Array]:
    """Six rests with each axis up and down, then a turn about each axis."""
    rng = np.random.default_rng(4)
    rest, parts, segments = 100, [], []
    for upward in UPWARDS:
        force = np.zeros((rest, 3))
        force[:, "xyz".index(upward[1])] = GRAVITY_m_s2 * (1.0 if upward[0] == "+" else -1.0)
        segments.append(f"up: {upward}")
        parts.append(np.column_stack((np.zeros((rest, 3)), force)))
    for index, axis in enumerate("xyz"):
        turn = np.zeros((rest, 6))
        turn[:, index], turn[:, 3 + index] = 180.0, GRAVITY_m_s2
        segments.append(f"axis: {axis}, turn: 360 deg")
        parts.append(turn)
    table = np.concatenate(parts) * [1.01, 0.99, 1.02, 1.002, 0.999, 1.001] + [0.2, -0.1, 0.05, 0.03, -0.02, 0.01]
    table += rng.normal(0.0, 0.01, table.shape)
    lines = [
        f"  s{index}: {{rows: [{index * rest}, {index * rest + rest - 1}], {what}}}\n"
        for index, what in enumerate(segments)
    ]
    text = mapping("imu_six_position", IMU, f"{SITE}segments:\n{''.join(lines)}")
    return text, np.column_stack((np.arange(len(table)) / 50.0, table))


def bias_log() -> tuple[str, Array]:
    """Five minutes at rest: white noise on all axes, and a random walk of the rates."""
    rng = np.random.default_rng(5)
    count = 1500
    rate = 0.01 + rng.normal(0.0, 0.02, (count, 3)) + np.cumsum(rng.normal(0.0, 2e-4, (count, 3)), axis=0)
    force = rng.normal([0.0, 0.0, GRAVITY_m_s2], 0.005, (count, 3))
    return mapping("bias_log", IMU, SITE), np.column_stack((np.arange(count) * 0.2, rate, force))


def magnetometer_log() -> tuple[str, Array]:
    """A field of 48 uT in directions all round, soft and hard iron."""
    rng = np.random.default_rng(6)
    unit = rng.normal(0.0, 1.0, (600, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    soft = np.array([[1.05, 0.02, 0.0], [0.02, 0.97, 0.01], [0.0, 0.01, 1.01]])
    field = 48.0 * unit @ soft + [12.0, -7.0, 3.0] + rng.normal(0.0, 0.1, unit.shape)
    columns = "".join(f"  b{axis}: {{role: magnetometer, axis: {axis}, unit: uT}}\n" for axis in "xyz")
    return mapping("magnetometer_log", columns), np.column_stack((np.arange(600) / 10.0, field))


def north_log() -> tuple[str, Array]:
    """A gyroscope that turns about the vertical, once a second, 20 degrees from north."""
    t_s = np.arange(0.0, 20.0, 0.02)
    angle_deg = np.mod(360.0 * t_s, 360.0)
    noise = np.random.default_rng(7).normal(0.0, 50.0, t_s.size)
    output_mV = 1e3 * (np.cos(np.radians(20.0 - angle_deg)) + 0.3) + noise
    columns = "  U: {role: output, unit: mV}\n  angle: {role: encoder, unit: deg}\n"
    return mapping("north_log", columns), np.column_stack((t_s, output_mV, angle_deg))


def rlg_count_log() -> tuple[str, Array]:
    """Five minutes of a rate with a random walk of its angle, floored to counts."""
    steps = 0.1 * 9.7 + np.random.default_rng(8).normal(0.0, 0.38, 3000)  # arcsec in 0.1 s
    counts = np.floor(np.cumsum(steps) / 1.11)
    text = mapping("rlg_count_log", "  n: {role: count}\n", "count_scale: 1.11 arcsec\n")
    return text, np.column_stack((np.arange(3000) / 10.0, counts))


def stream_offset() -> tuple[str, Array]:
    """One motion in two streams, whose stamps are 13.7 ms apart."""
    rng = np.random.default_rng(9)
    t_s = np.sort(np.concatenate((np.arange(0.0, 60.0, 0.05), np.arange(0.003, 60.0, 0.08))))
    is_one = np.isin(t_s, np.arange(0.0, 60.0, 0.05))
    motion = sum(size * np.exp(-(((t_s - at) / 2.0) ** 2)) for size, at in ((30.0, 12.0), (-20.0, 31.0), (12.0, 47.0)))
    motion = motion + rng.normal(0.0, 0.2, t_s.size)
    one = [np.where(is_one, values, np.nan) for values in (t_s + 0.0137, motion)]
    other = [np.where(is_one, np.nan, values) for values in (t_s, 0.98 * motion + 0.5)]
    columns = "".join(
        f"  {stream}_t: {{role: stamp, stream: {stream}, unit: s}}\n"
        f"  {stream}_w: {{role: motion, stream: {stream}, of: rate, unit: deg/s}}\n"
        for stream in ("one", "other")
    )
    text = mapping("stream_offset", columns, 'overload: {values: [""]}\n')
    return text, np.column_stack((t_s, *one, *other))


def radar_image() -> tuple[str, Array]:
    """The echoes of one point in 9.5 to 9.7 GHz, seen from an arc of 4 degrees."""
    pulses, steps = 48, 32
    turn = np.radians(30.0 + 4.0 * (np.arange(pulses) / (pulses - 1) - 0.5))
    antenna = np.column_stack((5000.0 * np.cos(turn), 5000.0 * np.sin(turn), np.full(pulses, 4000.0)))
    farther_m = np.linalg.norm(antenna - [4.0, -2.0, 0.0], axis=1) - np.linalg.norm(antenna, axis=1)
    phase = -4.0 * np.pi * np.outer(farther_m, np.linspace(9.5e9, 9.7e9, steps)) / 299_792_458.0
    noise = np.random.default_rng(10).normal(0.0, 0.05, (2, pulses, steps))
    columns = "".join(f"  {axis}: {{role: antenna, axis: {axis}, unit: m}}\n" for axis in "xyz")
    columns += f"  'i_{{0..{steps - 1}}}': {{role: in_phase}}\n  'q_{{0..{steps - 1}}}': {{role: quadrature}}\n"
    parts = np.column_stack((np.cos(phase) + noise[0], np.sin(phase) + noise[1]))
    text = mapping("radar_image", columns, "frequencies: {first: 9.5 GHz, last: 9.7 GHz}\n")
    return text, np.column_stack((np.arange(pulses) / 100.0, antenna, parts))


def temperature_ramp() -> tuple[str, Array]:
    """A meter beside a standard while its temperature goes up and down, a row every five minutes."""
    t_s = np.arange(0.0, 57_600.0, 300.0)
    set_degC = np.interp(t_s, np.cumsum([0, 7200, 18_000, 7200, 18_000, 7200]), [20.0, 20.0, 35.0, 35.0, 20.0, 20.0])
    rng = np.random.default_rng(11)
    x, hours = set_degC - 25.0, t_s / 3600.0
    ppm = 0.6 * x + 0.01 * x**2 + 0.05 * hours + rng.normal(0.0, 0.05, t_s.size)
    standard_V = 1.0 + 1e-8 * np.cumsum(rng.normal(0.0, 2.0, t_s.size))
    columns = (
        "  set: {role: set_point, quantity: set_point, unit: degC}\n"
        "  s1: {role: temperature, quantity: sensor_1, unit: degC}\n"
        "  ref: {role: reference, quantity: standard, unit: V}\n  dmm: {role: reading, quantity: meter, unit: V}\n"
    )
    text = mapping("temperature_ramp", columns, "reference_temperature: 25 degC\n")
    return text, np.column_stack((t_s, set_degC, set_degC + 0.1, standard_V, standard_V * (1.0 + 1e-6 * ppm)))


LOGS = (
    temperature_ramp, imu_six_position, imu_multi_position, imu_strapdown, bias_log, magnetometer_log, north_log,
    rlg_count_log, stream_offset, radar_image,
)  # fmt: skip


def header(text: str) -> list[str]:
    """Return the names of the columns of a mapping in order, those of a numbered row of columns one by one."""
    names: list[str] = []
    for line in text.partition("columns:\n")[2].splitlines():
        name = line.strip().partition(": {")[0].strip("'")
        stem, brace, numbers = name.partition("{")
        last = int(numbers.strip("}").split("..")[1]) if brace else 0
        names += [f"{stem}{number}" for number in range(last + 1)] if brace else [name]
    return names


def main(folder: Path) -> None:
    """Write all logs and their mappings into a folder."""
    for log in LOGS:
        text, table = log()
        names = header(text)
        rows = [",".join("" if np.isnan(value) else f"{value:.9g}" for value in row) for row in table]
        (folder / f"{log.__name__}.yaml").write_text(text, encoding="utf-8")
        (folder / f"{log.__name__}.csv").write_text("\n".join([",".join(names), *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
