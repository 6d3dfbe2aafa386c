"""Logs as the tests import them: a mapping and a file, the session they become; recordings of other people."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.analysis import Estimate, estimates
from bench.commands.import_log import import_log
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.replay.series import replay_series

MAPPINGS = Path(__file__).resolve().parents[2] / "docs" / "mappings"


def parsed(mapping: str) -> Any:
    """Return the model of the text of a mapping. Raises: InputErrors."""
    return parse_yaml(mapping, "m.yaml", mapping_model()).model


def imported(folder: Path, mapping: str | Path, log: str | bytes, status: int | None = 0) -> Path:
    """Import a log by the text or the file of a mapping and return its session.

    ``status``: what the command ends with, None if whatever it is.
    """
    path = folder / "m.yaml" if isinstance(mapping, str) else mapping
    if isinstance(mapping, str):
        path.write_text(mapping, encoding="utf-8")
    (folder / "log").write_bytes(log.encode() if isinstance(log, str) else log)
    assert import_log(path, folder / "log", folder / "out") == status or status is None
    (session,) = (each for each in (folder / "out").iterdir() if each.is_dir())
    return session


def table(names: str, rows: Any, form: str = "%.17g") -> str:
    """Return lines of comma-separated values, empty where they are not a number."""
    return "\n".join([names, *(",".join("" if np.isnan(value) else form % value for value in row) for row in rows)])


def estimates_of(session: Path) -> list[Estimate]:
    """Return the estimates of a session."""
    return estimates.estimates_of(json.loads((session / "results.json").read_bytes()))


def columns_of(session: Path) -> Mapping[str, Any]:
    """Return what is read back of a session, in base units."""
    return replay_series(session).columns


def of_mirror(repository: str, name: str) -> bytes:
    """Return a file of another project, of the copy that $BENCH_CAPTURES names; without one the test is skipped."""
    folder = Path(os.environ.get("BENCH_CAPTURES", "/nowhere")) / repository / "repo"
    if not folder.is_dir():
        pytest.skip(f"no {folder}: name the folder of its copy in BENCH_CAPTURES")
    return subprocess.run(["git", "-C", folder, "show", f"HEAD:{name}"], capture_output=True, check=True).stdout
