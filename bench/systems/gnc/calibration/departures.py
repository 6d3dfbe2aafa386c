"""What the records of a calibration say against its matrices and biases: all mean outputs of both sets as rows.

Free are the matrix, which both sets share, and a bias of each set; a bias wanders from record to record, at most by the
bias stability of the specification. Beside the rows stand a sensor that does not answer mainly to its own axis, and one
that has noise elsewhere and stands still.
Source: docs/method-uncertainty.md (doubt, departures).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from bench.analysis import (
    Departure,
    Estimate,
    Estimates,
    Evidence,
    Floats,
    Labels,
    Residuals,
    Searched,
    departures_of,
    operators_of,
    search,
)
from bench.maths.arrays import Integers
from bench.maths.samples import FROZEN, RUNS
from bench.maths.verdict import coverage_factor
from bench.systems.gnc.calibration.report import Calibration
from bench.systems.gnc.declaration import AXES, CALIBRATED, GYRO, TURNS
from bench.systems.gnc.estimators.earth_rate import body_to_table
from bench.systems.gnc.estimators.triad import TriadFit, TriadRows
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.rows import CheckedRow, SampledRow
from bench.systems.gnc.wording import channel_name, say

_PLAUSIBLE = 0.1  # scale-factor error and coupling
_OFFSETS = {"accel": ("ug", 1e-6), "gyro": ("deg/h", 1.0 / 3600.0)}
_NOTHING = 1e-30  # variance: without noise nothing is judged
SHARE = 0.5  # of a false doubt: the other triad has the other half


def searches_of(parts: Calibration, limits: Limits, estimates: Estimates) -> Iterator[Searched]:
    """Yield the search of each triad."""
    for triad in triads(parts, limits):
        rows = triad.residuals(estimates)
        if rows.noise.all():
            found = search(rows, triad.departures(), SHARE)
            of_both = np.array([_is_of_both(entry) for entry in rows.stated])
            findings = [
                replace(one, moves=one.moves * ~of_both) if _is_change(one.departure) else one for one in found.findings
            ]
            yield Searched(replace(found, findings=findings), triad.words)


def implausible(parts: Calibration, checked: Sequence[CheckedRow], limits: Limits) -> list[Evidence]:
    """Return sensors that stand still, and those that do not answer to their own axis."""
    found = _stands_still(checked)
    for triad in triads(parts, limits):
        found += _plausible(triad.prefix, triad.fits[0])
    return found


@dataclass(frozen=True)
class Triad:
    """Rows of both sets of a triad, (n, 3), one set behind the other; ``records`` (n,): the record of each row."""

    prefix: str
    fits: Sequence[TriadFit]
    rows: Sequence[TriadRows]
    records: Sequence[SampledRow]
    stability: float

    @property
    def input(self) -> Floats:
        """What each row shows, (n, 3)."""
        return np.concatenate([rows.input for rows in self.rows])

    @property
    def set(self) -> Integers:
        """The set of each row: 1 or 2."""
        return np.repeat(np.arange(len(self.rows)) + 1, [len(rows.input) for rows in self.rows])

    def residuals(self, estimates: Estimates) -> Residuals:
        """Return the rows."""
        first, *again = (rows.output for rows in self.rows)
        outputs = np.concatenate([first @ self.fits[0].matrix.T, *again])
        noise = linalg.block_diag(*(rows.covariance for rows in self.rows))
        factor = np.linalg.inv(np.linalg.cholesky(noise + _NOTHING * np.eye(len(noise))))
        free = np.column_stack([self.input, *(self.set == number for number in np.unique(self.set))])
        visits = np.array([row.number for row in self.records])
        known = [one for one in estimates if one.expanded_uncertainty and one.quantity.startswith(self.prefix)]
        operator, stated = operators_of(known, self._operator, len(noise))
        widened = [math.sqrt(fit.chi2 / fit.residual_dof) if fit.inflated else 1.0 for fit in self.fits]
        return Residuals.of(
            readings=outputs.ravel(),
            error=(outputs - self.input).ravel(),
            free=np.kron(free, np.eye(3)),
            scatter=np.kron(visits[:, None] == np.unique(visits), self.stability * np.eye(3)),
            whiten=lambda columns: factor @ columns,
            operator=operator,
            stated=stated,
            expanded=np.array([one.expanded_uncertainty / widened[_is_of_both(one)] for one in stated]),
            noise=coverage_factor() * np.sqrt(np.einsum("ki,ij,kj->k", operator, noise, operator)),
            noise_dof=min(rows.dof for rows in self.rows),
        )

    def _operator(self, entry: Estimate) -> Floats:
        """Return what an estimate gains per unit of each output, (3n,)."""
        of_sets = linalg.block_diag(*(rows.operator for rows in self.rows)).reshape(len(self.rows), 12, -1)
        name, of_set = entry.quantity.removeprefix(f"{self.prefix}_"), of_sets[int(_is_of_both(entry))]
        places = [AXES.index(entry.conditions[key]) for key in ("row", "column", "axis") if key in entry.conditions]
        element = 3 * places[0] + places[-1]
        if name == "scale_repeatability":
            return np.asarray((of_set[element] - of_sets[0, element]) / math.sqrt(2.0))
        of_sensitivity = self.fits[_is_of_both(entry)].by_matrix[element] @ of_set[:9]
        named = {
            "bias": of_set[9 + places[0]] * (3600.0 if self.prefix == "gyro" else 1.0),
            "matrix": of_set[element],
            "scale_error": 1e6 * of_sensitivity,
        }
        return np.asarray(named.get(name, of_sensitivity))

    def departures(self) -> list[Departure]:
        """Return what could be true instead: what labels make, and a table that is tilted."""
        shown, force = self.input, np.concatenate([rows.force for rows in self.rows])
        along, poses = shown / np.abs(shown).max(), [_pose(row) for row in self.records]
        temperature_degC = np.array([float(np.mean(row.temperature_degC)) for row in self.records])
        unit, size = _OFFSETS[self.prefix]
        of_rows = {
            "temperature": (temperature_degC - temperature_degC.mean(), (1,)),
            **{f"along {axis}": (along[:, at], (1, 2)) for at, axis in enumerate(AXES)},
            **{f"force {axis}": (force[:, at], (1, 2)) for at, axis in enumerate(AXES)},
        }
        kinds: dict[str, Any] = {
            "set": self.set,
            "pose": poses,
            "axis": [pose[1] for pose in poses],
            "sense": [pose[0] for pose in poses],
        }
        hours = np.array([row.begin_s / 3600.0 for row in self.records])
        labels = Labels(
            kinds={
                "sensor": np.tile(AXES, len(shown)),
                **{name: np.repeat(np.array(of), 3) for name, of in kinds.items()},
            },
            hours=np.repeat(hours, 3),
            visit=np.repeat([row.number for row in self.records], 3),
            scales={
                "own": (along.ravel(), (2,)),
                **{name: (np.repeat(scale, 3), orders) for name, (scale, orders) in of_rows.items()},
            },
            carriers={"gain": ("ppm", 1e-6 * shown.ravel()), "offset": (unit, np.full(shown.size, size))},
            scopes=[(), ("sensor",), ("set",), ("sense",), ("axis",), ("sensor", "set"), ("sensor", "axis")],
        )
        half_h = float(np.ptp(hours)) / 2.0
        found = [
            one
            for one in departures_of(labels)
            if not (one.shape == "cycle" and one.about["hours"] < half_h)  # too few records tell a shorter one
            and not (one.of == "own" and "set" in one.about)  # all rates of a set are as good as one
        ]
        if self.prefix == "accel":
            level = np.stack([np.radians(body_to_table(row.pose)[:2].T) for row in self.records])
            found.append(Departure("", "tilt", "deg", level.reshape(-1, 2)))
        return found

    def words(self, label: str, value: Any) -> str:
        """Return how a person names the labels of a calibration."""
        poses = {row.number: _pose(row) for row in self.records}
        return say(f"departs.of.{label}" if value is None else f"departs.{label}", value=value, pose=poses.get(value))


def triads(parts: Calibration, limits: Limits) -> Iterator[Triad]:
    """Yield the triads that were fitted."""
    for sensor, _ in parts.calibrated():
        fits = parts.fits[sensor.prefix]
        made = [fit.rows for fit in fits if fit.rows is not None]
        records = [
            of_set[shown]
            for rows, of_set in zip(made, parts.records[sensor.item], strict=False)
            for shown in (TURNS if sensor is GYRO else of_set)  # the order of the rows of their fits
            for _ in range(len(rows.input) // len(of_set))
        ]
        yield Triad(sensor.prefix, fits, made, records, limits[f"{sensor.prefix}_bias_stability"])


def _pose(row: SampledRow) -> str:
    """Return the axis that is up, or about which it is turned, with the sign."""
    turn = f"{'+' if float(row.conditions.get('turn_deg', 0.0)) > 0.0 else '-'}{row.conditions.get('axis')}"
    return str(row.conditions["up"]) if row.item == "position" else turn


def _is_change(one: Departure) -> bool:
    """Whether the matrix of a set changes: that is no error of what is to show it."""
    return one.of == "set" or ("set" in one.about and "along" in one.of and one.power == 1)


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
    for sensor in CALIBRATED:
        rows = [seen for seen in checked if seen.row.item == sensor.item]
        for axis in AXES:
            channel = f"{sensor.kind} {axis}"
            still = [seen.row.number for seen in rows if _frozen(seen, channel)]
            if 0 < len(still) < len(rows):
                text = say("evidence.still", sensor=channel_name(channel), records=", ".join(map(str, still)))
                found.append(Evidence("stands_still", text, float(len(still)), 0.0, quantities=_of(sensor.prefix)))
    return found


def _frozen(seen: CheckedRow, channel: str) -> bool:
    return any(finding.kind in (FROZEN, RUNS) and finding.channel == channel for finding in seen.findings)
