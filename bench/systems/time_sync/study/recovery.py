"""Offset as the augmented filter finds it, cases where it must not find any, and what it believes of itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import Estimate, Estimates
from bench.systems.time_sync.study.results import FlightResult, Results, measured, rms_std
from bench.systems.time_sync.study.study import (
    AUGMENTED,
    BASE,
    LOOSE,
    TIGHT,
    Group,
    MANOEUVRE_s,
    RECOVERED_ms,
    SHORT_s,
    SHOWN_ms,
)

_MEAN_ms, _RMS_ms, _LEFT, _NEES, _NEES_MOST = 0.5, 1.0, 0.9, (0.3, 3.0), 3.0
_SOON_s, _NEES_AT_s = MANOEUVRE_s[0] + 2.0, 100.0
SEEN_s = 22.0  # where the observability of the manoeuvres is compared


def augmented(offset_ms: float, noise: str = BASE) -> Group:
    """Return the filter with a state for the offset."""
    return Group(offset_ms * 1e-3, augmented=True, noise=noise)


def recovery_estimates(results: Results, offsets_ms: tuple[float, ...]) -> Estimates:
    """Recovered offsets by manoeuvre, consistency, observability."""
    return [
        *_found_in(results, "turn", (_SOON_s, MANOEUVRE_s[1], SHORT_s), judged=True),
        *_straight(results),
        *_found_in(results, "acceleration", (_SOON_s, SHORT_s), judged=False),
        *_long(results, offsets_ms),
        *_observability(results),
    ]


def near(flight: FlightResult, at_s: float) -> int:
    """Index of the epoch next to a time."""
    return int(np.argmin(np.abs(flight.t_s - at_s)))


def _conditions(manoeuvre: str, offset_ms: float, at_s: float, noise: str = BASE) -> dict[str, Any]:
    return {"manoeuvre": manoeuvre, "offset_ms": offset_ms, "filter": AUGMENTED, "noise": noise, "at_s": at_s}


def _remaining(flight: FlightResult, group: Group, conditions: dict[str, Any], *, judged: bool) -> Estimates:
    """Return mean and RMS error of the offset at a time."""
    at, column = near(flight, conditions["at_s"]), flight.at(group)
    mean_ms, rms_ms = 1e3 * flight.offset_mean_s[at, column], 1e3 * flight.offset_rms_s[at, column]
    std_ms = float(np.sqrt(max(rms_ms**2 - mean_ms**2, 0.0) / flight.runs))
    mean_ends = {"at_least": -_MEAN_ms, "at_most": _MEAN_ms} if judged else {}
    rms_ends = {"at_most": _RMS_ms} if judged else {}
    n = flight.runs
    return [
        measured("offset_error_mean", "ms", float(mean_ms), std_ms, conditions, n=n, **mean_ends),
        measured("offset_error_rms", "ms", float(rms_ms), rms_std(float(rms_ms), n), conditions, n=n, **rms_ends),
    ]


def _found_in(results: Results, manoeuvre: str, times_s: Sequence[float], *, judged: bool) -> Estimates:
    """Errors that are left of every offset at some times; the turn finds it, whatever it is."""
    flight = results.flight(manoeuvre, augmented=True)
    return [
        entry
        for offset_ms in RECOVERED_ms
        for at_s in times_s
        for entry in _remaining(flight, augmented(offset_ms), _conditions(manoeuvre, offset_ms, at_s), judged=judged)
    ]


def _straight(results: Results) -> Estimates:
    """Straight and level flight cannot tell an offset from a distance: a filter that converges has seen the truth."""
    flight = results.flight("linear", augmented=True)
    documents: Estimates = []
    for offset_ms in RECOVERED_ms:
        column, conditions = flight.at(augmented(offset_ms)), _conditions("linear", offset_ms, SHORT_s)
        rms_ms, nees = float(1e3 * flight.offset_rms_s[-1, column]), float(flight.offset_nees[-1, column])
        ends = {"at_least": _LEFT * abs(offset_ms)} if offset_ms else {}
        std_ms = rms_std(rms_ms, flight.runs)
        documents.append(measured("offset_error_rms", "ms", rms_ms, std_ms, conditions, n=flight.runs, **ends))
        documents.append(measured("offset_nees", "1", nees, 0.0, conditions, n=flight.runs, at_most=_NEES_MOST))
    return [*documents, _straight_consistency(flight)]


def _straight_consistency(flight: FlightResult) -> Estimate:
    """NEES over all offsets: a single one is as small as its offset is against the 30 ms at the begin, their mean not.

    Too small a mean is a filter that has seen the truth, or one that doubts more than it was told to.
    """
    low, high = _NEES
    columns = [flight.at(augmented(offset_ms)) for offset_ms in RECOVERED_ms]
    nees, n = float(flight.offset_nees[-1, columns].mean()), flight.runs * len(columns)
    conditions = {"manoeuvre": "linear", "filter": AUGMENTED, "noise": BASE, "at_s": SHORT_s}
    return measured("offset_nees_over_offsets", "1", nees, 0.0, conditions, n=n, at_least=low, at_most=high)


def _long(results: Results, offsets_ms: tuple[float, ...]) -> Estimates:
    """Return the flight with images: after its turn, and whether the filter knows how well it does."""
    documents: Estimates = []
    low, high = _NEES
    for offset_ms in offsets_ms:
        for noise in (LOOSE, TIGHT):
            group = augmented(offset_ms, noise)
            flight, column = results.long_flight(group)
            conditions = _conditions("sar", offset_ms, _NEES_AT_s, noise)
            documents += _remaining(flight, group, conditions, judged=noise == LOOSE)
            at = near(flight, _NEES_AT_s)
            ends = {"at_least": low, "at_most": high} if noise == LOOSE else {}
            nees = float(flight.offset_nees[at, column])
            std = nees * float(np.sqrt(2.0 / flight.runs))
            documents.append(measured("offset_nees", "1", nees, std, conditions, n=flight.runs, **ends))
            for name, value, unit in (
                ("nis_ratio", float(flight.nis_ratio[column]), "1"),
                ("nis_outside", float(flight.nis_outside[column]), "1"),
                ("offset_sigma", float(1e3 * flight.offset_sigma_s[at, column]), "ms"),
            ):
                documents.append(measured(name, unit, value, 0.0, conditions, n=flight.runs))
    return documents


def _observability(results: Results) -> Estimates:
    """Figure 16, at a time instead of over the whole flight."""
    documents: Estimates = []
    for manoeuvre in ("linear", "acceleration", "turn"):
        flight = results.flight(manoeuvre, augmented=True)
        at, column = near(flight, SEEN_s), flight.at(augmented(SHOWN_ms))
        conditions = _conditions(manoeuvre, SHOWN_ms, SEEN_s)
        whole = float(np.sqrt(np.mean(flight.eigenvalue[:, column] ** 2)))
        for quantity, value, where in (
            ("offset_eigenvalue", float(flight.eigenvalue[at, column]), conditions),
            ("offset_variance_ratio", float(flight.share[at, column]), conditions),
            ("offset_eigenvalue_rms", whole, {**conditions, "at_s": None}),
        ):
            documents.append(measured(quantity, "1", value, 0.0, where, n=flight.runs))
    return documents
