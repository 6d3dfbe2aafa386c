"""What the records of a calibration say against its matrices and biases: all mean outputs of both sets as rows.

Free are the matrix, which both sets share, and a bias of each set; a bias wanders from record to record, at most by the
bias stability of the specification. Beside the rows stand a sensor that does not answer mainly to its own axis, and one
that has noise elsewhere and stands still.
Source: docs/decisions/0025 (doubt), 0052 (departures).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.analysis import (
    Departure,
    Estimate,
    Estimates,
    Evidence,
    Finding,
    Floats,
    Labels,
    Residuals,
    Search,
    departures_of,
    evidence_of,
    search,
)
from bench.maths.verdict import coverage_factor
from bench.systems.gnc.calibration.report import TURNS, Calibration
from bench.systems.gnc.estimators.earth_rate import body_to_table
from bench.systems.gnc.estimators.sample_checks import FROZEN
from bench.systems.gnc.estimators.triad import AXES, TriadFit, TriadRows
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.rows import CheckedRow, SampledRow
from bench.systems.gnc.wording import channel_name, say

_PLAUSIBLE = 0.1  # scale-factor error and coupling
_PPM = 1e-6
_KINDS = {"accel": ("accelerometer", "position", "ug", 1e-6), "gyro": ("gyro", "rotation", "deg/h", 1.0 / 3600.0)}
SHARE = 0.5  # of a false doubt: the other triad has the other half


def evidence(parts: Calibration, checked: Sequence[CheckedRow], limits: Limits, estimates: Estimates) -> list[Evidence]:
    """Return what every check says of both triads, those that found nothing included."""
    found = _stands_still(checked)
    for triad in triads(parts, limits):
        found += _plausible(triad.prefix, triad.fits[0])
        if triad.is_judged:
            rows, stated = triad.residuals(estimates)
            searched = triad.without_change(search(rows, triad.departures(), SHARE), stated)
            found += evidence_of(searched, stated, triad.words)
    return found


@dataclass(frozen=True)
class Triad:
    """Rows of both sets of a triad; ``records``: of each set, each of which has one row or, of a turn, two."""

    prefix: str
    fits: Sequence[TriadFit]
    rows: Sequence[TriadRows]
    records: Sequence[Sequence[SampledRow]]
    stability: float

    @property
    def is_judged(self) -> bool:
        """Whether there is noise to judge by."""
        return all((rows.covariance.diagonal() > 0.0).all() for rows in self.rows)

    def label(self, of_row: Any) -> Any:
        """Return a value of each row of both sets for all three sensors, (r,)."""
        return np.repeat(np.array(of_row), 3)

    @property
    def record(self) -> list[SampledRow]:
        """The record of each row."""
        return [
            records[at * len(records) // len(rows.input)]
            for rows, records in zip(self.rows, self.records, strict=True)
            for at in range(len(rows.input))
        ]

    @property
    def input(self) -> Floats:
        """What each row shows, (n, 3)."""
        return np.concatenate([rows.input for rows in self.rows])

    @property
    def output(self) -> Floats:
        """Mean outputs by the matrix of the first set, (n, 3)."""
        first, *others = (rows.output for rows in self.rows)
        return np.concatenate(
            [first, *(out @ fit.sensitivity.T for out, fit in zip(others, self.fits[1:], strict=True))]
        )

    @property
    def set(self) -> Any:
        """The set of each row: 1 or 2."""
        return np.repeat([1, 2][: len(self.rows)], [len(rows.input) for rows in self.rows])

    def residuals(self, estimates: Estimates) -> tuple[Residuals, list[Estimate]]:
        """Return the rows, and the estimates that follow from them."""
        shown, sets = self.input, self.set
        noise = np.zeros((shown.size,) * 2)
        for number, rows in enumerate(self.rows, 1):
            noise[np.ix_(*(self.label(sets == number),) * 2)] = rows.covariance
        factor = np.linalg.inv(np.linalg.cholesky(noise))
        free = np.column_stack([shown, *(sets == number for number in np.unique(sets))])
        visits = self.label([row.number for row in self.record])
        sensor = np.tile(np.eye(3), (len(shown), 1))
        wander = [sensor * (visits == visit)[:, None] for visit in np.unique(visits)]
        known = [(self._operator(entry), entry) for entry in estimates if entry.expanded_uncertainty]
        stated = [entry for row, entry in known if row is not None]
        operator = np.array([row for row, _ in known if row is not None])
        return Residuals(
            readings=self.output.ravel(),
            white=factor @ (self.output - shown).ravel(),
            design=factor @ np.kron(free, np.eye(3)),
            scatter=factor @ np.hstack(wander) * self.stability,
            whiten=lambda columns: factor @ columns,
            operator=operator,
            expanded=np.array([entry.expanded_uncertainty for entry in stated]) / self._widened(stated),
            noise=coverage_factor() * np.sqrt(np.einsum("ki,ij,kj->k", operator, noise, operator)),
            on_curve=np.zeros(len(stated), bool),
            noise_dof=min(rows.dof for rows in self.rows),
        ), stated

    def _widened(self, stated: Estimates) -> Floats:
        """Return by what the misfit of its set widened each estimate."""
        widened = [math.sqrt(fit.chi2 / fit.residual_dof) if fit.inflated else 1.0 for fit in self.fits]
        return np.array([widened[_is_of_both(entry)] for entry in stated])

    def _operator(self, entry: Estimate) -> Floats | None:
        """Return what an estimate gains per unit of each output, (r,); None of one of another triad."""
        prefix, _, name = entry.quantity.partition("_")
        if prefix != self.prefix:
            return None
        by_rows = [np.zeros((12, self.input.size)) for _ in self.fits]
        sets = self.label(self.set)
        for number, rows in enumerate(self.rows, 1):
            by_rows[number - 1][:, sets == number] = rows.operator
        of_set = by_rows[_is_of_both(entry)]
        places = [AXES.index(entry.conditions[key]) for key in ("row", "column", "axis") if key in entry.conditions]
        element = 3 * places[0] + places[-1]
        if name == "bias":
            return np.asarray(of_set[9 + places[0]]) / (_KINDS["gyro"][3] if prefix == "gyro" else 1.0)
        if name == "matrix":
            return np.asarray(of_set[element])
        if name == "scale_repeatability":
            return np.asarray((by_rows[1][element] - by_rows[0][element]) / math.sqrt(2.0))
        of_sensitivity = np.asarray(self.fits[_is_of_both(entry)].by_matrix @ of_set[:9])
        return np.asarray(of_sensitivity[element]) / (_PPM if name == "scale_error" else 1.0)

    def departures(self) -> list[Departure]:
        """Return what could be true instead: what labels make, and a table that is tilted."""
        records, shown = self.record, self.input
        largest = np.abs(shown).max()
        force = np.concatenate([rows.force for rows in self.rows])
        temperature_degC = np.array([float(np.mean(row.temperature_degC)) for row in records])
        away = temperature_degC - temperature_degC.mean()
        moves = np.abs(shown).max(axis=1) > 0.5 * largest
        labels = Labels(
            kinds={
                "sensor": np.tile(AXES, len(shown)),
                "set": self.label(self.set),
                "pose": self.label([_pose(row) for row in records]),
                "axis": self.label([_pose(row)[1] for row in records]),
                "sense": self.label([_pose(row)[0] for row in records]),
                **({} if moves.all() else {"moves": self.label(moves)}),
            },
            hours=self.label([row.begin_s / 3600.0 for row in records]),
            visit=self.label([row.number for row in records]),
            scales={
                "own": (shown.ravel() / largest, (2,)),
                "temperature": (self.label(away / max(float(np.abs(away).max()), 1.0)), (1,)),
                **{f"force {axis}": (self.label(force[:, at]), (1, 2)) for at, axis in enumerate(AXES)},
            },
            carriers={
                "gain": ("ppm", _PPM * shown.ravel()),
                "offset": (_KINDS[self.prefix][2], np.full(shown.size, _KINDS[self.prefix][3])),
            },
            scopes=[(), ("sensor",), ("set",), ("sense",), ("axis",), ("sensor", "set"), ("sensor", "axis")],
        )
        # a shorter cycle has too few records to tell it; of a set all that moves is as good as all of it
        half_h = float(np.ptp(labels.hours)) / 2.0
        found = [
            one
            for one in departures_of(labels)
            if not ("cycle" in one.family and one.about["hours"] < half_h)
            and not ("set" in one.about and ("own" in one.family or "moves" in one.family))
        ]
        if self.prefix == "accel":
            level = np.stack([np.radians(body_to_table(row.pose)[:2].T) for row in records])
            found.append(Departure("tilt", "deg", level.reshape(-1, 2)))
        return found

    def without_change(self, searched: Search, stated: Estimates) -> Search:
        """Return the same where a change of the matrix between the sets is no error of what is to show it."""
        of_sets = (self.set[:, None] == np.unique(self.set)).astype(float)
        free = np.einsum("ns,nj->nsj", of_sets, np.column_stack([self.input, np.ones(len(of_sets))]))
        free = np.kron(free.reshape(len(of_sets), -1), np.eye(3))
        of_both = np.array([_is_of_both(entry) for entry in stated])

        def kept(found: Finding) -> Finding:
            effect = found.departure.effect
            left = effect - free @ np.linalg.lstsq(free, effect, rcond=None)[0]
            is_change = np.linalg.norm(left) < 1e-3 * np.linalg.norm(effect)
            return replace(found, moves=found.moves * ~of_both) if is_change else found

        return replace(searched, findings=[kept(found) for found in searched.findings])

    def words(self, label: str, value: Any) -> str:
        """Return how a person names the labels of a calibration."""
        if value is None:
            return say(f"departs.of.{label}")
        if label == "moves":
            return say("departs.turning" if value else "departs.resting")
        if label == "visit":
            poses = {row.number: _pose(row) for row in self.record}
            return say("departs.visit", value=value, pose=poses[value])
        return say(f"departs.{label}", value=value)


def triads(parts: Calibration, limits: Limits) -> Iterator[Triad]:
    """Yield the triads that were fitted."""
    sets, gyros = parts.sets, [fit.triad for fit in (parts.gyro, parts.gyro_check) if fit is not None]
    accelerometers = [fit for fit in (parts.accelerometer, parts.accelerometer_check) if fit is not None]
    positions = [list(rows.values()) for rows in (sets.positions, sets.check_positions)]
    turns = [[rows[turn] for turn in TURNS if turn in rows] for rows in (sets.rotations, sets.check_rotations)]
    for prefix, fits, records in (("accel", accelerometers, positions), ("gyro", gyros, turns)):
        rows = [fit.rows for fit in fits if fit.rows is not None]
        if rows:
            yield Triad(prefix, fits, rows, records[: len(rows)], limits[f"{prefix}_bias_stability"])


def _pose(row: SampledRow) -> str:
    """Return the axis that is up, or about which it is turned, with the sign."""
    turn = f"{'+' if float(row.conditions.get('turn_deg', 0.0)) > 0.0 else '-'}{row.conditions.get('axis')}"
    return str(row.conditions["up"]) if row.item == "position" else turn


def _is_of_both(entry: Estimate) -> bool:
    return entry.quantity.endswith(("_coupling_compensated", "_scale_repeatability"))


def _of(prefix: str) -> tuple[str, ...]:
    names = ("matrix", "bias", "scale_error", "cross_coupling", "coupling_compensated", "scale_repeatability")
    return tuple(f"{prefix}_{name}" for name in names)


def _plausible(prefix: str, fit: TriadFit) -> list[Evidence]:
    """Return a refusal where a sensor does not answer mainly to its own axis."""
    off = np.abs(fit.sensitivity - np.eye(3))
    worst = float(off.max())
    if worst <= _PLAUSIBLE:
        return []
    row, column = np.unravel_index(int(np.argmax(off)), off.shape)
    text = say(
        "evidence.axis",
        sensor=AXES[row],
        triad=say(f"triad.{prefix}"),
        axis=AXES[column],
        answer=float(fit.sensitivity[row, column]),
        due=float(row == column),
        off=100 * worst,
        bound=100 * _PLAUSIBLE,
    )
    return [Evidence("implausible_axis", text, worst, 0.0, quantities=_of(prefix), refuses=True)]


def _stands_still(checked: Sequence[CheckedRow]) -> list[Evidence]:
    """Return each sensor that stands still through a record and has noise in another one of the same kind."""
    found = []
    for item, prefix in (("position", "accel"), ("rotation", "gyro")):
        rows = [seen for seen in checked if seen.row.item == item]
        for axis in AXES:
            channel = f"{'accelerometer' if prefix == 'accel' else 'gyro'} {axis}"
            still = [seen.row.number for seen in rows if _frozen(seen, channel)]
            if 0 < len(still) < len(rows):
                text = say("evidence.still", sensor=channel_name(channel), records=", ".join(map(str, still)))
                found.append(Evidence("stands_still", text, float(len(still)), 0.0, quantities=_of(prefix)))
    return found


def _frozen(seen: CheckedRow, channel: str) -> bool:
    return any(finding.kind == FROZEN and finding.channel == channel for finding in seen.checks.findings)
