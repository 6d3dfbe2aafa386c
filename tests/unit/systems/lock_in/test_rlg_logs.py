"""Imported logs of ring lasers: edges of ``laser_physics``, and counts of a rate with known noise."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import doubt_lock_in as worlds
import numpy as np
import pytest
from imported_logs import columns_of, estimates_of, imported, parsed, table
from laser_physics import World
from numpy.typing import NDArray
from one_estimate import every, one

from bench.analysis import Material, noise_evidence, weigh
from bench.maths.long_terms import noise_at_rest
from bench.model.errors import FitError, InputErrors
from bench.systems.lock_in import edge_log
from bench.systems.lock_in.records import laser_records

Array = NDArray[np.float64]
EDGES = """\
mapping: edges
uut: {model: RLG, serial: S-1}
analysis: rlg_edge_log
laser: {path_length: 15 cm, latitude: 37 deg}
overload: {values: [""]}
columns:
  t: {role: time, format: elapsed, unit: ns, start: 2024-01-01T00:00:00Z}
  a: {role: beat}
  b: {role: cosine}
  dither: {role: pickoff}
"""
COLUMNS = ("t_s", "beat", "cosine", "pickoff")


def edges(seconds: float) -> tuple[dict[str, Array], dict[tuple[str, str], float]]:
    """Return one row for each edge, of the beat or of the pick-off, and the truth."""
    made = worlds.simulated(11, World(seconds=seconds))
    (stretch,) = laser_records(made.material)[0].events().stretches
    beats, pickoffs = stretch.ticks.size, stretch.pickoff_ticks.size
    nothing = np.full(pickoffs, np.nan)
    rows = np.column_stack((
        np.concatenate((stretch.ticks, stretch.pickoff_ticks)) / 20e6,
        np.concatenate((stretch.rising, nothing)),
        np.concatenate((stretch.cosine, nothing)),
        np.concatenate((np.full(beats, np.nan), stretch.pickoff_rising)),
    ))  # fmt: skip
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    rows[:, 0] -= rows[0, 0]
    return dict(zip(COLUMNS, rows.T, strict=True)), made.truths


def material(series: dict[str, Array]) -> Material:
    laser = {"path_length_m": 0.15, "latitude_deg": 37.0}
    return Material((), {"uut": {"model": "m", "serial": "1"}, "laser": laser}, {}, series=series)


def test_lock_in_and_random_walks_are_those_it_was_made_of() -> None:
    series, truths = edges(2.0)
    analysis = edge_log.analyse(material(series))
    found = {(entry.quantity, entry.conditions.get("method", "")): entry for entry in analysis.estimates}
    compared = [key for key in found if key in truths and key[0] in ("lock_in_rate", "backscatter_phase")]
    compared += [("angle_random_walk", method) for method in ("raw", "global_constants")]
    assert len(compared) == 4
    for key in compared:
        assert found[key].value == pytest.approx(truths[key], abs=1.5 * found[key].expanded_uncertainty), key
    assert found["angle_random_walk", "raw"].conditions["clock_Hz"] == 20e6  # of the steps between stamps
    assert analysis.missing == []


def test_rows_that_are_no_edges_are_refused() -> None:
    series, _ = edges(0.1)
    for name, value in (("beat", 0.5), ("beat", np.nan), ("pickoff", 1.0)):
        wrong = {key: column.copy() for key, column in series.items()}
        wrong[name][np.flatnonzero(np.isfinite(series["beat"]))[3]] = value
        with pytest.raises(FitError, match=r"B-RLG-009: 1 of .* rows are no edges"):
            edge_log.analyse(material(wrong))
    series["pickoff"][:] = np.nan
    kept = np.isfinite(series["beat"])
    with pytest.raises(FitError, match=r"B-RLG-007: .* 0 of the dither pick-off"):
        edge_log.analyse(material({key: column[kept] for key, column in series.items()}))


def test_a_log_of_edges_comes_back_from_its_session(tmp_path: Path) -> None:
    series, _ = edges(0.05)
    rows = zip(np.round(1e9 * series["t_s"]), *(series[name] for name in COLUMNS[1:]), strict=True)
    log = table("t,a,b,dither", rows, "%.0f")
    read = columns_of(imported(tmp_path, EDGES.replace("analysis: rlg_edge_log\n", ""), log))
    for name in COLUMNS:
        np.testing.assert_array_equal(np.round(read[name], 9), np.round(series[name], 9))
    assert parsed(EDGES).campaign()["laser"] == pytest.approx({"path_length_m": 0.15, "latitude_deg": 37.0})


COUNTS = """\
mapping: ring_laser
uut: {model: RLG, serial: S-1}
analysis: rlg_count_log
count_scale: 1.11 arcsec
columns:
  row: {role: time, format: rows, rate: 10 Hz, start: 2024-01-01T00:00:00Z}
  n: {role: count}
