"""The calibration history as the page shows it; only read."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from bench.model.errors import BenchError
from bench.store import Filters, chosen_url, list_calibrations

_ABSENT = "B-STORE-007"  # no history yet: nothing to complain about


def calibration_rows(history: str | None, out: Path) -> list[dict[str, Any]]:
    """Calibrations, newest first; empty if there is no history.

    Args: history: its URL; None: BENCH_HISTORY or history.sqlite in ``out``.
    Raises: StoreError B-STORE-001 to B-STORE-005.
    """
    try:
        rows = list_calibrations(chosen_url(history, out, os.environ), Filters())
    except BenchError as error:
        if error.code == _ABSENT:
            return []
        raise
    return rows[::-1]
