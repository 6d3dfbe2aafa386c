"""Imported logs of two clocks, and a unit's clock by its receive stamps: rate and offset within their uncertainty."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imported_logs import columns_of, estimates_of, imported, of_mirror, parsed, table
from numpy.typing import NDArray
from one_estimate import every, one
from scipy import optimize
from sync_physics import IMU_CLOCK, TURNING, IMU_s, OFFSET_s, Recording
from sync_physics import Path as Drive

from bench.analysis import Material
from bench.analysis.doubt import weigh
from bench.maths import stamps
from bench.maths.samples import off_course
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError, InputErrors
from bench.systems.time_sync import egi_log, logs
from bench.systems.time_sync.estimators import port_clocks
from bench.systems.time_sync.estimators.common_motion import BLOCKS, common_motion
from bench.systems.time_sync.estimators.stamp_grid import grid_s

Array = NDArray[np.float64]
STREAMS = """\
mapping: streams
uut: {model: pair, serial: S-1}
analysis: stream_offset
overload: {values: [""]}
columns:
  row: {role: time, format: unix, unit: s}
  a_t: {role: stamp, stream: one, unit: s}
  a_w: {role: motion, stream: one, of: rate, unit: deg/s}
  b_t: {role: stamp, stream: other, unit: ms}
  b_w: {role: motion, stream: other, of: rate, unit: rad/s}
"""


def rate(t_s: Array) -> Array:
    """Three turns at uneven times, deg/s."""
    return sum(
        size * np.exp(-(((t_s - at) / wide) ** 2)) for size, at, wide in ((30, 12, 2), (-20, 31, 3), (12, 47, 1))
    )


def streams(offset_s: float, noise: float = 0.2, epoch_s: float = 0.0, seed: int = 4, drift: float = 0.0) -> Material:
    """Rows of 100 and of 40 a second in order of time; what the other stream's rows lack is NaN."""
    rng = np.random.default_rng(seed)
    one_s, other_s = np.arange(0.0, 60.0, 0.01), np.arange(0.003, 60.0, 0.025)
    t_s = np.concatenate((one_s, other_s))
    of_one = np.arange(t_s.size) < one_s.size
    seen = rate(t_s) + rng.normal(0.0, noise, t_s.size)
    order = np.argsort(t_s)

    def only(which: NDArray[np.bool_], values: Array) -> Array:
        return np.where(which, values, np.nan)[order]

    series = {
        "t_s": t_s[order],
        "one_stamp": only(of_one, t_s * (1.0 + drift) + offset_s + epoch_s),
        "one_rate": only(of_one, seen),
        "other_stamp": only(~of_one, t_s),
        "other_rate": only(~of_one, 0.98 * seen + 0.5),
    }
    columns = [
        {"name": f"{stream}_{name}", "role": role, "stream": stream, "of": name, "unit": unit}
        for stream in ("one", "other")
        for name, role, unit in (("stamp", "stamp", "s"), ("rate", "motion", "deg/s"))
    ]
    return Material((), {"uut": {"model": "m", "serial": "1"}, "columns": columns}, {}, series=series)


@pytest.mark.parametrize(("offset_s", "epoch_s"), [(0.0137, 0.0), (-0.42, 0.0), (0.25, 1_600_000_000.0)])
def test_the_offset_of_the_formula_is_found(offset_s: float, epoch_s: float) -> None:
    analysis = logs.analyse(streams(offset_s, epoch_s=epoch_s))
    entry = one(analysis, "time_offset")
    assert entry.value - epoch_s == pytest.approx(offset_s, abs=3.0 * entry.std_uncertainty + 1e-6)
    assert entry.std_uncertainty < 1e-3
    assert weigh(analysis.evidence).against == []


def test_intervals_hold_the_offset_as_often_as_they_say() -> None:
    """Sixty logs of other noise: an interval of 95 % may miss in 8 of them at most, by the binomial law to 1 %."""
    entries = [logs.analyse(streams(0.0137, seed=seed)).estimates[0] for seed in range(60)]
    errors = np.array([entry.value - 0.0137 for entry in entries])
    expanded = np.array([entry.expanded_uncertainty for entry in entries])
    assert np.count_nonzero(np.abs(errors) > expanded) <= 8
    assert 0.6 < np.std(errors) / np.mean([entry.std_uncertainty for entry in entries]) < 1.5


