"""Calibration of the magnetometer: of the axes across the roll axis by the paper's extremes and by least squares, hard
and soft iron from records in many attitudes, and the roll angle that the module returns over the link.

Source: GNC-module paper section 4.2 2) and equations (5) to (9) as corrected in ``estimators.magnetometer``; figure 7,
at whose plane it stops: ``estimators.magnetometer.ellipsoid``.

Hard and soft iron of a magnetometer from readings in many attitudes, of records of the bench or of a log.

Source: ``estimators.magnetometer.ellipsoid``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Estimates,
    Evidence,
    Figure,
    Floats,
    Material,
    Table,
    curve,
    estimate,
    evidence_of,
    no_result,
    number,
    unseen_tables,
    with_uncertainty,
    worded_figure,
)
from bench.maths.arrays import Integers
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.coefficients import magnetometer_section
from bench.systems.gnc.declaration import AXES
from bench.systems.gnc.estimators.magnetometer.ellipse import PlaneParameters
from bench.systems.gnc.estimators.magnetometer.ellipsoid import EllipsoidFit, fit_ellipsoid
from bench.systems.gnc.estimators.magnetometer.plane import ELLIPSE, EXTREMES, PlaneComparison, compare_methods, widened
from bench.systems.gnc.estimators.magnetometer.wander import Wander
from bench.systems.gnc.field_departures import Cloud, searches_of
from bench.systems.gnc.field_evidence import (
    answers_of,
    endless_noise,
    plausible_plane,
    plausible_sphere,
    roll_estimates,
    shown_unit,
)
from bench.systems.gnc.limits import limits_of, table_3
from bench.systems.gnc.rows import (
    SampledRow,
    check_notes,
    check_table,
    checked,
    no_records,
    sampled_rows,
    temperature_span,
    usable,
)
from bench.systems.gnc.wording import refused, say

_MOST_SAMPLES = 20_000  # an even choice of more says nothing that these do not
_CIRCLE_SAMPLES = 2_000
METHODS = (ELLIPSE, EXTREMES)
NON_MAGNETIC = "non_magnetic"
_PARAMETERS = (("mag_offset", None, "x"), ("mag_offset", None, "y"), ("mag_gain", "1", None),
               ("mag_angle", "deg", None), ("mag_radius", None, None))  # fmt: skip
_ATTITUDES = "attitudes"
ITEMS = ("magnetometer", _ATTITUDES)


@dataclass(frozen=True)
class Sphere:
    """Result of readings in many attitudes; all empty where there are none of them.

    ``points`` (n, 3): readings of the fit; ``places`` (n, 2): record and reading of each, from 0.
    ``wander``, ``wander_dof``: of a sum of readings of the records, as ``widened`` takes them.
    """

    fit: EllipsoidFit | None = None
    points: Floats = field(default_factory=lambda: np.empty((0, 3)))
    places: Integers = field(default_factory=lambda: np.empty((0, 2), int))
    every: int = 1  # reading of the records that was taken
    estimates: Estimates = field(default_factory=list)
    evidence: list[Evidence] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)

    @property
    def wander(self) -> float:
        """Variance of a sum of readings over that of independent noise; 1 where nothing is known of it."""
        if self.fit is None or not self.fit.quadric.wander.blocks:
            return 1.0
        return 1.0 + self.every * (max(self.fit.quadric.wander.factor, 1.0) ** 2 - 1.0)

    @property
    def wander_dof(self) -> float:
        """Degrees of freedom behind it."""
        return math.inf if self.fit is None else float(self.fit.hard_iron_dof.min())

    def cloud(self, numbers: Sequence[int], time_s: Sequence[Floats]) -> Cloud | None:
        """Return the readings of the fit, with numbers and times of all readings of the records."""
        if self.fit is None:
            return None
        record, reading = self.places.T
        times = np.array([time_s[at][number] for at, number in zip(record, reading, strict=True)])
        by_surface = self.fit.slope[[0, 1, 2, *(3 + 3 * row + column for row in range(3) for column in range(row + 1))]]
        what = say("attitudes")
        return Cloud(what, self.fit.quadric, self.points, np.array(numbers)[record], times, by_surface, self.estimates)


def sphere_of(records: Sequence[Floats], unit: str = "gauss", noise: float | None = None) -> Sphere:
    """Return hard iron and symmetric soft iron of readings in many attitudes.

    Readings that do not determine the ellipsoid are named as missing, with the direction they lack.

    Args: records: (n, 3) readings of each.   unit: of the readings; "1" for counts, of which no field is known.
        noise: of readings that hold none.
    """
    chosen, begins, every = _chosen(records)
    try:
        fit = fit_ellipsoid(chosen, begins=begins, noise=noise)
    except FitError as error:
        return Sphere(missing=[refused(say("iron"), error.message, error.code)])
    notes = [say("note.iron", text=sentence) for sentence in fit.coverage.sentences]
    notes += noise_notes(say("of.attitudes"), fit.quadric.wander, int(fit.odd.sum()), fit.odd.size)
    places = np.concatenate([
        np.column_stack([np.full(len(of_record[::every]), at), np.arange(0, len(of_record), every)])
        for at, of_record in enumerate(records)
    ])  # fmt: skip
    return Sphere(
        fit=fit,
        points=chosen[~fit.odd],
        places=places[~fit.odd],
        every=every,
        estimates=_sphere_estimates(fit, unit),
        evidence=[
            endless_noise(fit.quadric, say("attitudes"), {}),
            *plausible_sphere(fit, unit),
        ],
        notes=notes,
        figures=[_sphere_figure(fit, chosen[~fit.odd], unit)],
    )


def _chosen(records: Sequence[Floats]) -> tuple[Floats, list[int], int]:
    """Return readings of all records, (n, 3), thinned alike where they are many, the first of each record, and the
    number of readings from one that was taken to the next.
    """
    every = max(1, -(-sum(map(len, records)) // _MOST_SAMPLES))
    thinned = [readings[::every] for readings in records]
    begins = np.cumsum([0, *(len(readings) for readings in thinned)])
    return np.concatenate(thinned), begins[:-1].tolist(), every


def noise_notes(what: str, wander: Wander, odd: int, count: int) -> list[str]:
    """Return what was left out, and what noise that wanders did to the intervals."""
    notes = []
    if odd:
        notes.append(say("note.odd", what=what, odd=odd, count=count))
    if wander.blocks:
        notes.append(say("note.wander", what=what, blocks=wander.blocks, times=wander.factor))
    return notes


def _sphere_estimates(fit: EllipsoidFit, unit: str) -> Estimates:
    kind = {"kind": "magnetometer", "method": "ellipsoid"}
    n, dropped = int((~fit.odd).sum()), int(fit.odd.sum())
    std = np.sqrt(np.diag(fit.hard_iron_covariance))
    entries = [
        estimate(
            "mag_hard_iron", unit, fit.hard_iron[k], std[k], kind | {"axis": axis}, n=n, dropped=dropped,
            dof=fit.hard_iron_dof[k],
        )
        for k, axis in enumerate(AXES)
    ]  # fmt: skip
    for row, name in enumerate(AXES):
        for column in range(row + 1):
            value, step = float(fit.symmetric[row, column]), float(fit.symmetric_std[row, column])
            place = kind | {"row": name, "column": AXES[column]}
            dof = float(fit.symmetric_dof[row, column])
            entries.append(estimate("mag_soft_iron", "1", value, step, place, n=n, dropped=dropped, dof=dof))
    return entries


def _sphere_figure(fit: EllipsoidFit, readings: Floats, unit: str) -> Figure:
    shown = readings[:: max(1, len(readings) // _CIRCLE_SAMPLES)]
    factor, name = shown_unit(unit)
    before = factor * np.linalg.norm(shown, axis=1)
    after = factor * np.linalg.norm(fit.corrected(shown), axis=1)
    number = np.arange(len(shown), dtype=np.float64)
    parts = [curve(say("before"), number, before, "points"), curve(say("after"), number, after, "points")]
    return worded_figure(say, "size", ("size.x", "size.y"), parts, noise=factor * fit.noise, unit=name)


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return offsets, gain and non-orthogonality by both methods; ``method`` says which one compensates.

    Raises: FitError B-GNC-001, -003; B-FIT-090, -091 if no record determines an ellipse.
    """
    rows, missing = sampled_rows(material, ITEMS)
    looked_at = checked(rows, ("magnetometer",), material.campaign)
    good, bad = usable(looked_at)
    missing += bad
    turns = turns_of(good, missing)
    others = [row for row in good if row.item == _ATTITUDES]
    attitudes = attitudes_of(good)
    sphere = sphere_of(attitudes) if attitudes else Sphere(notes=[say("note.no_attitudes")])
    missing += sphere.missing
    fits = [(row, widened(fit, sphere.wander, sphere.wander_dof)) for row, fit in turns]
    parameters = fits[0][1].by_method[method]
    planes = [_estimates(row, fit, len(fits) > 1) for row, fit in fits]
    estimates = [entry for stated in planes for entry in stated]
    limit_deg, noise = limits_of(material.campaign)["roll_error"], fits[0][1].ellipse.noise
    estimates += roll_estimates(answers_of(material), fits[0][1].by_method, method, limit_deg, noise)
    clouds = [
        turn_cloud(row.number, say("turn"), row.values("magnetometer"), row.begin_s + row.time_s, fit, stated)
        for (row, fit), stated in zip(fits, planes, strict=True)
    ]
    of_attitudes = sphere.cloud([row.number for row in others], [row.begin_s + row.time_s for row in others])
    searches = searches_of(clouds, of_attitudes, shown_unit("gauss"))
    return Analysis(
        "magnetometer",
        method,
        material.campaign["uut"],
        [*estimates, *sphere.estimates],
        evidence=[
            *_evidence(turns),
            *sphere.evidence,
            *evidence_of(searches),
        ],
        notes=[
            *_notes(fits, material),
            *sphere.notes,
            *([say("note.offset_and_iron")] if sphere.estimates else []),
            *check_notes(looked_at),
            *no_result(missing),
        ],
        missing=missing,
        figures=[*_figures(fits[0][0], parameters), *sphere.figures],
        tables=[
            _table(fits[0][1]),
            table_3(estimates, material.campaign),
            check_table(looked_at),
            *unseen_tables(searches),
        ],
        compensation=[magnetometer_section(method, parameters, temperature_span([fits[0][0]]))],
    )


