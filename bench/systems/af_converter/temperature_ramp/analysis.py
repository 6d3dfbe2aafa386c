"""Analysis of an imported temperature ramp: what a reading does with temperature, time, direction and lag.

Two models side by side: cubic in temperature, quadratic in time and an up/down term ("drift"), and the joint fit of lag
and hysteresis that the bias campaign uses, with the same drift terms.

The blocks of a reading are the rows of one search for what departs, as in a bias ramp; both models are judged by the
rows of the joint one, which holds the other but for its up/down term. The noise of a log is not declared: what is alike
for hours scatters, by up to what the fit left over, and a misfit would be taken for it; so its size is that which fits
best, without a departure and with it.
Source: docs/method-af-converter.md (joint fit), method-uncertainty.md (departures).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Departure,
    Estimates,
    Figure,
    Floats,
    Material,
    Residuals,
    Searched,
    Table,
    estimate,
    evidence_of,
    no_result,
    operators_of,
    search,
    series,
    unseen_tables,
    with_priors,
    worded_figure,
    worded_table,
)
from bench.maths.arrays import rms
from bench.systems.af_converter.bias_ramp.departures import Loop
from bench.systems.af_converter.coefficients import per_degC
from bench.systems.af_converter.estimators.drift_ramp import (
    BRANCH,
    DRIFT_NAMES,
    TEMPERATURE_NAMES,
    Blocks,
    RampHysteresis,
    block_means,
    drift_design,
    ramp_shape,
    search_bounds,
)
from bench.systems.af_converter.estimators.gates import Drive
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, Gates, HysteresisModel
from bench.systems.af_converter.estimators.hysteresis.search import Problem, first_order
from bench.systems.af_converter.temperature_ramp.fits import (
    MEAN,
    RampColumns,
    ReadingFit,
    fit_reading,
    plain_campaign,
    ramp_columns,
    ramp_drive,
)
from bench.systems.af_converter.wording import say

_SMOOTH = 5  # readings of the drive on either side
_AFTER, _TINY = "up_minus_down_after_drift", 1e-9
_LEAST = 1e-60  # of a variance: readings that a model describes exactly leave none
_LAGS, _PLAYS = 6, 8  # beside a drift model, which knows of neither; more of them leave a strong loop doubted oftener
Whiten = Callable[[Floats], Floats]


def searches_of(
    fits: Sequence[ReadingFit], columns: RampColumns, blocks: Blocks, entries: Estimates, reference_degC: float
) -> Iterator[Searched]:
    """Yield the search of every reading; all of them share the chance of a false doubt."""
    drive = ramp_drive(columns, blocks)
    for fit in fits:
        rows = _Rows(fit, columns, blocks, drive, reference_degC)
        residuals = rows.residuals([entry for entry in entries if entry.conditions["reading"] == fit.name])
        yield Searched(search(residuals, rows.departures(), share=1.0 / len(fits)), rows.loop.words)


@dataclass(frozen=True)
class _Rows:
    """The blocks of a reading, (m,)."""

    fit: ReadingFit
    columns: RampColumns
    blocks: Blocks
    drive: Drive
    reference_degC: float

    @property
    def joint(self) -> RampHysteresis | None:
        """The joint fit, where it has a result."""
        return None if self.fit.joint is None or self.fit.joint.fit.beyond else self.fit.joint

    @property
    def _moved(self) -> Floats:
        return self.blocks.mean(self.columns.branch / 2.0)

    @cached_property
    def loop(self) -> Loop:
        """The joint model over the blocks; next to no lag and play where it has no result."""
        gates, bounds = Gates(self.blocks.start_s, self.blocks.end_s), search_bounds(self.blocks, self.drive)
        model = HysteresisModel(gates, self.drive, ramp_shape(self.blocks, self.reference_degC))
        low = bounds.lag_s[0], bounds.half_width_degC[0]
        place = (self.joint.fit.value(LAG), self.joint.fit.value(HALF_WIDTH)) if self.joint else low
        kinds = np.array([say(f"segment.{kind}") for kind in ("hold", "up", "down")])
        branch = kinds[np.round(2.0 * self._moved).astype(np.int64)]
        return Loop(model, gates, place, branch, "reading", self.columns.unit, 1.0, self.fit.name)

    def departures(self) -> list[Departure]:
        """Return all that could be true instead; lags and loops of any kind are none where no joint fit knows one."""
        found = self.loop.departures()
        general = (one for one in found if one.carrier == "reading" and "value" not in one.about)
        return found if self.joint else list(general)

    def residuals(self, entries: Estimates) -> Residuals:
        """Return the rows for a search, those of the bounds of lag and half-width last."""
        noise, t_s = (self.joint or self.fit.drift).noise, self.blocks.middle_s
        free, residual, std = self._free(noise.whitening(t_s).of)
        operators = self._operators(free, noise.whitening(t_s).of, std)
        known = [entry for entry in entries if entry.expanded_uncertainty]
        operator, stated = operators_of(known, lambda entry: operators.get(entry.quantity), t_s.size)
        alike = np.exp(-np.abs(t_s[:, None] - t_s) / noise.time_s) + _TINY * np.eye(t_s.size)
        return Residuals.of(
            readings=self.fit.readings,
            error=residual,
            free=free,
            std=std,
            scatter=np.sqrt(noise.slow) * np.linalg.cholesky(alike),
            whiten=lambda columns: columns / np.sqrt(max(noise.white, _LEAST)),
            operator=operator,
            stated=stated,
            noise_dof=float(t_s.size - free.shape[1]),
            shift=lambda effect: operator @ effect,
        )

    def _free(self, whiten: Whiten) -> tuple[Floats, Floats, Floats]:
        """Return columns that nobody knows, (m, p), the residual, (m,), and how far the last columns are known, (q,).

        The noise of a sensor pushes the play to and fro, which the unit's own temperature does not.
        """
        model, drive, (lag_s, half_degC) = self.loop.model, self.drive, self.loop.place
        if not self.joint:
            bounds = search_bounds(self.blocks, drive)
            lags = [model.unit_degC(one) for one in np.geomspace(*bounds.lag_s, _LAGS).tolist()]
            plays = [model.shape_column(lag_s, one) for one in np.geomspace(*bounds.half_width_degC, _PLAYS).tolist()]
            temperature = self.blocks.mean(self.columns.temperature_degC)
            design = drift_design(self.blocks, temperature, self._moved, self.reference_degC)
            return np.column_stack((design, *lags, *plays)), self.fit.drift.residual, np.zeros(0)
        known, residual = first_order(Problem(model, self.fit.readings, whiten), lag_s, half_degC)
        smooth = HysteresisModel(self.loop.gates, replace(drive, degC=_smoothed(drive.degC)), model.shape)
        from_above = HysteresisModel(self.loop.gates, drive, replace(model.shape, play_start=1.0))
        others = [one.shape_column(lag_s, half_degC) for one in (smooth, from_above)]
        return np.column_stack((self._moved, *others, known)), residual, search_bounds(self.blocks, drive).std

    def _operators(self, free: Floats, whiten: Whiten, std: Floats) -> dict[str, Floats]:
        """Return what each quantity gains per unit of a reading, (m,)."""
        drift = dict(zip(self.fit.drift.names, self.fit.drift.operator, strict=True))
        found = {f"{self.fit.name}_tc{order}": drift[name] for order, name in enumerate(TEMPERATURE_NAMES)}
        found |= {name.replace(" ", "_"): drift[name] for name in DRIFT_NAMES} | {_AFTER: drift[BRANCH]}
        if self.joint:
            names = (*self.loop.model.names, LAG, HALF_WIDTH)
            design = with_priors(whiten(free[:, -len(names) :]), std)
            scale = np.linalg.norm(design, axis=0)
            inverse = (np.linalg.pinv(design / scale) / scale[:, None])[:, :-2]
            of_fit = dict(zip(names, inverse @ whiten(np.eye(free.shape[0])), strict=True))
            found |= {
                "hysteresis_width": of_fit[WIDTH],
                "thermal_lag": of_fit[LAG] / 60.0,
                "play_half_width": of_fit[HALF_WIDTH],
            }
        return found


def _smoothed(degC: Floats) -> Floats:
    weights = np.ones(2 * _SMOOTH + 1) / (2 * _SMOOTH + 1)
    return np.convolve(np.pad(degC, _SMOOTH, mode="edge"), weights, mode="valid")


_DRAWN = 800  # points of a curve
METHODS = ("joint", "drift")
MOST_BLOCKS = 240


def figures(columns: RampColumns, blocks: Blocks, fits: Sequence[ReadingFit]) -> list[Figure]:
    """Programme, branches against temperature, up minus down, and residuals against time."""
    drawn = [_programme(columns)]
    for fit in fits:
        drawn += [_branches(fit, columns, blocks), _differences(fit, columns), _residuals(fit, columns, blocks)]
    return drawn


def _programme(columns: RampColumns) -> Figure:
    thin = slice(None, None, max(1, columns.t_s.size // _DRAWN))
    hours = columns.t_s[thin] / 3600.0
    parts = (
        [series(say("log.programme.programme"), hours, columns.programme_degC[thin], "line")]
        if columns.has_set_point
        else []
    )
    parts.append(series(say("log.programme.sensor"), hours, columns.temperature_degC[thin], "line"))
    corners = [(segment.start_s, segment.start_degC) for segment in columns.segments]
    corners.append((columns.segments[-1].end_s, columns.segments[-1].end_degC))
    at = np.array(corners)
    parts.append(series(say("log.programme.corners"), at[:, 0] / 3600.0, at[:, 1], "points"))
    return worded_figure(say, "log.programme", ("log.axis.hours", "log.axis.temperature"), parts)


def _branches(fit: ReadingFit, columns: RampColumns, blocks: Blocks) -> Figure:
    direction, temperature = blocks.mean(columns.branch.astype(np.float64)), blocks.mean(columns.temperature_degC)
    parts = [
        series(say(f"segment.{kind}"), temperature[direction == sign], fit.readings[direction == sign], "points")
        for kind, sign in (("up", 1), ("down", -1), ("hold", 0))
    ]
    axes = "log.axis.temperature", "log.axis.reading"
    return worded_figure(say, "log.branches", axes, parts, name=fit.name, unit=columns.unit)


def _sensor(name: str) -> str:
    """Return how a reader calls a sensor: by its name in the log, but for the mean of all."""
    return say("log.mean_sensor") if name == MEAN else name


def _differences(fit: ReadingFit, columns: RampColumns) -> Figure:
    parts = [
        series(
            _sensor(sensor),
            np.array([difference.temperature_degC for difference in differences]),
            np.array([difference.value for difference in differences]),
            "line",
        )
        for sensor, differences in fit.differences.items()
    ]
    left, std, _ = fit.drift.estimate(BRANCH)
    axes = "log.axis.temperature", "log.axis.difference"
    return worded_figure(say, "log.differences", axes, parts, name=fit.name, left=left, U=2 * std, unit=columns.unit)


def _residuals(fit: ReadingFit, columns: RampColumns, blocks: Blocks) -> Figure:
    hours = blocks.middle_s / 3600.0
    parts = [series(say("log.residuals.drift"), hours, fit.drift.residual, "line")]
    if fit.joint is not None:
        parts.append(series(say("log.residuals.joint"), hours, fit.joint.fit.residual, "line"))
    axes = "log.axis.hours", "log.axis.residual"
    return worded_figure(say, "log.residuals", axes, parts, name=fit.name, unit=columns.unit)


def tables(columns: RampColumns, fits: Sequence[ReadingFit]) -> list[Table]:
    """Segments, their totals, up minus down by sensor, and what the models leave."""
    return [_segments(columns), _totals(columns), *(_by_sensor(fit, columns) for fit in fits), _left(columns, fits)]


def _segments(columns: RampColumns) -> Table:
    rows = [
        [
            say(f"segment.{segment.kind}"),
            *(round(float(x), 3) + 0.0 for x in (segment.start_s / 3600.0, segment.length_h, segment.rate_degC_h)),
            round(segment.start_degC, 2),
            round(segment.end_degC, 2),
        ]
        for segment in columns.segments
    ]
    return worded_table(say, "log.segments", ["kind", "start", "length", "rate", "from", "to"], rows)


def _totals(columns: RampColumns) -> Table:
    rows = []
    for kind in ("up", "hold", "down"):
        lengths = [segment.length_h for segment in columns.segments if segment.kind == kind]
        rows.append([say(f"segment.{kind}"), len(lengths), round(float(sum(lengths)), 3)])
    return Table(say("log.totals.title"), "", say.heads("log", "kind", "pieces", "hours"), rows)


def _by_sensor(fit: ReadingFit, columns: RampColumns) -> Table:
    by_sensor = {
        sensor: {difference.temperature_degC: round(difference.value, 2) for difference in many}
        for sensor, many in fit.differences.items()
    }
    temperatures = sorted({at for many in by_sensor.values() for at in many})
    rows = [[at, *(many.get(at, "–") for many in by_sensor.values())] for at in temperatures]
    rows.append(
        [say("log.by_sensor.after_drift"), *(round(fit.after_drift[name].estimate(BRANCH)[0], 2) for name in by_sensor)]
    )
    heads = [say("log.axis.temperature"), *map(_sensor, by_sensor)]
    return worded_table(say, "log.by_sensor", [], rows, heads, name=fit.name, unit=columns.unit)


def _left(columns: RampColumns, fits: Sequence[ReadingFit]) -> Table:
    rows: list[list[Any]] = []
    for fit in fits:
        rows.append([fit.name, say("log.left.drift"), *_rounded(*fit.drift.estimate(BRANCH)[:2], fit.drift.residual)])
        if fit.joint is not None:
            lag_min = fit.joint.fit.value(LAG) / 60.0
            model = say("log.left.joint", lag=lag_min)
            rows.append([fit.name, model, *_rounded(*fit.joint.width, fit.joint.fit.residual)])
    return worded_table(say, "log.left", ["reading", "model", "apart", "std", "rms"], rows, unit=columns.unit)


def _rounded(value: float, std: float, residual: Floats) -> list[float]:
    return [round(number, 3) for number in (value, std, rms(residual))]


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Fit every reading of an imported ramp.

    ``method``: "joint" fits lag and hysteresis too, "drift" leaves that out.
    Raises: FitError B-FIT-060, B-FIT-061 (see ramp_columns), B-FIT-001.
    """
    uut, reference_degC = plain_campaign(material.campaign)
    columns = ramp_columns(material)
    blocks = block_means(columns.t_s, min(MOST_BLOCKS, columns.t_s.size // 2))
    fits = [fit_reading(name, columns, blocks, reference_degC, method) for name in columns.readings]
    entries = [entry for fit in fits for entry in _estimates(fit, columns, reference_degC)]
    searches = list(searches_of(fits, columns, blocks, entries, reference_degC))
    return Analysis(
        "temperature_ramp",
        method,
        uut,
        entries,
        notes=_notes(columns, blocks, fits),
        missing=[_not_joint(fit) for fit in fits if fit.joint is not None and fit.joint.fit.beyond],
        figures=figures(columns, blocks, fits),
        tables=[*tables(columns, fits), *unseen_tables(searches)],
        evidence=[*columns.doubt, *evidence_of(searches)],
    )


def _estimates(fit: ReadingFit, columns: RampColumns, reference_degC: float) -> Estimates:
    """Return entries of results.json for one reading; positive ``up_minus_down``: the ramp up reads more."""
    unit, dropped = columns.unit, columns.dropped
    about = {"reading": fit.name, "reference_temperature_degC": reference_degC}

    def entry(quantity: str, unit_of: str, result: tuple[float, float, float], conditions: dict[str, Any]) -> Any:
        value, std, dof = result
        return estimate(quantity, unit_of, value, std, conditions, n=columns.t_s.size, dropped=dropped, dof=dof)

    sensor = next(iter(fit.differences))
    entries = [
        entry(
            "up_minus_down",
            unit,
            (difference.value, difference.std, difference.dof),
            {"reading": fit.name, "sensor": sensor, "temperature_degC": difference.temperature_degC},
        )
        for difference in fit.differences[sensor]
    ]
    after = {"reading": fit.name, "sensor": sensor}
    entries.append(entry("up_minus_down_after_drift", unit, fit.drift.estimate(BRANCH), after))
    for name, suffix in zip(DRIFT_NAMES, ("h", "h2"), strict=True):
        entries.append(
            entry(name.replace(" ", "_"), f"{unit}/{suffix}", fit.drift.estimate(name), {"reading": fit.name})
        )
    for order, name in enumerate(TEMPERATURE_NAMES[1:], 1):
        entries.append(entry(f"{fit.name}_tc{order}", per_degC(unit, order), fit.drift.estimate(name), about))
    return entries + [entry(*difference, {"reading": fit.name}) for difference in _joint_estimates(fit, unit)]


def _joint_estimates(fit: ReadingFit, unit: str) -> Iterator[tuple[str, str, tuple[float, float, float]]]:
    """Yield quantity, unit and (value, standard uncertainty, degrees of freedom) of the joint fit."""
    if fit.joint is None or fit.joint.fit.beyond:
        return
    joint, many = fit.joint.fit, float(fit.joint.fit.dof)
    yield "hysteresis_width", unit, (*fit.joint.width, many)
    if joint.lag_determined:
        yield "thermal_lag", "min", (joint.value(LAG) / 60.0, joint.std(LAG) / 60.0, many)
    if joint.half_width_determined:
        yield "play_half_width", "degC", (joint.value(HALF_WIDTH), joint.std(HALF_WIDTH), many)


def _not_joint(fit: ReadingFit) -> str:
    lag = fit.joint is not None and fit.joint.fit.beyond == LAG
    return say("log.not_joint", name=fit.name, what=say("log.beyond.lag" if lag else "log.beyond.half_width"))


def _notes(columns: RampColumns, blocks: Blocks, fits: list[ReadingFit]) -> list[str]:
    source = say("log.source.set_point" if columns.has_set_point else "log.source.measured")
    sentences = [
        say("log.overload", count=columns.overloaded, of=columns.t_s.size + columns.dropped),
        *columns.row_notes,
        say("log.ramps", source=source, blocks=blocks.count.size),
        say("log.quantities"),
        say("log.correlation"),
    ]
    for fit in fits:
        if fit.joint is None:
            continue
        if fit.joint.fit.beyond:
            sentences += no_result([_not_joint(fit)])
            continue
        width, std = fit.joint.width
        if not fit.joint.fit.half_width_determined:
            sentences.append(say("log.no_half_width", name=fit.name, ratio=abs(width) / std))
        if not fit.joint.fit.lag_determined:
            sentences.append(say("log.no_lag", name=fit.name))
    return sentences