def test_intervals_of_the_halves_hold_it_too_and_their_difference_is_no_drift() -> None:
    """Few blocks of a half hold motion: by blocks alone 11 of 60 missed, and the score of the halves was 1.8."""
    each = [common_motion(*read["one"], *read["other"]) for read, _ in
            (logs._streams(streams(0.0137, seed=seed)) for seed in range(60))]  # fmt: skip
    errors, std_s = (np.array([getattr(found, name) for found in each]) for name in ("halves_s", "halves_std_s"))
    missed = np.count_nonzero(np.abs(errors - 0.0137) > coverage_factor(BLOCKS - 1) * std_s, axis=0)
    assert missed.max() <= 8
    scores = np.diff(errors, axis=1)[:, 0] / np.hypot(*std_s.T)
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.4


def test_a_clock_that_drifts_and_a_motion_that_repeats_are_doubted() -> None:
    drifting = weigh(logs.analyse(streams(0.0, drift=2e-3)).evidence)
    assert [check.code for check in drifting.against] == ["offset_changes"]
    shaken = streams(0.1)
    for name in ("one_rate", "other_rate"):
        t_s = shaken.series["t_s"]
        shaken.series[name][:] = np.where(np.isfinite(shaken.series[name]), 20.0 * np.sin(2.0 * t_s), np.nan)
    assert "motion_repeats" in {check.code for check in weigh(logs.analyse(shaken).evidence).against}


def test_streams_without_a_common_motion_are_refused() -> None:
    noise = streams(0.0, noise=1e4)
    with pytest.raises(FitError, match=r"B-SYNC-012: .*alike to"):
        logs.analyse(noise)
    noise.series["one_rate"][:] = 1.0
    with pytest.raises(FitError, match=r"B-SYNC-012: .*that move"):
        logs.analyse(noise)
    noise.campaign["columns"].clear()  # type: ignore[attr-defined]
    with pytest.raises(FitError, match=r"B-SYNC-012: .*no motion of the stream 'one'"):
        logs.analyse(noise)


def test_two_streams_in_one_file(tmp_path: Path) -> None:
    made = streams(0.0137).series
    made |= {"other_stamp": 1e3 * made["other_stamp"], "other_rate": np.radians(made["other_rate"])}
    rows = np.column_stack(
        [1.7e9 + made["t_s"], *(made[f"{k}_{n}"] for k in ("one", "other") for n in ("stamp", "rate"))]
    )
    offset = one(estimates_of(imported(tmp_path, STREAMS, table("row,a_t,a_w,b_t,b_w", rows))), "time_offset")
    assert offset.value == pytest.approx(0.0137, abs=offset.expanded_uncertainty + 1e-6)


@pytest.mark.real
def test_a_telephone_beside_a_camera_system() -> None:
    """github.com/panxkun/AlignTimeStamp: its authors find 2.675 s, where rotations over 1 s are alike to 0.9991."""
    names = ("data/phone_traj.txt", "tmp/phone_rotation_before.txt", "tmp/vicon_rotation_before.txt")
    poses, phone, camera = (
        np.loadtxt(of_mirror("panxkun+AlignTimeStamp", name).decode().splitlines()) for name in names
    )
    stamps = poses[:, 0]
    t_s = stamps[stamps - stamps[0] >= 1.0][: phone.size]
    columns = [
        {"name": name, "role": "motion", "stream": name, "of": "angle", "unit": "deg"} for name in ("one", "other")
    ]
    series = {"t_s": t_s, "one": np.degrees(camera), "other": np.degrees(phone)}
    log = Material((), {"uut": {"model": "m", "serial": "1"}, "columns": columns}, {}, series=series)
    assert logs.analyse(log).estimates[0].value == pytest.approx(2.675, abs=0.01)