def attitudes_of(rows: Sequence[SampledRow]) -> list[Floats]:
    """Return the readings of each record in another attitude."""
    return [row.values("magnetometer") for row in rows if row.item == _ATTITUDES]


def turns_of(
    rows: Sequence[SampledRow], missing: list[str], noise: float | None = None
) -> list[tuple[SampledRow, PlaneComparison]]:
    """Return both methods on each turn about the roll axis; one that determines no ellipse is named as missing.

    ``noise``: of readings that hold none.

    Raises: FitError of the first turn if none does, B-GNC-003 if there is none.
    """
    fits: list[tuple[SampledRow, PlaneComparison]] = []
    errors: list[FitError] = []
    for row in (row for row in rows if row.item != _ATTITUDES):
        field = row.values("magnetometer")
        try:
            fits.append((row, compare_methods(field[:, 0], field[:, 1], noise)))
        except FitError as error:
            errors.append(error)
            missing.append(refused(say("record", number=row.number), error.message, error.code))
    if not fits:
        raise errors[0] if errors else no_records(("magnetometer",))
    return fits


def plane_estimates(fits: Sequence[tuple[SampledRow, PlaneComparison]]) -> Estimates:
    """Return the estimates of both methods on each turn."""
    return [entry for row, fit in fits for entry in _estimates(row, fit, len(fits) > 1)]


