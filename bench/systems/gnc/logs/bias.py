"""Noise and bias of inertial sensors from a log taken at rest: mean, terms of the Allan deviation, stability of means.

Any axes of gyroscopes and accelerometers; no pose is needed, because nothing is said of the scale. The long terms are
those that the means of the log show (``long_terms``); the fit to its Allan deviation says how large they are.

Source: IEEE Std 952-1997 annex C (noise terms); GNC-module paper section 5.1 3) (standard deviation of means of 10 s).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

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
    noise_evidence,
    possible_terms,
    with_uncertainty,
    worded_table,
)
from bench.maths.allan_terms import GYRO_TERMS, UNITS
from bench.maths.arrays import Integers
from bench.maths.long_terms import NoiseAtRest, noise_at_rest
from bench.maths.samples import frozen_runs, is_silent
from bench.maths.stamps import SampleStamps, sample_stamps
from bench.model.errors import FitError
from bench.systems.gnc.estimators.bias_stability import (
    AVERAGES,
    AVERAGE_s,
    BiasStability,
    bias_stability,
    on_the_counter,
)
from bench.systems.gnc.wording import channel_name, kind_name, quantity_word, say

METHODS = ("allan",)
_FEWEST_MEANS = 30  # of 10 s, for their scatter to be stated
_MOVED = 5.0  # times the usual scatter within a second
_DEG_H = 3600.0  # in a deg/s
_OTHER = {"white_noise": "velocity_random_walk", "random_walk": "acceleration_random_walk"}


@dataclass(frozen=True)
class Resting:
    """One sensor at rest: its readings and their places in time, in intervals, and what they show.

    ``samples``: at even times, NaN where one is missing.   ``noise``: terms and what the mean is worth.
    """

    kind: str
    axis: str
    unit: str
    samples: Floats
    interval_s: float
    noise: NoiseAtRest

    @property
    def place(self) -> dict[str, Any]:
        """Conditions of its estimates."""
        return {"kind": self.kind, "axis": self.axis}

    @property
    def name(self) -> str:
        """Return kind and axis for people."""
        return channel_name(f"{self.kind} {self.axis}")


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return mean, noise terms and stability of each sensor of a log at rest.

    Raises: FitError B-FIT-004 (unknown method), B-GNC-006 without a sensor, B-FIT-141 (stamps), B-FIT-030, -031 if
            there are too few readings.
    """
    t_s = material.series.get("t_s", np.empty(0))
    columns = [c for c in material.campaign.get("columns", ()) if c.get("role") in ("gyro", "accelerometer")]
    if not columns:
        raise FitError(
            "B-GNC-006",
            "the log has no column of a gyroscope or an accelerometer",
            next_step="map columns of the role gyro or accelerometer (docs/importing.md)",
        )
    stamps = sample_stamps(t_s)
    counter = stamps.counter(t_s)
    silent = [c for c in columns if is_silent(material.series[str(c["name"])])]
    sensors = [_resting(c, material.series[str(c["name"])], counter, stamps) for c in columns if c not in silent]
    entries = [entry for sensor in sensors for entry in _estimates(sensor)]
    return Analysis(
        "bias_log",
        method,
        material.campaign["uut"],
        entries,
        evidence=[check for sensor in sensors for check in _evidence(sensor)],
        notes=_notes(sensors, stamps),
        missing=[say("log.silent", sensor=channel_name(f"{c['role']} {c['axis']}")) for c in silent],
        tables=[_table(sensors, entries)] if sensors else [],
        figures=_figures(sensors),
    )


def _resting(column: Document, values: Floats, counter: Integers, stamps: SampleStamps) -> Resting:
    interval_s = 1.0 / stamps.rate_Hz
    # a gap as long as the log itself already leaves no difference across it; a longer one would only fill memory
    steps = np.minimum(np.diff(counter, prepend=counter[0]), len(values))
    samples = on_the_counter(np.cumsum(steps), values)
    role, axis, unit = (str(column[key]) for key in ("role", "axis", "unit"))
    return Resting(role, axis, unit, samples, interval_s, noise_at_rest(samples, interval_s))


def _estimates(sensor: Resting) -> Estimates:
    n = int(np.isfinite(sensor.samples).sum())
    counted = {"n": n, "dropped": sensor.samples.size - n}
    in_h = (_DEG_H, "deg/h") if sensor.unit == "deg/s" else (1.0, sensor.unit)
    long = sensor.noise.long
    mean, std, factor = in_h[0] * float(np.nanmean(sensor.samples)), in_h[0] * long.std, long.expanded / long.std
    ahead = sensor.place | {"length_s": round(n * sensor.interval_s, 3), "gap_s": 0.0}
    entries = [
        estimate("mean_output", in_h[1], mean, std, sensor.place, factor=factor, **counted),
        estimate("next_mean_output", in_h[1], mean, math.sqrt(2.0) * std, ahead, factor=factor, **counted),
    ]
    for term in sensor.noise.stated:
        name, unit, factor = _named(sensor, term.name)
        value, std = factor * term.coefficient, factor * term.std_uncertainty
        entries.append(estimate(name, unit, value, std, sensor.place, **counted))
    found = _stability(sensor)
    if found is not None:
        about = sensor.place | {"averages": found.averages.size, "average_s": AVERAGE_s}
        value, std = in_h[0] * found.value, in_h[0] * found.std
        entries.append(estimate("bias_stability", in_h[1], value, std, about, dof=found.dof, **counted))
    return entries