UNITS = """\
mapping: pair
uut: {model: EGI and IMU, serial: S-1}
analysis: egi_offset
latency: {egi: 8 ms, imu: 0.8 ms, uncertainty: 1 ms}
overload: {values: [""]}
rates: mean
columns:
  received: {role: time, format: unix, unit: s}
  imu_stamp: {role: imu_stamp, unit: s}
  delta_angle_x: {role: delta_angle, axis: x, unit: rad/s}
  delta_angle_y: {role: delta_angle, axis: y, unit: rad/s}
  delta_angle_z: {role: delta_angle, axis: z, unit: rad/s}
  delta_velocity_x: {role: delta_velocity, axis: x, unit: m/s}
  delta_velocity_y: {role: delta_velocity, axis: y, unit: m/s}
  delta_velocity_z: {role: delta_velocity, axis: z, unit: m/s}
  egi_stamp: {role: egi_stamp, unit: s}
  latitude: {role: latitude, unit: deg}
  longitude: {role: longitude, unit: deg}
  height: {role: height, unit: m}
  velocity_north: {role: velocity, axis: north, unit: m/s}
  velocity_east: {role: velocity, axis: east, unit: m/s}
  velocity_down: {role: velocity, axis: down, unit: m/s}
  attitude_roll: {role: attitude, axis: roll, unit: deg}
  attitude_pitch: {role: attitude, axis: pitch, unit: deg}
  attitude_heading: {role: attitude, axis: heading, unit: deg}
  position_sigma: {role: position_sigma, unit: m}
"""
NAMES = [line.split(":")[0].strip() for line in UNITS.splitlines()[8:]]
AXES = {"velocity": ("north", "east", "down"), "attitude": ("roll", "pitch", "heading")}


def log_of(seed: int, *, instant: bool = False) -> dict[str, Array]:
    """Return one row for each frame of both units in the order in which they came, rates of turn in rad/s.

    ``instant``: rates of both triads at their stamps. They jump between two samples, where both ends show it.
    """
    recording = Recording(seed, path=Drive(turn_s=(6.0 + 0.5 * IMU_s, 14.0 + 0.5 * IMU_s)) if instant else TURNING)
    (row,) = recording.material().rows
    parts = []
    for unit, samples in (("imu", row.samples), ("egi", row.beside["egi"])):
        columns = {name: samples.scaled(name) for name in samples.columns if name not in ("tick", "mode", "status")}
        columns = {
            f"{name}_{axis}".rstrip("_"): column[:, at] if column.ndim > 1 else column
            for name, column in columns.items()
            for at, axis in enumerate(AXES.get(name, "xyz") if column.ndim > 1 else ("",))
        }
        if unit == "imu" and instant:
            edges_s = np.arange(len(samples) + 1) * IMU_s / (1.0 + IMU_CLOCK)
            means, ends = recording.path.integrals(edges_s), recording.path.felt(edges_s[1:])
            for name, mean, end in zip(("delta_velocity", "delta_angle"), means, ends, strict=True):
                for at, axis in enumerate("xyz"):
                    columns[f"{name}_{axis}"] += IMU_s * end[:, at] - mean[:, at]
        columns[f"{unit}_stamp"] = samples.columns["tick"].astype(np.float64) * 1e-7
        parts.append((samples.t_ns * 1e-9, columns))
    rates = ("delta_angle", "delta_velocity") if instant else "delta_angle"
    received_s = np.concatenate([part[0] for part in parts])
    order = np.argsort(received_s, kind="stable")
    series = {"t_s": received_s[order]}
    for name in NAMES:
        pieces = [columns.get(name, np.full(at_s.size, np.nan)) for at_s, columns in parts]
        series[name] = np.concatenate(pieces)[order] * (1.0 / IMU_s if name.startswith(rates) else 1.0)
    return series


def material(seed: int, said: str = "mean", *, instant: bool = False) -> Material:
    """Return the log as an import hands it on, in base units."""
    units = re.sub("(delta_velocity.*m/s)", r"\g<1>2", UNITS) if instant else UNITS
    campaign = parsed(units.replace("rates: mean", f"rates: {said}")).campaign()
    series: dict[str, Any] = log_of(seed, instant=instant)
    for axis in "xyz":
        series[f"delta_angle_{axis}"] = np.degrees(series[f"delta_angle_{axis}"])
    return Material((), campaign, {}, series=series)


def test_the_offset_is_that_which_the_log_was_made_with() -> None:
    analysis = egi_log.analyse(material(6))
    offsets = every(analysis, "time_offset")
    assert len(offsets) == 2
    for offset in offsets:
        assert offset.value == pytest.approx(OFFSET_s, abs=1.5 * offset.expanded_uncertainty)
        assert offset.expanded_uncertainty < 5e-3
    stamps = one(analysis, "time_offset_from_stamps")
    assert stamps.value == pytest.approx(OFFSET_s, abs=1.5 * stamps.expanded_uncertainty)
    assert weigh(analysis.evidence).against == []


