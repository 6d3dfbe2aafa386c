"""Estimates of a run that still goes on, as they converge: fitted by a process of its own, seldom, for all who look."""

from __future__ import annotations

import asyncio
import json
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.analysis import doubt_lines, estimates_of
from bench.model.clock import NS, Clock, pause, to_ns
from bench.model.errors import InputError
from bench.model.posix import PARTIAL_RESULTS, own_process, spent_by_children_s
from bench.model.texts import quantity_titles
from bench.record import UNIT_TEMPERATURE  # a condition that says nothing of which estimate it is

SHORTEST_S = 60.0  # between two fits
SHARE = 30  # of a core: a fit that costs 10 s of processor is not repeated before 300 s are over
LONGEST_FIT_S = 600.0
KEPT_PER_ROW = 200
KEPT_IN_ALL = 6000  # points of all rows: a page that opens must not be sent megabytes
KEPT_RUNS = 8
_LOOK_S = 1.0
_FITTER = tuple(own_process(PARTIAL_RESULTS))

Estimates = dict[str, Any]
_SHOWN = (
    "quantity", "unit", "value", "std_uncertainty", "expanded_uncertainty", "limit", "limits", "verdict", "quality",
)  # fmt: skip


class PartialFits:
    """Estimates of living runs by the name of the run; at most one fit at a time, whatever the number of runs."""

    def __init__(self, clock: Clock, command: tuple[str, ...] = _FITTER) -> None:
        self._clock = clock
        self._command = command
        self._found: OrderedDict[str, Estimates] = OrderedDict()
        self._not_before_ns: dict[str, int] = {}
        self._one = asyncio.Lock()

    def of(self, run: str) -> Estimates | None:
        """Return what is known of a run so far, as the key ``estimates`` of its state; None if nothing is."""
        return self._found.get(run)

    async def keep(self, folder: Path) -> None:
        """Fit a run again and again, for as long as it is not cancelled."""
        while True:
            await self.once(folder)
            await pause(_LOOK_S)

    async def once(self, folder: Path) -> None:
        """Fit a run if its last fit is long enough ago."""
        async with self._one:
            if self._clock.now_ns() >= self._not_before_ns.get(folder.name, 0):
                await self._fit(folder)

    async def _fit(self, folder: Path) -> None:
        before_s = spent_by_children_s()  # a fit on a busy machine costs the same
        answer = await self._answer(folder)
        spent_s = spent_by_children_s() - before_s
        self._not_before_ns[folder.name] = self._clock.now_ns() + to_ns(max(SHORTEST_S, SHARE * spent_s))
        if answer is not None and answer.get("rows"):
            self._found[folder.name] = joined(self._found.get(folder.name), answer, self._clock.utc_ns() / NS)
            self._found.move_to_end(folder.name)
            while len(self._found) > KEPT_RUNS:
                gone, _ = self._found.popitem(last=False)
                self._not_before_ns.pop(gone, None)

    async def _answer(self, folder: Path) -> dict[str, Any] | None:
        """Return what the process prints; None if it fails: a page without estimates is better than none."""
        process = await asyncio.create_subprocess_exec(
            *self._command, str(folder), stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        try:
            printed, _ = await asyncio.wait_for(process.communicate(), LONGEST_FIT_S)
            answer = json.loads(printed)
        except (ValueError, TimeoutError):
            return None
        finally:
            if process.returncode is None:
                with suppress(ProcessLookupError):
                    process.kill()
            while process.returncode is None:  # a page server that ends cancels this a second time
                with suppress(asyncio.CancelledError):
                    await process.communicate()
        return answer if isinstance(answer, dict) else None


def joined(before: Estimates | None, answer: dict[str, Any], t_utc_s: float) -> Estimates:
    """Return estimates with those of a new fit behind their history; a fit of the same records adds nothing."""
    known = {_key(row): row for row in (before or {}).get("rows", ())}
    records = int(answer["records"])
    kept = max(1, min(KEPT_PER_ROW, KEPT_IN_ALL // len(answer["rows"])))
    rows = []
    for row in answer["rows"]:
        history = list(known.get(_key(row), {}).get("history", ()))
        if row["value"] is not None and (not history or history[-1][0] != records):
            history.append([records, row["value"], row["std_uncertainty"], row.get("expanded_uncertainty")])
        rows.append({**row, "history": history[-kept:]})
    return {"t_utc_s": t_utc_s, "records": records, "rows": rows, "doubt": answer.get("doubt", [])}


def finished_estimates(results: dict[str, Any], t_utc_s: float) -> Estimates | None:
    """Return estimates of a finished session from its results.json; None if it has none in their form."""
    try:
        entries = estimates_of(results)
    except InputError:  # its outcome says so
        return None
    records = int((results.get("quality") or {}).get("records") or 0)
    analysis = str(results.get("campaign"))
    rows = [
        {
            **{key: value for key, value in entry.document.items() if key in _SHOWN},
            "titles": quantity_titles(analysis, entry.quantity),
            "conditions": {key: value for key, value in entry.conditions.items() if key != UNIT_TEMPERATURE},
            "history": [[records, entry.value, entry.std_uncertainty, entry.expanded_uncertainty]],
        }
        for entry in entries
    ]
    if not rows:
        return None
    return {"t_utc_s": t_utc_s, "records": records, "rows": rows, "doubt": doubt_lines(entries), "final": True}


def _key(row: dict[str, Any]) -> str:
    return json.dumps([row["quantity"], row["conditions"]], sort_keys=True)
