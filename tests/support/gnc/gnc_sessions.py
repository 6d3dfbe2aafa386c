"""Whole sessions of simulated GNC modules in this process: what the analysis says, and the simulated truth."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsal import recorded, rehearsed

from bench.commands.check import checked_plan
from bench.commands.run import view_of
from bench.session.view import KEPT_EVENTS, analyse_view

SHORT = ("position=60 s", "check_position=20 s", "warm_up=5 min")
HEAD_s = 1.0  # the second before the turn belongs to the record too
TURN_s = 21.3  # rotations of the recorded units, as shipped
RECORDED = {"gnc_magnetometer": ()}  # settings, by sequence; those of a calibration without
_SESSION = "session.pickle"
Key = tuple[Any, ...]


@dataclass(frozen=True)
class Session:
    """Estimates and truth by quantity and conditions; ``notes`` of the analysis."""

    found: dict[Key, dict[str, Any]]
    truth: dict[Key, float]
    notes: list[str]
    missing: list[str]

    def errors(self, *quantities: str) -> np.ndarray:
        """(n, 3): error, expanded uncertainty, standard uncertainty of each estimate of which there is a truth."""
        chosen = [(key, one) for key, one in self.found.items() if key in self.truth]
        return np.array(
            [
                (one["value"] - self.truth[key], one["expanded_uncertainty"], one["std_uncertainty"])
                for key, one in chosen
                if not quantities or key[0] in quantities
            ]
        )

    def matrix(self, quantity: str, *, true: bool = False) -> np.ndarray:
        """(3, 3) by row and column."""
        values = self.truth if true else {key: one["value"] for key, one in self.found.items()}
        matrix = np.zeros((3, 3))
        for key, value in values.items():
            place = dict(key[1:])
            if key[0] == quantity:
                matrix["xyz".index(place["row"]), "xyz".index(place["column"])] = value
        return matrix

    def by_axis(self, quantity: str, kind: str, *, true: bool = False) -> np.ndarray:
        """(3,) x, y, z."""
        values = self.truth if true else {key: one["value"] for key, one in self.found.items()}
        return np.array([values[_key(quantity, {"kind": kind, "axis": axis})] for axis in "xyz"])


def run_session(out: Path, sequence: str, number: int, *settings: str) -> Session:
    """One simulated unit; the number makes its serial number and the seed."""
    plan = checked_plan(sequence, None, [f"serial=U-{number:02}", *settings])
    done = rehearsed(out / f"{Path(sequence).stem}-{number}", plan, seed=100 + number, kept=KEPT_EVENTS).run
    assert done.outcome.error is None, done.outcome.error
    results, analysis = analyse_view(view_of(plan, done))
    found = {_key(one["quantity"], one["conditions"]): one for one in results["estimates"]}
    truth = {_key(one["quantity"], one["conditions"]): one["value"] for one in done.truth}
    return Session(found, truth, analysis.notes, analysis.missing)


def calibration_settings(length_s: float) -> tuple[str, ...]:
    """A short calibration with rotations recorded over some time."""
    return *SHORT, f"turn_record={length_s - HEAD_s:g} s"


def recorded_unit(factory: pytest.TempPathFactory, sequence: str) -> tuple[Path, Session]:
    """Folder and results of unit 0 in one sequence, run once per test run; for reading only."""
    out = recorded(factory, f"{sequence}_unit", partial(_record, sequence))
    (folder,) = (path for path in out.glob("*/*") if path.is_dir())
    return folder, pickle.loads((out / _SESSION).read_bytes())


def _record(sequence: str, out: Path) -> None:
    session = run_session(out, sequence, 0, *RECORDED.get(sequence, calibration_settings(TURN_s)))
    (out / _SESSION).write_bytes(pickle.dumps(session))


def _key(quantity: str, conditions: dict[str, Any]) -> Key:
    return quantity, *sorted(conditions.items())


def share_covered(sessions: list[Session], *quantities: str) -> float:
    """Per cent of the intervals that hold the truth."""
    errors = np.concatenate([one.errors(*quantities) for one in sessions])
    return 100.0 * float(np.mean(np.abs(errors[:, 0]) <= errors[:, 1]))