@pytest.mark.parametrize("seed", range(3))
def test_rates_at_their_stamps_give_the_offset_that_they_say(seed: int) -> None:
    """Taken for means they put it half a sample off."""
    right, wrong = (egi_log.analyse(material(seed, said, instant=True)) for said in ("instant", "mean"))
    assert "at their stamp" in right.notes[0]
    assert weigh(right.evidence).against == []
    for offset, other in zip(every(right, "time_offset"), every(wrong, "time_offset"), strict=True):
        assert offset.value == pytest.approx(OFFSET_s, abs=1.5 * offset.expanded_uncertainty)
        assert abs(other.value - offset.value) == pytest.approx(0.5 * IMU_s, rel=0.1)


def test_a_log_comes_back_from_its_session(tmp_path: Path) -> None:
    series = {name: column[:400] for name, column in log_of(5).items()}
    log = table(",".join(["received", *NAMES]), zip(*series.values(), strict=True))
    read = columns_of(imported(tmp_path, UNITS.replace("analysis: egi_offset\n", ""), log))
    np.testing.assert_array_equal(read["latitude"], series["latitude"])
    np.testing.assert_allclose(read["delta_angle_z"], np.degrees(series["delta_angle_z"]), rtol=1e-14)


def test_too_few_rows_of_a_unit_are_refused() -> None:
    log = material(5)
    log.series["height"][:] = np.nan
    with pytest.raises(FitError, match="B-SYNC-014: 0 rows of the log hold egi_stamp"):
        egi_log.analyse(log)


@pytest.mark.parametrize(
    ("mapping", "old", "new", "said"),
    [
        (STREAMS, "of: rate, unit: rad/s", "of: yaw, unit: rad/s", "the same 'of'"),
        (STREAMS, "of: rate, unit: rad/s", "of: rate, unit: g", "the same 'of'"),
        (STREAMS, "unit: ms", "unit: mV", "needs a unit of time"),
        (STREAMS, "motion, stream: one", "movement, stream: one", "'time', 'stamp', 'motion', 'temperature'"),
        (STREAMS, "stream: other, unit: ms", "stream: two, unit: ms", "stream"),
        (UNITS, "  height: {role: height, unit: m}\n", "", "needs columns of the role height in units of m"),
        (UNITS, "attitude, axis: heading", "attitude, axis: x", "attitude, axes roll, pitch, heading,"),
        (UNITS, "delta_angle, axis: z, unit: rad/s", "delta_angle, axis: z, unit: rad", "in units of deg or deg/s"),
        (UNITS, "rates: mean\n", "", "such as delta_angle_x, need 'rates: mean' where a value is the mean"),
        (UNITS, "role: latitude", "role: motion, stream: one", "it takes: time, imu_stamp, delta_angle"),
    ],
)
def test_mistakes_of_a_mapping_are_named(mapping: str, old: str, new: str, said: str) -> None:
    assert mapping.count(old) == 1
    with pytest.raises(InputErrors, match=said):
        parsed(mapping.replace(old, new))


Floats = Any
LATENCY_s = 0.008
COUNTER = np.arange(3000)


