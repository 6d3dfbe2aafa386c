"""The 38-hour ramp of the project tckit, read without edits, against what its own columns say by other means."""

import csv
import json
import os
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsal import ROOT, main_of

from bench.analysis import Table

MAPPING = ROOT / "docs" / "mappings" / "tckit_1v_ramp.yaml"
FOLDER = Path(os.environ.get("BENCH_REAL_DATA", ROOT.parent / "shared" / "data")) / "tckit"
FILES = sorted(FOLDER.glob("*tcsweep_1vdc*.dsv"))
pytestmark = [pytest.mark.real, pytest.mark.skipif(not FILES, reason=f"no recording in {FOLDER}")]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tckit")
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said := StringIO()):
        assert main_of(patch, "import", str(MAPPING), str(FILES[0]), "--out", str(out)) == 0
    assert "6311 rows, 1 with an overload, 0 cannot be read" in said.getvalue().replace("\n", " ")
    return out / "20241020T011845Z_tckit_1v_ramp_unknown"


@pytest.fixture(scope="module")
def results(session: Path) -> dict[str, Any]:
    return json.loads((session / "results.json").read_text(encoding="utf-8"))


def values(results: dict[str, Any], quantity: str, reading: str = "hp34420a_5") -> list[dict[str, Any]]:
    entries = results["estimates"]
    return [one for one in entries if one["quantity"] == quantity and one["conditions"]["reading"] == reading]


def table(session: Path, title: str) -> Table:
    from bench.session.service import read_view
    from bench.session.view import analyse_view

    return next(one for one in analyse_view(read_view(session), "drift")[1].tables if one.title == title)


def test_two_rows_are_excluded_and_the_others_count(results: dict[str, Any]) -> None:
    """The one with an overload, and the one behind it, in which all references are 5 ppm off their neighbours."""
    assert {(one["n"], one["dropped"]) for one in results["estimates"]} == {(6309, 2)}
    assert results["provenance"]["simulated"] is False


def test_lengths_of_the_ramps_and_holds_are_those_given_with_the_file(session: Path) -> None:
    totals = {row[0]: row[2] for row in table(session, "Time up, holding and down").rows}
    assert totals["up"] == pytest.approx(9.3, rel=0.02)
    assert totals["hold"] == pytest.approx(13.9, rel=0.02)
    assert totals["down"] == pytest.approx(14.9, rel=0.02)


@pytest.mark.parametrize("reading", ["hp34420a_5", "hp34420a_6"])
def test_what_the_drift_model_leaves(results: dict[str, Any], reading: str) -> None:
    (one,) = values(results, "up_minus_down_after_drift", reading)
    assert one["value"] == pytest.approx(-1.76, abs=0.3)
    assert 0.3 < one["expanded_uncertainty"] < 1.2


@pytest.mark.validates(
    "up minus down of an imported 38-hour ramp after drift: -1.76 ppm",
    against="a real recording of other people, numpy.linalg.lstsq on all of its rows",
)
def test_the_same_by_plain_least_squares_on_the_rows_of_the_file(
    record_property: Callable[[str, object], None], results: dict[str, Any]
) -> None:
    with FILES[0].open(encoding="ascii") as stream:
        rows = list(csv.DictReader(stream, delimiter=";"))[1:]
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0] if name and name != "date"}
    stamps = [np.datetime64(f"{r['date'][6:10]}-{r['date'][3:5]}-{r['date'][:2]}T{r['date'][11:]}") for r in rows]
    hours = (np.array(stamps) - stamps[0]) / np.timedelta64(3600, "s")
    ratio = column["vbl5"] / ((column["vbl1"] + column["vbl2"] + column["vbl3"]) / 3.0)
    sensor = (column["val6"] + column["val7"] + column["val8"]) / 3.0 - 23.0
    going = np.sign(np.diff(column["sv_temp"], append=column["sv_temp"][-1]))
    hours -= hours.mean()
    design = np.column_stack([sensor**k for k in range(4)] + [hours, hours**2, going / 2.0])
    left = np.linalg.lstsq(design, (ratio / np.median(ratio) - 1.0) * 1e6, rcond=None)[0][-1]
    assert left == pytest.approx(-1.76, abs=0.005)
    found = values(results, "up_minus_down_after_drift")[0]["value"]
    record_property("obtained", f"{found:.3f} ppm, lstsq {left:.3f} ppm")
    assert found == pytest.approx(left, abs=0.03)


def test_up_minus_down_at_equal_sensor_temperature(session: Path) -> None:
    found = table(session, "hp34420a_5: up minus down")
    at = found.headers.index("sensor_8")
    inner = [row[at] for row in found.rows if isinstance(row[0], float) and 23.0 <= row[0] <= 33.0]
    assert len(inner) == 11
    assert min(inner) == pytest.approx(-4.85, abs=0.1)
    assert max(inner) == pytest.approx(-3.6, abs=0.15)


def test_a_lag_behind_the_sensors_leaves_no_hysteresis(results: dict[str, Any]) -> None:
    """The joint fit says what the drift model cannot: the branches differ because the instrument's inside lags."""
    (width,), (lag,) = values(results, "hysteresis_width"), values(results, "thermal_lag")
    assert abs(width["value"]) < width["expanded_uncertainty"] < 3.0
    assert 60.0 < lag["value"] < 130.0
