"""Whole sessions of simulated GNC modules in this process: what the analysis says, and the simulated truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.commands.loading import checked_plan
from bench.commands.run import view_of
from bench.model.clock import VirtualClock
from bench.plan import Step
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from bench.session.view import KEPT_EVENTS, analyse_view

SHORT = ("position=60 s", "check_position=20 s", "warm_up=5 min")
HEAD_s = 1.0  # the second before the turn belongs to the record too
Key = tuple[Any, ...]


class _Silent:
    def step(self, step: Step, at_s: float) -> None:
        return None

    def record(self, row: object) -> None:
        return None

    def message(self, text: str) -> None:
        return None


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
    folder = out / f"{Path(sequence).stem}-{number}"
    done = conduct(
        plan, clock=VirtualClock(), seed=100 + number, out=folder, operator=SimulatedOperator(), listener=_Silent(),
        keep_events=KEPT_EVENTS,
    )  # fmt: skip
    assert done.outcome.error is None, done.outcome.error
    results, analysis = analyse_view(view_of(plan, done))
    found = {_key(one["quantity"], one["conditions"]): one for one in results["estimates"]}
    truth = {_key(one["quantity"], one["conditions"]): one["value"] for one in done.truth}
    return Session(found, truth, analysis.notes, analysis.missing)


def _key(quantity: str, conditions: dict[str, Any]) -> Key:
    return quantity, *sorted(conditions.items())


def share_covered(sessions: list[Session], *quantities: str) -> float:
    """Per cent of the intervals that hold the truth."""
    errors = np.concatenate([one.errors(*quantities) for one in sessions])
    return 100.0 * float(np.mean(np.abs(errors[:, 0]) <= errors[:, 1]))
