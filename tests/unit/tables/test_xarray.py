"""Tables as xarray Datasets: the numbers of the tables, units by name, and what netCDF and CF tools make of them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from record_sample import write_resumed

import bench
from bench.model.errors import InputError
from bench.tables import Session
from bench.tables.plain import arrays_of, words_of


@pytest.fixture(scope="module")
def tables(golden: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    """Return every kind of table: of a rehearsed session, and one with groups that are not full."""
    folder = tmp_path_factory.mktemp("xarray") / "resumed"
    write_resumed(folder)
    session, resumed = Session(golden), Session(folder)
    return {
        "events": session.events, "readings": resumed.readings, "records": session.records,
        "estimates": session.estimates, "port_b": session.frames("port_b"),
        "sensors": resumed.frames("sensors", "measurements"), "none": session.frames("port_b", "command"),
    }  # fmt: skip


NAMES = ("events", "readings", "records", "estimates", "port_b", "sensors", "none")


@pytest.mark.parametrize("name", NAMES)
def test_a_dataset_has_the_numbers_and_units_of_its_table(tables: dict[str, pd.DataFrame], name: str) -> None:
    table = tables[name]
    dataset = bench.to_xarray(table)
    names = words_of(table)
    assert set(map(str, dataset.data_vars)) == set(names.values())
    for column, variable in names.items():
        values, cells = dataset[variable].values, table[column]
        assert dataset[variable].attrs.get("units") == table.attrs["units"].get(column)
        assert dataset[variable].attrs["long_name"]
        if pd.api.types.is_numeric_dtype(cells.dtype):
            np.testing.assert_array_equal(values.astype(float), cells.to_numpy(float, na_value=np.nan))
    assert dataset.attrs == {"session": table.attrs["session"], "simulated": 1}
    if table.index.name == "time":
        assert dataset.sizes == {"time": len(table)}
        pd.testing.assert_index_equal(
            dataset.indexes["time"].tz_localize("UTC"), table.index, exact=False, check_names=False
        )
        assert dataset["time"].attrs["standard_name"] == "time"
    else:
        assert dataset.sizes == {"row": len(table)}


@pytest.mark.parametrize("name", [name for name in NAMES if name != "none"])
def test_netcdf_holds_it(tables: dict[str, pd.DataFrame], name: str, tmp_path: Path) -> None:
    """What xarray writes by its netCDF encoder is what it reads; scipy's netCDF 3 has no 64-bit integers."""
    dataset = bench.to_xarray(tables[name])
    written = dataset.map(lambda values: values.astype(float) if values.dtype.kind in "iu" else values, keep_attrs=True)
    written.to_netcdf(tmp_path / "table.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "table.nc", engine="scipy") as read:
        for variable in map(str, dataset.variables):
            assert read[variable].attrs.get("units") == dataset[variable].attrs.get("units")
            if dataset[variable].dtype.kind in "fiuM":
                np.testing.assert_array_equal(read[variable].values, dataset[variable].values)


def test_long_names_are_words_without_the_unit(tables: dict[str, pd.DataFrame]) -> None:
    records = bench.to_xarray(tables["records"])
    said = {name: records[name].attrs["long_name"] for name in ("current_A", "number", "sum_npp_1", "stop")}
    assert said == {
        "current_A": "current", "number": "number of the record", "sum_npp_1": "sum npp 1",
        "stop": "end of the record, UTC",
    }  # fmt: skip
    assert records["mean_unit_temperature_degC"].attrs == {"long_name": "mean unit temperature", "units": "degC"}
    assert records["stop"].dtype == "M8[ns]"


def test_a_part_of_a_table_is_enough(golden: Path) -> None:
    records = Session(golden).records
    part = bench.to_xarray(records.loc[records["channel"] == 7, ["current_A", "sum_npp_7"]])
    assert part.sizes == {"time": int((records["channel"] == 7).sum())}
    assert part["current_A"].attrs["units"] == "A"
    assert set(part.data_vars) == {"current_A", "sum_npp_7"}
    assert bench.to_xarray(records.groupby("channel").first()).sizes == {"row": 2}


def test_names_that_would_be_alike_are_told_apart() -> None:
    index = pd.DatetimeIndex(["2000-01-01"], name="time", tz="UTC")
    long = "x" * 70
    table = pd.DataFrame({"a.b": [1.0], "a_b": [2.0], "time": [3.0], f"{long}1": [4.0], f"{long}2": [5.0]}, index=index)
    table.attrs["units"] = {"a_b": "V", "time": "s"}
    assert list(words_of(table).values()) == ["a_b", "a_b_2", "time_2", "x" * 63, f"{'x' * 61}_2"]
    arrays: dict[str, Any] = arrays_of(table)
    assert (arrays["time"][0], arrays["time_2"][0]) == (946_684_800 * 10**9, 3.0)
    dataset = bench.to_xarray(table)
    assert (dataset["a_b_2"].attrs["units"], dataset["time_2"].attrs["units"]) == ("V", "s")


def test_without_xarray_there_is_one_line(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match=r"pip install 'inertial-bench\[xarray\]'") as caught:
        bench.to_xarray(Session(golden).records)
    assert caught.value.code == "B-TAB-001"