def _estimates(row: SampledRow, fit: PlaneComparison, several: bool) -> Estimates:
    return parameter_estimates(fit, fit.by_method, {"record": row.number} if several else {})


def parameter_estimates(
    fit: PlaneComparison, by_method: Mapping[str, PlaneParameters], about: Document, unit: str = "gauss"
) -> Estimates:
    """Return the parameters of a turn by each method; ``unit``: of the readings."""
    entries = []
    counted = {"n": int((~fit.ellipse.odd).sum()), "dropped": int(fit.ellipse.odd.sum())}
    for method, parameters in by_method.items():
        values = zip(_PARAMETERS, parameters.values, parameters.std, parameters.dof, strict=True)
        for (quantity, own, axis), value, std, dof in values:
            place = {"kind": "magnetometer", "method": method, **about} | ({} if axis is None else {"axis": axis})
            entries.append(estimate(quantity, own or unit, value, std, place, dof=dof, **counted))
    return entries


def turn_cloud(
    number: int, what: str, readings: Floats, time_s: Floats, fit: PlaneComparison, stated: Estimates
) -> Cloud:
    """Return the readings (n, 3) of a turn, of which ``stated`` has the parameters of one method after the other."""
    kept, by_surface = ~fit.ellipse.odd, np.tile(fit.ellipse.slope, (len(stated) // len(_PARAMETERS), 1))
    record = np.full(int(kept.sum()), number)
    return Cloud(what, fit.ellipse.quadric, readings[kept], record, time_s[kept], by_surface, stated)


def _evidence(fits: Sequence[tuple[SampledRow, PlaneComparison]]) -> list[Evidence]:
    """Return what every check says of the turns by their own noise, those that found nothing included."""
    found = []
    for row, fit in fits:
        about = {"record": row.number} if len(fits) > 1 else {}
        found.append(endless_noise(fit.ellipse.quadric, say("record", number=row.number), about))
        found += plausible_plane(fit.ellipse, about)
    return found


def _table(fit: PlaneComparison) -> Table:
    names = [say(f"plane.row.{name}") for name in ("offset_x", "offset_y", "gain", "angle", "field")]
    factors = (1e3, 1e3, 1.0, 1.0, 1e3)
    extremes, ellipse = fit.by_method[EXTREMES], fit.by_method[ELLIPSE]
    rows = [
        [
            name,
            *(_interval(by, k, factor) for by in (extremes, ellipse)),
            number(float(fit.score[k]), 1),
        ]
        for k, (name, factor) in enumerate(zip(names, factors, strict=True))
    ]
    rolls = [f"{fit.roll_std_deg[method]:.2g}" for method in (EXTREMES, ELLIPSE)]
    rows.append([say("plane.row.roll"), *rolls, "–"])
    rms, largest = fit.roll_difference_deg
    phases = fit.extremes.phases
    key = "plane.caption_phases" if phases else "plane.caption"
    caption = say(key, rms=rms, largest=largest, phases=phases)
    headers = say.heads("plane", "parameter", "extremes", "ellipse", "difference")
    return Table(say("plane.title"), caption, headers, rows, prose=True, lead=True)


def _interval(parameters: PlaneParameters, k: int, factor: float) -> str:
    reach = factor * coverage_factor(float(parameters.dof[k])) * parameters.std[k]
    return with_uncertainty(factor * parameters.values[k], reach)


def _figures(row: SampledRow, parameters: PlaneParameters) -> list[Figure]:
    """X against Y as read and corrected, and both components against time."""
    field = 1e3 * row.values("magnetometer")
    x, y = parameters.corrected(field[:, 0] / 1e3, field[:, 1] / 1e3)
    caption = say("circle.caption", radius=1e3 * parameters.radius)
    parts = [curve(say("before"), field[:, 0], field[:, 1], "points"), curve(say("after"), 1e3 * x, 1e3 * y, "points")]
    plane = Figure(say("circle.title"), caption, "X, mgauss", "Y, mgauss", parts, equal=True)
    turn = slice(0, max(2, int(60.0 * row.rate_Hz)))
    time_s = row.time_s[turn]
    parts = [curve(axis, time_s, field[turn, k], "line") for k, axis in enumerate(AXES)]
    return [plane, worded_figure(say, "minute", ("time", "size.y"), parts, unit="mgauss")]


def _notes(fits: Sequence[tuple[SampledRow, PlaneComparison]], material: Material) -> list[str]:
    sentences = []
    for row, fit in fits:
        table = row.conditions.get("table", material.campaign.get("table"))
        if table != NON_MAGNETIC:
            key = "note.table_unknown" if table is None else "note.table"
            sentences.append(say(key, number=row.number, table=table))
        ellipse = fit.ellipse
        sentences.append(
            say(
                "note.turn" if ellipse.phases else "note.turn_whole",
                number=row.number,
                phases=ellipse.phases,
                gap=ellipse.largest_gap_deg,
                noise=1e3 * ellipse.noise,
            )
        )
        sentences += noise_notes(
            say("of.record", number=row.number), ellipse.quadric.wander, int(ellipse.odd.sum()), ellipse.odd.size
        )
    return sentences