"""
WALK, RATE_deg_h, SCALE_arcsec = 0.02, 9.7, 1.11  # deg/sqrt(h)


def counts() -> Array:
    """Two hours at 10 Hz: the angle is a drift of the Earth's rate and a random walk, floored to counts."""
    rng = np.random.default_rng(30)
    step_s, count = 0.1, 72_000
    walk_arcsec = 3600.0 * WALK / 60.0 * np.sqrt(step_s)  # deg/sqrt(h) is 60 arcsec/sqrt(s)
    angle = np.cumsum(RATE_deg_h * step_s + rng.normal(0.0, walk_arcsec, count))
    return np.floor(angle / SCALE_arcsec)


def counted(folder: Path, mapping: str, values: Array) -> list[dict[str, Any]]:
    return estimates_of(imported(folder, mapping, table("n", values[:, None], "%d")))


@pytest.mark.parametrize("role", ["count", "count_increment"])
def test_rate_walk_and_quantisation_are_those_it_was_made_of(role: str, tmp_path: Path) -> None:
    values = counts() if role == "count" else np.diff(counts())
    stated = COUNTS + "laser: {path_length: 28 cm, latitude: 37 deg}\n"
    found = counted(tmp_path, stated.replace("role: count", f"role: {role}"), values)
    walk, rate, steps = (one(found, name) for name in ("angle_random_walk", "mean_rate", "quantisation_noise"))
    assert walk.value == pytest.approx(WALK, abs=1.5 * walk.expanded_uncertainty)
    assert walk.expanded_uncertainty < 0.1 * WALK
    assert rate.value == pytest.approx(RATE_deg_h, abs=1.5 * rate.expanded_uncertainty)
    assert steps.value == pytest.approx(SCALE_arcsec / np.sqrt(12.0), rel=0.05)  # a uniform error of one count
    assert every(found, "bias_alignment_error") == []  # a random walk alone states no bias


def flicker(count: int, seed: int) -> Array:
    """Noise of the two-sided density B^2 / (2 pi f), B = 1: half an integral of unit white noise (Hosking, Kasdin)."""
    lags = np.arange(1, 2 * count)
    weights = np.concatenate(([1.0], np.cumprod((lags - 0.5) / lags)))
    white = np.random.default_rng(seed).normal(0.0, 1.0, 2 * count)
    size = 4 * count
    return np.fft.irfft(np.fft.rfft(weights, size) * np.fft.rfft(white, size), size)[count : 2 * count]


