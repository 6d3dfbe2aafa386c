"""The optional libraries of tables; a missing one is one clear error that names the extra."""

from __future__ import annotations

from typing import Any

from bench.model.errors import InputError
from bench.model.extras import optional

EXTRAS = {
    "pandas": "python", "xarray": "xarray", "h5py": "hdf5", "pyarrow": "parquet", "mcap": "mcap", "rosbags": "ros",
}  # fmt: skip


def library(name: str) -> Any:
    """Return a library of tables, or a module of it. Raises: InputError B-TAB-001 if it is not installed."""
    package = name.partition(".")[0]
    message = f"{package} is not installed, and tables of this kind need it"
    cure = f"install it with: pip install 'inertial-bench[{EXTRAS[package]}]'"
    return optional(name, InputError("B-TAB-001", message, where=package, next_step=cure))


def pandas() -> Any:
    """Return pandas. Raises: InputError B-TAB-001 if it is not installed."""
    return library("pandas")
