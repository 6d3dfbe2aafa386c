"""Analysis stream_offset: two streams made of one formula with a known offset, one in the rows between the other's; and
a telephone beside a camera system, whose offset its authors found by the largest correlation.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.analysis import Material
from bench.analysis.doubt import weigh
from bench.commands.import_log import import_log
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError, InputErrors
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.systems.time_sync import logs
from bench.systems.time_sync.estimators.common_motion import BLOCKS, common_motion

Array = NDArray[np.float64]
MAPPING = """\
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
MIRROR = Path(os.environ.get("BENCH_CAPTURES", "/nowhere")) / "panxkun+AlignTimeStamp" / "repo"


def rate(t_s: Array) -> Array:
    """Three turns at uneven times, deg/s."""
    return sum(
        size * np.exp(-(((t_s - at) / wide) ** 2)) for size, at, wide in ((30, 12, 2), (-20, 31, 3), (12, 47, 1))
    )


def material(offset_s: float, noise: float = 0.2, epoch_s: float = 0.0, seed: int = 4, drift: float = 0.0) -> Material:
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
    analysis = logs.analyse(material(offset_s, epoch_s=epoch_s))
    (entry,) = [one for one in analysis.estimates if one["quantity"] == "time_offset"]
    assert entry["value"] - epoch_s == pytest.approx(offset_s, abs=3.0 * entry["std_uncertainty"] + 1e-6)
    assert entry["std_uncertainty"] < 1e-3
    assert {figure.y_label for figure in analysis.figures} == {"signal, deg/s"}
    assert weigh(analysis.evidence).against == []
    assert analysis.tables[0].headers[1] == ("offset, s" if epoch_s else "offset, ms")


def test_intervals_hold_the_offset_as_often_as_they_say() -> None:
    """Sixty logs of other noise: an interval of 95 % may miss in 8 of them at most, by the binomial law to 1 %."""
    entries = [logs.analyse(material(0.0137, seed=seed)).estimates[0] for seed in range(60)]
    errors = np.array([entry["value"] - 0.0137 for entry in entries])
    expanded = np.array([entry["expanded_uncertainty"] for entry in entries])
    assert np.count_nonzero(np.abs(errors) > expanded) <= 8
    assert 0.6 < np.std(errors) / np.mean([entry["std_uncertainty"] for entry in entries]) < 1.5


def test_intervals_of_the_halves_hold_it_too_and_their_difference_is_no_drift() -> None:
    """Few blocks of a half hold motion: by blocks alone 11 of 60 missed, and the score of the halves was 1.8."""
    each = [common_motion(*streams["one"], *streams["other"]) for streams, _ in
            (logs._streams(material(0.0137, seed=seed)) for seed in range(60))]  # fmt: skip
    errors, std_s = (np.array([getattr(one, name) for one in each]) for name in ("halves_s", "halves_std_s"))
    missed = np.count_nonzero(np.abs(errors - 0.0137) > coverage_factor(BLOCKS - 1) * std_s, axis=0)
    assert missed.max() <= 8
    scores = np.diff(errors, axis=1)[:, 0] / np.hypot(*std_s.T)
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.4


def test_a_clock_that_drifts_and_a_motion_that_repeats_are_doubted() -> None:
    drifting = weigh(logs.analyse(material(0.0, drift=2e-3)).evidence)
    assert [one.code for one in drifting.against] == ["offset_changes"]
    shaken = material(0.1)
    for name in ("one_rate", "other_rate"):
        t_s = shaken.series["t_s"]
        shaken.series[name][:] = np.where(np.isfinite(shaken.series[name]), 20.0 * np.sin(2.0 * t_s), np.nan)
    assert "motion_repeats" in {one.code for one in weigh(logs.analyse(shaken).evidence).against}


def test_streams_without_a_common_motion_are_refused() -> None:
    noise = material(0.0, noise=1e4)
    with pytest.raises(FitError, match=r"B-SYNC-012: .*alike to"):
        logs.analyse(noise)
    noise.series["one_rate"][:] = 1.0
    with pytest.raises(FitError, match=r"B-SYNC-012: .*that move"):
        logs.analyse(noise)
    noise.campaign["columns"].clear()  # type: ignore[attr-defined]
    with pytest.raises(FitError, match=r"B-SYNC-012: .*no motion of the stream 'one'"):
        logs.analyse(noise)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("of: rate, unit: rad/s", "of: yaw, unit: rad/s", "the same 'of'"),
        ("of: rate, unit: rad/s", "of: rate, unit: g", "the same 'of'"),
        ("unit: ms", "unit: mV", "needs a unit of time"),
        (
            "role: motion, stream: one, of",
            "role: movement, stream: one, of",
            "'time', 'stamp', 'motion', 'temperature'",
        ),
        ("stream: other, unit: ms", "stream: two, unit: ms", "stream"),
    ],
)
def test_mistakes_of_a_mapping_are_named(old: str, new: str, said: str) -> None:
    with pytest.raises(InputErrors) as raised:
        parse_yaml(MAPPING.replace(old, new), "m.yaml", mapping_model())
    assert said in str(raised.value)


def test_two_streams_in_one_file(tmp_path: Path) -> None:
    made = material(0.0137)
    rows = [
        f"{1.7e9 + t_s:.4f}," + ",".join("" if np.isnan(value) else repr(float(value)) for value in values)
        for t_s, *values in zip(
            made.series["t_s"], made.series["one_stamp"], made.series["one_rate"],
            1e3 * made.series["other_stamp"], np.radians(made.series["other_rate"]), strict=True,
        )
    ]  # fmt: skip
    (tmp_path / "log.csv").write_text("\n".join(["row,a_t,a_w,b_t,b_w", *rows]))
    (tmp_path / "m.yaml").write_text(MAPPING)
    assert import_log(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    (results,) = (tmp_path / "out").glob("*/results.json")
    offset = json.loads(results.read_text())["estimates"][0]
    assert offset["value"] == pytest.approx(0.0137, abs=offset["expanded_uncertainty"] + 1e-6)


@pytest.mark.real
@pytest.mark.skipif(not MIRROR.is_dir(), reason=f"no {MIRROR}: name the folder of its copy in BENCH_CAPTURES")
def test_a_telephone_beside_a_camera_system() -> None:
    """github.com/panxkun/AlignTimeStamp: its authors find 2.675 s, where rotations over 1 s are alike to 0.9991."""

    def file(name: str) -> Array:
        shown = subprocess.run(["git", "-C", MIRROR, "show", f"HEAD:{name}"], capture_output=True, check=True)
        return np.loadtxt(shown.stdout.decode().splitlines())

    stamps = file("data/phone_traj.txt")[:, 0]
    phone, camera = file("tmp/phone_rotation_before.txt"), file("tmp/vicon_rotation_before.txt")
    t_s = stamps[stamps - stamps[0] >= 1.0][: phone.size]
    columns = [
        {"name": name, "role": "motion", "stream": name, "of": "angle", "unit": "deg"} for name in ("one", "other")
    ]
    log = Material(
        (), {"uut": {"model": "m", "serial": "1"}, "columns": columns}, {},
        series={"t_s": t_s, "one": np.degrees(camera), "other": np.degrees(phone)},
    )  # fmt: skip
    entry = logs.analyse(log).estimates[0]
    assert entry["value"] == pytest.approx(2.675, abs=0.01)