def port(
    seed: int,
    interval_s: float = 0.02,
    ppm: float = 10.0,
    jitter_s: float = 3e-4,
    poll_ns: int = 1_000_000,
    duration_s: float = 60.0,
    tag_noise: float = 1e-5,
) -> tuple[Floats, Floats, Floats, Floats, float]:
    """Tags, counter, receive stamps (s, ns) of a unit, and bench time minus tag at tag 0."""
    rng = np.random.default_rng(seed)
    own_s = np.arange(round(duration_s / interval_s)) * interval_s
    begin_s = 100.0 + float(rng.uniform(0.0, 0.02))
    arrived_s = begin_s + own_s / (1.0 + 1e-6 * ppm) + LATENCY_s
    if jitter_s:
        arrived_s = arrived_s + rng.exponential(jitter_s, own_s.size)
    ns = np.rint(arrived_s * 1e9).astype(np.int64)
    if poll_ns:
        ns = -(-ns // poll_ns) * poll_ns
    return own_s + tag_noise * rng.standard_normal(own_s.size), np.arange(own_s.size), ns * 1e-9, ns, begin_s


def fitted(seed: int, **kinds: Any) -> tuple[port_clocks.PortClock, float]:
    """Clock of a unit and the true least delay in the middle."""
    tags_s, counter, stamps_s, ns, begin_s = port(seed, **kinds)
    found = port_clocks.port_clock(tags_s, counter, stamps_s, grid_s(ns))
    rate = 1.0 / (1.0 + 1e-6 * kinds.get("ppm", 10.0)) - 1.0
    return found, begin_s + LATENCY_s + rate * found.at_s


@pytest.mark.parametrize(
    "kinds",
    [{}, {"interval_s": 0.005}, {"poll_ns": 0}, {"jitter_s": 1e-3}, {"ppm": -40.0}],
    ids=["polled", "fast", "fine stamps", "much jitter", "slow clock"],
)
@pytest.mark.validates(
    "intervals of rate and least delay of a port's clock",
    against="simulated ports whose clock and least delay are known: polled, fine, with much jitter",
)
def test_intervals_cover_rate_and_offset(kinds: dict[str, Any]) -> None:
    z = []
    for seed in range(6):
        found, true_s = fitted(seed, **kinds)
        rate = 1.0 / (1.0 + 1e-6 * kinds.get("ppm", 10.0)) - 1.0
        z.append(((found.delay_s - true_s) / found.std_s(found.at_s), (found.rate - rate) / found.rate_std))
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert (rms < 2.0).all(), rms
    assert np.abs(z).max() < 4.0


def test_fine_stamps_tell_as_much_as_the_least_delays_let_them() -> None:
    for seed in range(3):
        found, true_s = fitted(seed, poll_ns=0)
        assert found.grid_s == 0.0
        assert 1e-6 < found.std_s(found.at_s) < 6e-6  # the least of 125 delays of 0.3 ms each; no noise of the tags
        assert found.delay_s == pytest.approx(true_s, abs=2e-6)
        assert found.rate_std < 1e-7
        assert found.std_s(found.at_s + 30.0) == pytest.approx(np.hypot(found.std_s(found.at_s), 30.0 * found.rate_std))


def test_noise_of_the_tags_is_taken_for_no_place_within_a_step() -> None:
    """Clocks that are hardly off keep their place within a step of the bench; seeds 60 to 71."""
    rng, z = np.random.default_rng(60), []
    for seed in range(60, 72):
        ppm = float(rng.uniform(-3.0, 3.0))
        found, true_s = fitted(seed, interval_s=0.005, ppm=ppm, tag_noise=9e-5)
        z.append((found.delay_s - true_s) / found.std_s(found.at_s))
        assert found.tag_noise_s == pytest.approx(9e-5, rel=0.1)
    assert np.sqrt(np.mean(np.square(z))) < 1.6


def test_tags_of_a_clock_that_does_not_run_evenly_stay_as_they_are() -> None:
    tags_s, counter, *_ = port(3, tag_noise=3e-4)
    np.testing.assert_array_equal(port_clocks.even_tags_s(tags_s, counter), tags_s)


@pytest.mark.parametrize("step_s", [0.0, 1e-3])
def test_what_is_expected_of_a_clock_is_what_ports_state(step_s: float) -> None:
    """Root mean squares over the rates that a clock may have; seeds 100 to 139."""
    rng, stated = np.random.default_rng(100), []
    for seed in range(100, 140):
        found, _ = fitted(seed, ppm=float(rng.uniform(-20.0, 20.0)), poll_ns=round(1e9 * step_s))
        stated.append((found.rate_std, found.std_s(found.at_s), found.jitter_std_s))
    due = port_clocks.expected_clock(np.arange(0.0, 60.0, 0.02), port_clocks.StampNoise(3e-4, 20e-6), step_s)
    rms = np.sqrt(np.mean(np.square(stated), axis=0))
    assert rms == pytest.approx([due.rate_std, due.std_s(due.at_s), due.jitter_std_s], rel=0.2)


def test_without_jitter_the_step_is_the_uncertainty() -> None:
    z, stds = [], []
    for seed in range(6):
        tags_s, counter, stamps_s, ns, begin_s = port(seed, jitter_s=0.0)
        other = port(seed + 50, interval_s=0.005)[3]
        found = port_clocks.port_clock(tags_s, counter, stamps_s, grid_s(np.concatenate((ns, other))))
        rate = 1.0 / (1.0 + 1e-5) - 1.0
        z.append((found.delay_s - begin_s - LATENCY_s - rate * found.at_s) / found.std_s(found.at_s))
        stds.append(found.std_s(found.at_s))
    assert min(stds) > 2e-4
    assert np.sqrt(np.mean(np.square(z))) < 1.8


@pytest.mark.validates(
    "line below all delays of a port",
    against="the same problem solved by scipy's linear program",
)
def test_line_below_is_that_of_a_linear_program() -> None:
    """The same problem by a general solver: least sum of distances, no point below the line."""
    rng = np.random.default_rng(4)
    place = np.sort(rng.uniform(-1.0, 1.0, 300))
    delay_s = 0.3 - 0.1 * place + rng.exponential(0.2, 300)
    best = optimize.linprog(
        [-300.0, -place.sum()], A_ub=np.stack([np.ones(300), place], axis=1), b_ub=delay_s, bounds=[(None, None)] * 2
    )
    assert port_clocks.line_below(place, delay_s) == pytest.approx(tuple(best.x), abs=1e-9)


def test_difference_of_two_ports() -> None:
    """Offset and drift between two units, latencies taken off; positive = the first is ahead."""
    one, _ = fitted(2, ppm=13.0)
    other, _ = fitted(3, ppm=10.0, interval_s=0.005)
    begins = port(2)[4], port(3)[4]
    found = port_clocks.clock_difference(one, other, 30.0, latency_s=0.0, latency_std_s=1e-3)
    assert found.drift == pytest.approx(3e-6, abs=3.0 * found.drift_std)
    stamps_std_s = np.hypot(one.std_s(30.0), other.std_s(30.0))
    assert found.offset_s == pytest.approx(begins[1] - begins[0] + 30.0 * 3e-6, abs=4.0 * stamps_std_s)
    assert found.std_s == pytest.approx(np.hypot(stamps_std_s, 1e-3))


@pytest.mark.parametrize("step_s", [0.0006, -3.0, 0.05])
def test_a_step_of_the_clock_is_found(step_s: float) -> None:
    tags_s, counter, *_ = port(5)
    tags_s[1234:] += step_s
    assert stamps.first_step(tags_s, counter) == 1234


def test_lost_frames_are_no_step_and_too_few_tell_nothing() -> None:
    tags_s, counter, *_ = port(5)
    keep = np.random.default_rng(1).random(tags_s.size) > 0.3
    assert stamps.first_step(tags_s[keep], counter[keep]) is None
    assert stamps.first_step(tags_s[:2], counter[:2]) is None
    assert stamps.tag_noise_s(np.arange(20.0), np.arange(0, 40, 2)) == 0.0  # no two frames in a row
    tags_s, counter, stamps_s, *_ = port(1, duration_s=2.0)
    with pytest.raises(FitError, match=r"B-SYNC-009.*100 frames"):
        port_clocks.port_clock(tags_s, counter, stamps_s)


def smooth(seed: int = 1) -> Floats:
    at = COUNTER / 50.0
    clean = np.stack([100.0 * at, np.sin(at), np.where(at > 30.0, 7.0 * (at - 30.0), 0.0)], axis=1)
    return np.asarray(clean + 1e-3 * np.random.default_rng(seed).standard_normal(clean.shape))


@pytest.mark.parametrize("size", [0.2, 10.0, 1e6])
@pytest.mark.parametrize("at", [2, 700, 2997])
def test_one_bad_reading_is_found(size: float, at: int) -> None:
    values = smooth()
    values[at, 1] += size
    assert off_course(values, COUNTER).tolist() == [at]


def test_three_of_three_thousand_are_found_and_not_a_fourth() -> None:
    values = smooth()
    values[[100, 900, 1700, 2500], 0] += [40.0, 30.0, 20.0, 10.0]
    assert off_course(values, COUNTER).tolist() == [100, 900, 1700]


def test_no_reading_of_a_kink_a_step_or_a_gap_is_bad_and_few_are_not_judged() -> None:
    for seed in range(200):
        assert off_course(smooth(seed), COUNTER).size == 0
    stepped, beside, counter = smooth(), smooth(), COUNTER.copy()
    stepped[1000:, 0] += 5.0
    beside[1001] += 50.0
    counter[1000:] += 5
    for values, numbers in ((stepped, COUNTER), (beside, counter), (smooth()[:40], COUNTER[:40])):
        assert off_course(values, numbers).size == 0
