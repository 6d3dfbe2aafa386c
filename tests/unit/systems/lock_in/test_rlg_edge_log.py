"""Analysis rlg_edge_log: edges of a physics of its own (``laser_physics``), whose lock-in is known."""

from __future__ import annotations

from pathlib import Path

import doubt_lock_in as worlds
import numpy as np
import pytest
from laser_physics import World
from numpy.typing import NDArray

from bench.analysis import Material
from bench.commands.import_log import import_log
from bench.model.errors import FitError, InputErrors
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.replay.series import replay_series
from bench.systems.lock_in import edge_log
from bench.systems.lock_in.records import laser_records

Array = NDArray[np.float64]
MAPPING = """\
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
    found = {(entry["quantity"], entry["conditions"].get("method", "")): entry for entry in analysis.estimates}
    compared = [key for key in found if key in truths and key[0] in ("lock_in_rate", "backscatter_phase")]
    compared += [("angle_random_walk", method) for method in ("raw", "global_constants")]
    assert len(compared) == 4
    for key in compared:
        assert found[key]["value"] == pytest.approx(truths[key], abs=1.5 * found[key]["expanded_uncertainty"]), key
    assert found["angle_random_walk", "raw"]["conditions"]["clock_Hz"] == 20e6  # of the steps between stamps
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
    columns = [[f"{round(t_s * 1e9)}" for t_s in series["t_s"]]]
    columns += [["" if np.isnan(level) else f"{level:.0f}" for level in series[name]] for name in COLUMNS[1:]]
    lines = [",".join(row) for row in zip(*columns, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,a,b,dither", *lines]), encoding="utf-8")
    (tmp_path / "m.yaml").write_text(MAPPING.replace("analysis: rlg_edge_log\n", ""), encoding="utf-8")
    assert import_log(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    read = replay_series(next((tmp_path / "out").iterdir())).columns
    for name in COLUMNS:
        np.testing.assert_array_equal(np.round(read[name], 9), np.round(series[name], 9))
    campaign = parse_yaml(MAPPING, "m.yaml", mapping_model()).model.campaign()
    assert campaign["laser"] == pytest.approx({"path_length_m": 0.15, "latitude_deg": 37.0})


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("laser: {path_length: 15 cm, latitude: 37 deg}\n", "", "'laser' with path_length and latitude"),
        ("  b: {role: cosine}\n", "", "beat, cosine and pickoff"),
        ("role: pickoff", "role: index", "it takes: time, beat, cosine, pickoff, temperature, ignore"),
        ("path_length: 15 cm", "path_length: 15 deg", "path_length"),
    ],
)
def test_mistakes_of_a_mapping_are_named(old: str, new: str, said: str) -> None:
    with pytest.raises(InputErrors) as raised:
        parse_yaml(MAPPING.replace(old, new), "m.yaml", mapping_model())
    assert said in str(raised.value)