def _stability(sensor: Resting) -> BiasStability | None:
    """Return the scatter of means of 10 s, None for a log with fewer than 30 or with a gap in one."""
    averages = min(AVERAGES, int(sensor.samples.size * sensor.interval_s / AVERAGE_s))
    if averages < _FEWEST_MEANS:
        return None
    try:
        return bias_stability(sensor.samples, sensor.interval_s, averages)
    except FitError as error:
        if error.code != "B-FIT-092":
            raise
        return None


def _named(sensor: Resting, term: str) -> tuple[str, str, float]:
    if sensor.unit == "deg/s":
        name, unit, factor = GYRO_TERMS[term]
        return name, unit, factor * _DEG_H
    return _OTHER.get(term, term), f"{sensor.unit}{UNITS[term]}", 1.0


def _evidence(sensor: Resting) -> list[Evidence]:
    """Return what says that the sensor was not at rest, or did not answer."""
    found = []
    if frozen_runs(sensor.axis, sensor.samples[np.isfinite(sensor.samples)]):
        text = say("evidence.hung", sensor=sensor.name)
        found.append(Evidence("stands_still", text, None, 0.0, conditions=sensor.place))
    terms = [_named(sensor, term.name)[0] for term in sensor.noise.stated]
    found += noise_evidence(sensor.noise, sensor.name, terms, sensor.place)
    scatter = _scatter(sensor)
    usual = float(np.median(scatter)) if scatter.size else 0.0
    worst = int(np.argmax(scatter)) if scatter.size else 0
    if usual > 0.0 and scatter[worst] > _MOVED * usual:
        text = say("evidence.moved", sensor=sensor.name, times=float(scatter[worst] / usual), second=worst)
        found.append(Evidence("not_at_rest", text, float(scatter[worst] / usual), 0.0, conditions=sensor.place))
    return found


def _scatter(sensor: Resting) -> Floats:
    """Return standard deviation within each second without a gap; none for fewer than eight samples a second."""
    size = round(1.0 / sensor.interval_s)
    if size < 8:
        return np.empty(0)
    seconds = sensor.samples[: sensor.samples.size // size * size].reshape(-1, size)
    return np.asarray(np.std(seconds[np.isfinite(seconds).all(axis=1)], axis=1))


def _notes(sensors: Sequence[Resting], stamps: SampleStamps) -> list[str]:
    notes = [say("log.counted", rate=stamps.rate_Hz)]
    if len(stamps.breaks):
        notes.append(say("log.not_filled", missing=stamps.missing, gaps=len(stamps.breaks)))
    if any(sensor.kind == "gyro" for sensor in sensors):
        notes.append(say("log.earth_rate"))
    for sensor in sensors:
        notes += _noise_notes(sensor)
    return notes


def _noise_notes(sensor: Resting) -> Iterator[str]:
    noise = sensor.noise
    if noise.white_from_s > sensor.interval_s:
        yield say("log.filtered", sensor=sensor.name, time=noise.white_from_s)
    names = [quantity_word(_named(sensor, name)[0]) for name in noise.long.possible]
    yield from possible_terms(noise, sensor.name, names)
    stated = {term.name for term in noise.terms.terms if term.coefficient > 0.0}
    absent = [
        say("log.below", quantity=quantity_word(name), limit=factor * term.upper_limit, unit=unit)
        for term in noise.absent
        if term.name not in stated and math.isfinite(term.upper_limit)
        for name, unit, factor in (_named(sensor, term.name),)
    ]
    if absent:
        yield say("log.absent", sensor=sensor.name, terms=say.listed(absent))
    if "bias_instability" in noise.long.present:
        yield say("log.instability", sensor=sensor.name, first=noise.white_from_s, last=noise.deviation.tau_s[-1])


def _table(sensors: Sequence[Resting], entries: Estimates) -> Table:
    names = list(dict.fromkeys((entry.quantity, entry.unit) for entry in entries))
    rows: list[list[Any]] = []
    for sensor in sensors:
        own = {
            (entry.quantity, entry.unit): with_uncertainty(entry.value, entry.expanded_uncertainty)
            for entry in entries
            if sensor.place.items() <= entry.conditions.items()
        }
        scatter = f"{np.nanstd(sensor.samples, ddof=1):.4g} {sensor.unit}"
        rows.append([sensor.name, scatter, *(own.get(name, "–") for name in names)])
    of_quantities = [say("in_unit", quantity=quantity_word(quantity), unit=unit) for quantity, unit in names]
    return worded_table(say, "resting", ["sensor", "sample"], rows, of_quantities, lead=True)


def _figures(sensors: Sequence[Resting]) -> list[Figure]:
    figures = []
    for kind in dict.fromkeys(sensor.kind for sensor in sensors):
        of_kind = [sensor for sensor in sensors if sensor.kind == kind]
        parts = [curve(s.axis, s.noise.deviation.tau_s, s.noise.deviation.deviation, "points") for s in of_kind]
        parts += [curve(say("log.fit", axis=s.axis), *s.noise.fitted) for s in of_kind]
        title = say("log.allan", kind=kind_name(kind))
        figures.append(Figure(title, "", say("allan.x"), of_kind[0].unit, parts, x_log=True, y_log=True))
    return figures
