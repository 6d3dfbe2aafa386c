"""The calibration history, as far as a run knows it: where it lies, and that a session is entered.

A bench without the extra 'history' records and judges all the same; its sessions are entered later.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.model.extras import missing_extra

VARIABLE = "BENCH_HISTORY"


def chosen_url(asked: str | None, out: Path, environment: Mapping[str, str]) -> str:
    """Return history asked for, else the one of BENCH_HISTORY, else history.sqlite in the folder of the sessions."""
    return asked or environment.get(VARIABLE) or f"sqlite:///{out / 'history.sqlite'}"


def check_history_url(url: str) -> None:
    """Before a run of days: an address that can never be opened. Raises: StoreError B-STORE-001."""
    try:
        from bench.store import history_address
    except ModuleNotFoundError as error:
        missing_extra(error)  # the end of the run says it
        return
    history_address(url)


def enter_history(
    url: str, folder: Path, results: Mapping[str, Any], manifest: Mapping[str, Any], report_sha256: str | None
) -> str | None:
    """Enter a session; return the sentence about why it is not entered, None if it is."""
    try:
        from bench.store import StoreError, record_calibration
    except ModuleNotFoundError as error:
        return _later(folder, missing_extra(error))
    try:
        record_calibration(url, results, manifest, report_sha256)
    except StoreError as error:
        return _later(folder, error)
    return None


def _later(folder: Path, error: Exception) -> str:
    return f"{error}; nothing is lost: 'bench history import {folder}' enters it later"
