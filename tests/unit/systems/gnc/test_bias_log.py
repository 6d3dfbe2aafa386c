"""Analysis bias_log: noise made of known coefficients, gaps, a unit that is moved; a recording of ten minutes at rest
whose means and scatter its author published.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
from pathlib import Path

import allantools
import numpy as np
import pytest
from numpy.typing import NDArray
from spoken import english_left

from bench.analysis import Analysis, Material
from bench.analysis.doubt import weigh
from bench.commands.import_log import import_log
from bench.model.errors import FitError, InputErrors
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.replay.series import replay_series
from bench.systems.gnc.logs import bias

Array = NDArray[np.float64]
RATE_Hz, WALK = 50.0, 0.02  # deg/s/sqrt(Hz): 1.2 deg/sqrt(h)
MIRROR = Path(os.environ.get("BENCH_CAPTURES", "/nowhere")) / "sunsided+sensor-fusion" / "repo"
TEN_MINUTES = "data/set-2/unmoved-with-x-pointing-forward-10min"
MAPPING = Path(__file__).resolve().parents[4] / "docs" / "mappings" / "mpu6050_at_rest.yaml"


def material(values: Array, t_s: Array, role: str = "gyro", unit: str = "deg/s") -> Material:
    columns = [{"name": "v", "role": role, "axis": "x", "unit": unit}]
    campaign = {"uut": {"model": "m", "serial": "1"}, "columns": columns}
    return Material((), campaign, {}, series={"t_s": t_s, "v": values})


def noise(seconds: float = 1200.0, walk: float = 0.0) -> tuple[Array, Array]:
    """White noise of the density WALK, and a random walk of the rate, deg/s/sqrt(s)."""
    rng = np.random.default_rng(12)
    t_s = np.arange(0.0, seconds, 1.0 / RATE_Hz)
    drift = np.cumsum(rng.normal(0.0, walk / np.sqrt(RATE_Hz), t_s.size))
    return t_s, 0.5 + rng.normal(0.0, WALK * np.sqrt(RATE_Hz), t_s.size) + drift


def entry(analysis: Analysis, quantity: str) -> tuple[float, float, str]:
    (found,) = [one for one in analysis.estimates if one["quantity"] == quantity]
    return found["value"], found["expanded_uncertainty"], found["unit"]


def test_white_noise_is_the_angle_random_walk_it_was_made_of() -> None:
    t_s, values = noise()
    analysis = bias.analyse(material(values, t_s))
    assert english_left(analysis) == set()
    value, wide, unit = entry(analysis, "angle_random_walk")
    assert unit == "deg/sqrt(h)"
    assert value == pytest.approx(60.0 * WALK, abs=1.5 * wide)
    assert wide < 0.05 * value
    mean, wide, unit = entry(analysis, "mean_output")
    assert (unit, mean) == ("deg/h", pytest.approx(1800.0, abs=1.5 * wide))
    assert wide == pytest.approx(1.96 * 3600.0 * WALK / np.sqrt(1200.0), rel=0.1)
    stability, wide, _ = entry(analysis, "bias_stability")
    assert stability == pytest.approx(3600.0 * WALK / np.sqrt(10.0), abs=1.5 * wide)
    assert weigh(analysis.evidence).against == []
    tau_s, deviation, _, _ = allantools.oadev(values, rate=RATE_Hz, data_type="freq", taus=[1.0])
    assert tau_s == [1.0]
    assert 60.0 * deviation[0] == pytest.approx(entry(analysis, "angle_random_walk")[0], rel=0.05)


def test_a_walk_of_the_rate_shows_beside_it() -> None:
    t_s, values = noise(walk=0.004)
    value, wide, unit = entry(bias.analyse(material(values, t_s)), "rate_random_walk")
    assert unit == "deg/h/sqrt(h)"
    assert value == pytest.approx(0.004 * 3600.0 * 60.0, abs=1.5 * wide)


def test_a_gap_shifts_nothing_and_is_named() -> None:
    t_s, values = noise()
    keep = np.ones(t_s.size, bool)
    keep[20_000:21_000] = False
    analysis = bias.analyse(material(values[keep], t_s[keep]))
    value, wide, _ = entry(analysis, "angle_random_walk")
    assert value == pytest.approx(60.0 * WALK, abs=1.5 * wide)
    assert any("1000 samples are missing in 1 gaps" in note for note in analysis.notes)


def test_an_accelerometer_keeps_its_unit() -> None:
    t_s, values = noise(400.0)
    analysis = bias.analyse(material(values, t_s, "accelerometer", "m/s2"))
    value, wide, unit = entry(analysis, "velocity_random_walk")
    assert (unit, value) == ("m/s2*s^0.5", pytest.approx(WALK, abs=1.5 * wide))


def test_a_unit_that_is_moved_or_hangs_is_doubted() -> None:
    t_s, values = noise(400.0)
    moved, hung = values.copy(), values.copy()
    moved[5000:5050] += 20.0 * np.sin(np.arange(50))
    hung[5000:6000] = hung[5000]
    for samples, code in ((moved, "not_at_rest"), (hung, "stands_still")):
        assert code in {one.code for one in weigh(bias.analyse(material(samples, t_s)).evidence).against}


def test_what_the_analysis_needs() -> None:
    t_s, values = noise(10.0)
    with pytest.raises(FitError, match="B-GNC-006"):
        bias.analyse(material(values, t_s, "temperature"))
    text = MAPPING.read_text(encoding="utf-8")
    other = text.replace("role: gyro, axis: x", "role: magnetometer, axis: x")
    with pytest.raises(InputErrors, match="'magnetometer' is no role of the analysis 'bias_log'"):
        parse_yaml(other, "m.yaml", mapping_model())
    none = text[: text.index("  gyroBuffer[1]")]
    with pytest.raises(InputErrors, match="needs a column of the role gyro or accelerometer"):
        parse_yaml(none, "m.yaml", mapping_model())


@pytest.mark.real
@pytest.mark.skipif(not MIRROR.is_dir(), reason=f"no {MIRROR}: name the folder of its copy in BENCH_CAPTURES")
def test_ten_minutes_of_a_real_gyroscope(tmp_path: Path) -> None:
    """github.com/sunsided/sensor-fusion: a MATLAB 7.3 file, and means and scatter as its author computed them."""

    def file(name: str) -> bytes:
        shown = subprocess.run(
            ["git", "-C", MIRROR, "show", f"HEAD:{TEN_MINUTES}/{name}"], capture_output=True, check=True
        )
        return shown.stdout

    (tmp_path / "gyro.mat").write_bytes(file("mpu6050_gyroscope.mat"))
    assert import_log(MAPPING, tmp_path / "gyro.mat", tmp_path / "out") == 0
    (results,) = (tmp_path / "out").glob("*/results.json")
    found = json.loads(results.read_text(encoding="utf-8"))["estimates"]
    series = replay_series(results.parent)
    stated = {
        row["axis"].lower(): row
        for row in csv.DictReader(file("sensor-stats.csv").decode().splitlines())
        if row["type"] == "gyroscope"
    }
    for axis, row in stated.items():
        samples = series.columns[f"gyro_{axis}_deg_s"]
        assert samples.size == int(row["count"])
        assert np.std(samples, ddof=1) == pytest.approx(float(row["v_std_dev"]), rel=1e-5)
        (mean,) = [e["value"] for e in found if e["quantity"] == "mean_output" and e["conditions"]["axis"] == axis]
        assert mean / 3600.0 == pytest.approx(float(row["v_mean"]), rel=1e-5)
