"""The calibration history beside the benches: sessions over all of them, and which unit is due."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from bench.model.clock import Clock, to_ns
from bench.model.errors import BenchError

LONGEST_DAYS = 365  # between two calibrations, as 'bench history due' has it
KEPT_S = 60.0  # drifts of hundreds of units take a while: asked by many, computed once

_NO_HISTORY = "B-STORE-007"  # nobody has calibrated yet

Row = dict[str, Any]


class Calibrated:
    """Answers from one history. Args: url: of the history; None: there is none, and every answer is empty."""

    def __init__(self, url: str | None, clock: Clock) -> None:
        self._url = url
        self._clock = clock
        self._worker = ThreadPoolExecutor(1, "history")
        self._one = asyncio.Lock()
        self._kept: dict[str, tuple[int, list[Row]]] = {}

    async def calibrations(self, request: Request) -> Response:
        """``GET /api/v1/calibrations``: all of them, newest first."""
        del request
        return JSONResponse({"calibrations": await self._rows("calibrations", calibration_rows), "named": self._named})

    async def due(self, request: Request) -> Response:
        """``GET /api/v1/due``: who is due, soonest first."""
        del request
        now_ns = self._clock.utc_ns()
        return JSONResponse({"due": await self._rows("due", lambda url: due_rows(url, now_ns)), "named": self._named})

    def stop(self) -> None:
        """Begin nothing more."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    @property
    def _named(self) -> bool:
        return self._url is not None

    async def _rows(self, what: str, read: Callable[[str], list[Row]]) -> list[Row]:
        if self._url is None:
            return []
        async with self._one:
            until_ns, rows = self._kept.get(what, (0, []))
            if self._clock.now_ns() >= until_ns:
                rows = await asyncio.get_running_loop().run_in_executor(self._worker, read_history, read, self._url)
                self._kept[what] = (self._clock.now_ns() + to_ns(KEPT_S), rows)
        return rows


def read_history(read: Callable[[str], list[Row]], url: str) -> list[Row]:
    """Return what is read of a history, nothing if nobody has calibrated yet."""
    try:
        return read(url)
    except BenchError as error:
        if error.code == _NO_HISTORY:
            return []
        raise


def calibration_rows(url: str) -> list[Row]:
    """Return every calibration of a history, newest first. Raises: StoreError B-STORE-001 to B-STORE-007."""
    from bench.store import Filters, list_calibrations  # SQLAlchemy takes a while: the server listens before

    return list_calibrations(url, Filters())[::-1]


def due_rows(url: str, now_utc_ns: int) -> list[Row]:
    """Return when each unit is due, soonest first, as 'bench history due' says it.

    Raises: StoreError B-STORE-001 to B-STORE-007.
    """
    from bench.store import Filters, compare_unit, dues_of, units_of

    units = [f"{model} {serial}" for model, serial in units_of(url)]
    dues = [due for unit in units for due in dues_of(compare_unit(url, Filters(unit)), LONGEST_DAYS)]
    return [due.as_json(now_utc_ns) for due in sorted(dues, key=lambda due: (due.due_utc_ns, due.uut))]