def test_the_bias_leaves_an_alignment_error_where_the_log_shows_one(tmp_path: Path) -> None:
    """Against the heading of two level gyroscopes that the Earth turns, one of them with this bias."""
    bias_deg_h, latitude_deg, step_s = 0.5, 37.0, 0.1
    rate = RATE_deg_h + bias_deg_h * flicker(2**16, 4)  # deg/h, arcsec/s alike
    values = np.floor(np.cumsum(rate * step_s) / 0.001)
    mapping = COUNTS.replace("1.11 arcsec", "0.001 arcsec")
    stated = mapping + f"laser: {{path_length: 28 cm, latitude: {latitude_deg:g} deg}}\n"
    found = counted(tmp_path, stated, values)
    bias, error = one(found, "bias_instability"), one(found, "bias_alignment_error")
    assert bias.value == pytest.approx(bias_deg_h, abs=1.5 * bias.expanded_uncertainty)
    level_deg_h = 15.041 * np.cos(np.deg2rad(latitude_deg))
    north, east = level_deg_h, bias.value  # of a unit that points north
    assert error.value == pytest.approx(np.rad2deg(np.arctan2(east, north)), rel=2e-3)
    assert error.std_uncertainty / error.value == pytest.approx(bias.std_uncertainty / bias.value)


def test_a_mean_rate_counts_a_drift_and_a_walk_leaves_out_a_resonance(tmp_path: Path) -> None:
    rng = np.random.default_rng(31)
    white, at_s = rng.normal(0.0, 1.0, 40_000), 0.1 * np.arange(40_000)
    mapping = COUNTS.replace("1.11 arcsec", "0.001 arcsec")

    def found(name: str, rate: Array) -> list[dict[str, Any]]:
        (tmp_path / name).mkdir()
        return counted(tmp_path / name, mapping, np.floor(np.cumsum(rate * 0.1) / 0.001))

    drifting = found("drift", white + np.linspace(-0.2, 0.2, white.size))
    mean = one(drifting, "mean_rate")
    assert 0.1 < mean.expanded_uncertainty < 1.0  # white noise alone: 0.01
    ramp = one(drifting, "rate_ramp")
    assert ramp.value == pytest.approx(0.4 / (at_s[-1] / 3600.0), abs=1.5 * ramp.expanded_uncertainty)
    walk = one(found("resonance", white + 2.0 * np.sin(2.0 * np.pi * 0.7 * at_s)), "angle_random_walk")
    assert walk.value == pytest.approx(0.1**0.5 / 60.0, abs=1.5 * walk.expanded_uncertainty)  # of longer times


def test_noise_that_no_terms_describe_is_doubted() -> None:
    noise = noise_at_rest(np.random.default_rng(32).normal(0.0, 1.0, 5000), 0.1)
    for chance, against in ((noise.chance, []), (1e-9, ["no_terms"])):
        evidence = noise_evidence(replace(noise, chance=chance), "ring laser", ["angle_random_walk"], {})
        assert [check.code for check in weigh(evidence).against] == against


@pytest.mark.parametrize(
    ("stamps_s", "values", "said"),
    [
        (range(1000), range(1000), "the same number in every interval"),  # a counter that stands still
        (range(2), range(2), "2 rows are too few"),
        ((0, 1, 5, 6, 7), range(1, 6), "the rows do not lie"),
    ],
)
def test_what_is_no_record_of_counts_is_refused(stamps_s: object, values: object, said: str, tmp_path: Path) -> None:
    mapping = COUNTS.replace("row: {role: time, format: rows, rate: 10", "t: {role: time, format: samples, rate: 1")
    with pytest.raises(FitError, match=f"B-FIT-169: .*{said}"):
        imported(tmp_path, mapping, table("t,n", np.transpose([stamps_s, values]), "%d"))


@pytest.mark.parametrize(
    ("mapping", "old", "new", "said"),
    [
        (EDGES, "laser: {path_length: 15 cm, latitude: 37 deg}\n", "", "'laser' with path_length and latitude"),
        (EDGES, "  b: {role: cosine}\n", "", "beat, cosine and pickoff"),
        (EDGES, "role: pickoff", "role: index", "it takes: time, beat, cosine, pickoff, temperature, ignore"),
        (EDGES, "path_length: 15 cm", "path_length: 15 deg", "path_length"),
        (COUNTS, "count_scale: 1.11 arcsec\n", "", "'count_scale'"),
    ],
)
def test_mistakes_of_a_mapping_are_named(mapping: str, old: str, new: str, said: str) -> None:
    with pytest.raises(InputErrors, match=said):
        parsed(mapping.replace(old, new))
