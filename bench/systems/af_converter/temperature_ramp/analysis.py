"""Analysis of an imported temperature ramp: what a reading does with temperature, time, direction and lag.

Two models side by side: cubic in temperature, quadratic in time and an up/down term ("drift"), and the joint fit of lag
and hysteresis that the bias campaign uses, with the same drift terms.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bench.analysis import Analysis, Estimates, Material, check_method, estimate, no_result
from bench.systems.af_converter.estimators.drift_ramp import BRANCH, DRIFT_NAMES, TEMPERATURE_NAMES, Blocks, block_means
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.temperature_ramp.evidence import evidence
from bench.systems.af_converter.temperature_ramp.fits import (
    RampColumns,
    ReadingFit,
    fit_reading,
    plain_campaign,
    ramp_columns,
)
from bench.systems.af_converter.temperature_ramp.report import figures, tables
from bench.systems.af_converter.wording import say

METHODS: tuple[str, ...] = ("joint", "drift")
MOST_BLOCKS = 240


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Fit every reading of an imported ramp.

    ``method``: "joint" fits lag and hysteresis too, "drift" leaves that out.
    Raises: FitError B-FIT-004 (unknown method), B-FIT-060, B-FIT-061 (see ramp_columns), B-FIT-001.
    """
    check_method(method, METHODS)
    uut, reference_degC = plain_campaign(material.campaign)
    columns = ramp_columns(material)
    blocks = block_means(columns.t_s, min(MOST_BLOCKS, columns.t_s.size // 2))
    fits = [fit_reading(name, columns, blocks, reference_degC, method) for name in columns.readings]
    return Analysis(
        campaign="temperature_ramp",
        method=method,
        uut=uut,
        estimates=[entry for fit in fits for entry in _estimates(fit, columns, reference_degC)],
        notes=_notes(columns, blocks, fits),
        missing=[_not_joint(fit) for fit in fits if fit.joint is not None and fit.joint.fit.beyond],
        figures=figures(columns, blocks, fits),
        tables=tables(columns, fits),
        evidence=[*columns.still, *evidence(fits, columns, blocks, reference_degC)],
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
        per = "/degC" + (str(order) if order > 1 else "")
        entries.append(entry(f"{fit.name}_tc{order}", f"{unit}{per}", fit.drift.estimate(name), about))
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
