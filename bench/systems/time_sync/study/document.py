"""study.json and its page: every estimate with tolerance and verdict, what is assumed, and what cannot be matched.

The same tasks give the same bytes.

Figures of the study, numbered as in the paper: errors, offset, observability over time, and the focused target.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import (
    Chapter,
    Document,
    Estimate,
    Figure,
    Series,
    Table,
    documents,
    estimates_of,
    results_json,
    series,
)
from bench.maths.arrays import rms
from bench.systems.time_sync.estimators.sar.image import levels_dB
from bench.systems.time_sync.estimators.sar.response import Response
from bench.systems.time_sync.image import drawn
from bench.systems.time_sync.study.errors import BODY, error_estimates, recovery_estimates
from bench.systems.time_sync.study.images import figures_of, image_estimates
from bench.systems.time_sync.study.study import (
    BASE,
    ERRORLESS,
    FLOWN,
    LOOSE,
    NAME,
    SIGMA_R,
    TIGHT,
    FlightResult,
    Group,
    Results,
    SHOWN_ms,
    StudyOptions,
    tasks_of,
    unjudged,
)
from bench.systems.time_sync.study.tables import (
    Estimates,
    bias_table,
    image_table,
    long_table,
    observability_table,
    paired_table,
    paper_tables,
    plain,
    recovered_table,
    said,
    several_table,
)
from bench.systems.time_sync.study.tasks import IMAGED

_TIME = "time / s"
_RMS = "Ours: RMS over the runs. The paper's axis: error over time, its scale not in the text."
_NUMBERS = {False: ("8", "9", "10"), True: ("12", "13", "14")}
_INDICES = (
    ("azimuth_shift_m", "shift", "m"),
    ("azimuth_resolution_m", "resolution", "m"),
    ("pslr_dB", "PSLR", "dB"),
    ("islr_dB", "ISLR", "dB"),
)


def error_figures(results: Results, offsets_ms: Sequence[float]) -> list[Figure]:
    """Return figures 3 to 7: the filter without a state for the offset."""
    still, linear, faster, turn = (
        results.flight(manoeuvre, augmented=False) for manoeuvre in ("stationary", "linear", "acceleration", "turn")
    )
    position, velocity, yaw = ("position_m", 0, BASE), ("velocity_m_s", 0, BASE), ("attitude_deg", 2, BASE)
    plans: tuple[tuple[str, str, FlightResult, tuple[str, int, str], str], ...] = (
        ("3", "stationary, north", still, position, "position / m"),
        ("4", "linear, north", linear, position, "position / m"),
        ("5", "(a) acceleration, north velocity", faster, velocity, "velocity / m/s"),
        ("5", "(b) accelerometer bias, forward", faster, ("accel_bias_ug", 0, TIGHT), "bias / ug"),
        ("6", "(a) turn, yaw", turn, yaw, "attitude / deg"),
        ("6", "(b) gyro bias, down", turn, ("gyro_bias_deg_h", 2, TIGHT), "bias / deg/h"),
        *(
            ("7", f"turn, accelerometer bias, {name}", turn, ("accel_bias_ug", axis, TIGHT), "bias / ug")
            for axis, name in enumerate(BODY)
        ),
    )
    return [_over_time(*plan, offsets_ms) for plan in plans]


_CAPTIONS = {
    "3": "A vehicle that stands still does not notice: the curves lie on each other.",
    "4": "The position lags by v T_d.",
    "5": "Measurement noise: (a) base, (b) tight.",
    "6": "Measurement noise: (a) base, (b) tight.",
    "7": "Tight measurement noise. The bias along the axis of rotation is not reached.",
}


def _over_time(
    number: str, title: str, flight: FlightResult, what: tuple[str, int, str], label: str, offsets_ms: Sequence[float]
) -> Figure:
    name, axis, noise = what
    parts = [
        series(f"{offset_ms:g} ms", flight.t_s, flight.rms[name][:, flight.at(Group(offset_ms, noise=noise)), axis])
        for offset_ms in offsets_ms
    ]
    caption = f"Figure {number}. {_CAPTIONS[number]} {_RMS}"
    return Figure(f"Fig. {number} {title}", caption, _TIME, label, parts, f"figure {number}")


def offset_figure(results: Results, offsets_ms: Sequence[float]) -> list[Figure]:
    """Figure 11: the offset's error over the long flight, by measurement noise."""
    drawings = []
    for noise, sentence in ((LOOSE, "loose"), (TIGHT, "tight")):
        parts: list[Series] = []
        for offset_ms in offsets_ms:
            flight, at = results.long_flight(Group(offset_ms, augmented=True, noise=noise))
            seen = flight.t_s <= _FIRST_s
            parts.append(series(f"{offset_ms:g} ms", flight.t_s[seen], 1e3 * flight.offset_rms_s[seen, at]))
        parts.append(series("filter's own sigma", flight.t_s[seen], 1e3 * flight.offset_sigma_s[seen, at]))
        caption = (
            f"Figure 11. The first {_FIRST_s:g} s of the flight with images: acceleration from 20 to 30 s, turn from "
            "50 to 60 s. With tight noise the acceleration solves it already, and the filter believes too much; with "
            f"loose noise the turn does, as in the paper. {_RMS}"
        )
        drawings.append(
            Figure(f"Fig. 11 {sentence} noise", caption, _TIME, "offset error / ms", parts, "figure 11", y_log=True)
        )
    return drawings


_FIRST_s = 120.0


def observability_figures(results: Results) -> list[Figure]:
    """Return figures 15 and 16: what the manoeuvres tell about the offset."""
    flights = {name: results.flight(name, augmented=True) for name in FLOWN}
    at = {name: flight.at(Group(SHOWN_ms, augmented=True)) for name, flight in flights.items()}

    def compared(attribute: str, scale: float = 1.0) -> list[Series]:
        parts: list[tuple[str, FlightResult, Any]] = [
            (name, flight, scale * getattr(flight, attribute)[:, at[name]]) for name, flight in flights.items()
        ]
        return [series(name, flight.t_s, values) for name, flight, values in parts]

    whole = [rms(flights[name].eigenvalue[:, at[name]]) for name in FLOWN]
    errors = f"Figure 15. Offset of {SHOWN_ms:g} ms, base noise; manoeuvres from 20 to 40 s. {_RMS}"
    eigen = (
        "Figure 16. Left: eigenvalue of the normalised covariance that belongs to the offset (position of 10 m at the "
        "begin); right: the offset's own element P'_TdTd. RMS over 60 s, which is the paper's axis: "
        + ", ".join(f"{name} {value:.3f}" for name, value in zip(FLOWN, whole, strict=True))
        + "."
    )
    return [
        Figure("Fig. 15", errors, _TIME, "offset error / ms", compared("offset_rms_s", 1e3), "figure 15", y_log=True),
        Figure("Fig. 16 eigenvalue", eigen, _TIME, "of P'", compared("eigenvalue"), "figure 16", y_log=True),
        Figure("Fig. 16 P'_TdTd", eigen, _TIME, "of P'", compared("share"), "figure 16", y_log=True),
    ]


def recovered_figure(results: Results) -> list[Figure]:
    """The turn for every offset that the augmented filter is asked to find; it has no counterpart in the paper."""
    flight = results.flight("turn", augmented=True)
    parts = [
        series(f"{group.offset_ms:g} ms", flight.t_s, 1e3 * flight.offset_mean_s[:, at])
        for at, group in enumerate(flight.groups)
    ]
    caption = "Mean error of the estimated offset over the runs, turn from 20 to 40 s; no counterpart in the paper."
    return [Figure("Recovered offsets", caption, _TIME, "mean error / ms", parts, "recovered")]


def image_figures(results: Results, offsets_ms: Sequence[float], *, augmented: bool) -> list[Figure]:
    """Cut, chips and indices of one of the two filters."""
    return [
        *_cuts(results, offsets_ms, augmented),
        *_chips(results, (min(offsets_ms, key=abs), max(offsets_ms, key=abs)), augmented),
        *_indices(results, offsets_ms, augmented),
    ]


def _which(augmented: bool) -> str:
    return "with the offset as a state" if augmented else "without compensation"


def _cuts(results: Results, offsets_ms: Sequence[float], augmented: bool) -> list[Figure]:
    number, parts = _NUMBERS[augmented][0], []
    for offset_ms in offsets_ms:
        result, at = results.image(Group(offset_ms, augmented, IMAGED))
        cut = result.responses[at].azimuth
        parts.append(series(f"{offset_ms:g} ms", cut.shift_m + cut.offset_m, levels_dB(cut.value, 1.0)))
    caption = (
        f"Figure {number}. Impulse response along the track, {_which(augmented)}, run 1; 0 m is where the target truly "
        "is, 0 dB the peak of a perfectly known track. The paper's axis: amplitude over azimuth."
    )
    labels = "along track / m", "level / dB"
    return [Figure(f"Fig. {number} impulse response", caption, *labels, parts, f"figure {number}")]


def _chips(results: Results, offsets_ms: Sequence[float], augmented: bool) -> list[Figure]:
    number, drawings = _NUMBERS[augmented][1], []
    caption = (
        f"Figure {number}. The target's image, {_which(augmented)}, run 1; level from -40 dB (white) to 0 dB (black)."
    )
    for letter, offset_ms in zip("ab", offsets_ms, strict=True):
        result, at = results.image(Group(offset_ms, augmented, IMAGED))
        title, parts = f"Fig. {number} ({letter}) {offset_ms:g} ms", [drawn(result.chips[at], 1.0)]
        drawings.append(Figure(title, caption, "along track / m", "range / m", parts, f"figure {number}"))
    return drawings


def _indices(results: Results, offsets_ms: Sequence[float], augmented: bool) -> list[Figure]:
    number, drawings = _NUMBERS[augmented][2], []
    caption = (
        f"Figure {number}. Indices of the image over the offset, {_which(augmented)}: mean over the runs and its "
        "scatter (one standard deviation). The paper's axes: the same four indices over the offset, without scales in "
        "the text."
    )
    for name, title, unit in _INDICES:
        values = [figures_of(results, name, Group(offset_ms, augmented, IMAGED)) for offset_ms in offsets_ms]
        mean, std = np.array([of_runs.mean() for of_runs in values]), np.array([of_runs.std() for of_runs in values])
        part = series("mean", offsets_ms, mean, "points", low=mean - std, high=mean + std)
        labels = "offset / ms", f"{title} / {unit}"
        drawings.append(Figure(f"Fig. {number} {title}", caption, *labels, [part], f"figure {number}"))
    return drawings


QUICK = (
    "A quick study, or one of fewer than 50 runs: the tolerances are stated for 50 runs and the flight of 500 s, so "
    "that nothing but the case without errors is judged."
)
NOTES = (
    "Errors are estimate minus truth. T_d > 0 means that the EGI sample is old: tagged t, true at t - T_d.",
    "An uncompensated offset adds to the mean error; the tables print root mean squares, sqrt(RMS0^2 + (v T_d)^2) "
    "where the mean is zero. That of 50 runs is not: Table 5 is held against sqrt(RMS0^2 - 2 m0 v T_d + (v T_d)^2) "
    "with the mean m0 of the same runs at 0 ms, and the ratio to the shorter formula stands beside it.",
    "Standard uncertainties are those of a finite number of runs. Ratios and paired differences use the same runs.",
)
ASSUMED = (
    ("Frame and Earth", "local tangent plane at latitude 37.5 deg, point-mass gravity gradient, constant Earth rate"),
    (
        "EGI",
        "an INS/GPS filter of its own with Table 1, GPS once a second, 60 s of straight flight before: its errors are "
        "coloured, not white",
    ),
    ("Initial yaw of the EGI", "0.003 deg/h over the horizontal Earth rate: 0.0144 deg"),
    ("Units of Tables 1 and 2", "velocity random walk in ug per root hertz, angle random walk in deg per root hour"),
    (
        "Measurement noise R",
        "base 1 m, 0.2 m/s, 0.01 deg (Tables 5 to 7, figures 3, 4, 5a, 6a, 15, 16); tight 1 m, 0.05 m/s, 0.01 deg "
        "(biases, images); loose 10 m, 2 m/s, 0.05 deg (figure 11)",
    ),
    (
        "P0",
        "position 1 m (figures 3 to 7, Tables 5 to 7) or 10 m wherever T_d is a state, so that p - v T_d does not pass "
        "for knowledge of T_d; velocity 0.1 m/s; attitude 0.05 deg; biases of Table 2; T_d 30 ms",
    ),
    ("Initial state", "the first EGI sample, with its errors and the lag of T_d; never the truth"),
    ("Clock noise", "10 us white on every EGI tag, which section 2.1.1 of the paper names"),
    (
        "Different rates, figure 1 (a)",
        "cured by propagation: the prediction is interpolated in the solution of the IMU at t - T_d, at any fraction "
        "of a sample",
    ),
    ("Turns", "flat, without bank; 4.5 deg/s at 100 m/s, and 9 deg/s at 250 m/s, which is 4.0 g sideways, as stated"),
    (
        "Statistics",
        "Table 5: RMS over runs and t > 5 s; Tables 6 and 7: greatest RMS over runs; biases: RMS over runs and 20-40 s",
    ),
    (
        "Radar",
        "9.6 GHz, broadside to the right, 3 km high, 45 km slant range, no weighting, point targets of constant "
        "amplitude, stop-and-go",
    ),
    (
        "Aperture policy, in place of PEM",
        "while the radar is on, position and velocity updates are held and attitude updates go on; updates within the "
        "aperture would destroy the image",
    ),
    (
        "Windows",
        "PSLR and ISLR: main lobe to the first zeros of the ideal response (1.13 cells), side lobes from there to 12 "
        "cells, the same for every image; grid 0.05 cell",
    ),
)
MISPRINTS = (
    ("(1)-(3)", "plus signs", "dp_T = dp - v T_d and alike, with estimate minus truth"),
    ("(6)", "left side dx'", "d/dt dx'"),
    (
        "(7), (9)",
        "measurement at t - estimate of T_d",
        "the measurement is at t - T_d; what is printed is its prediction",
    ),
    ("(8), (10)", "two signs of the innovation", "dz_p = dp - v dT_d; dz_v = dv - a dT_d; dz_phi = dphi - w dT_d"),
    (
        "(11)",
        "difference of velocities",
        "both corrected before the difference, else the update passes for acceleration",
    ),
    ("(12)", "any attitude error", "right-handed rotation vector in t; w without the Earth's rate"),
    ("(13)", "layout lost", "H' = [ H | h ], h = [ -v ; -a ; -w ]"),
)
UNMATCHED = (
    ("Rows of 0 ms", "the EGI's own errors set them, and its filter is not described"),
    (
        "Table 6, growth 1.4 times a T_d",
        "the printed values grow 1.41 to 1.47 times as fast as equation (2) says; statistic and tuning are not stated",
    ),
    ("y axes of figures 3 to 16", "the text of the paper has no axes; R, P0, order and weights of PEM are not given"),
    (
        "Figures 8 to 10, 12 to 14",
        "carrier, squint, height and target are not given: shifts are compared with v T_d and with the errors of "
        "each run itself",
    ),
    (
        "Figure 16 as RMS over 60 s",
        "most of it comes from the 20 s before the manoeuvre; the curve over time tells more, and so does P'_TdTd",
    ),
    ("A shift of v T_d", "it is some 9 % more: the offset also leaves a velocity error along the line of sight"),
)


def results_of(options: StudyOptions, gave: Sequence[Any]) -> Results:
    """Return what the tasks gave, in their order."""
    return Results(tuple(zip(tasks_of(options), gave, strict=True)))


def study_document(options: StudyOptions, results: Results, software: str) -> dict[str, Any]:
    """Return the document; where and by how many it was computed does not stand in it."""
    offsets_ms = options.offsets_ms
    estimates = [
        *error_estimates(results, offsets_ms),
        *recovery_estimates(results, offsets_ms),
        *image_estimates(results, offsets_ms),
    ]
    if not options.judged:
        estimates = [entry if entry.conditions["filter"] == ERRORLESS else unjudged(entry) for entry in estimates]
    return {
        "schema": 1,
        "study": NAME,
        "runs": options.runs,
        "seed": options.seed,
        "offsets_ms": list(offsets_ms),
        "quick": options.quick,
        "decision_rule": "simple",
        "noise": {name: dict(zip(("m", "m/s", "deg"), sigmas, strict=True)) for name, sigmas in SIGMA_R.items()},
        "estimates": documents(estimates),
        "cuts": [
            *_raw(results.ideal().response, 0.0, ERRORLESS),
            *(
                cut
                for image in results.images()
                for group, response in zip(image.groups, image.responses, strict=True)
                for cut in _raw(response, group.offset_ms, group.solution)
            ),
        ],
        "notes": [*([] if options.judged else [QUICK]), *NOTES],
        "provenance": {"simulated": True, "software": software},
    }


def study_json(document: Document) -> str:
    """Canonical text: sorted keys, shortest exact floats, one newline at the end."""
    return results_json(document)


def _raw(response: Response, offset_ms: float, solution: str) -> list[dict[str, Any]]:
    """Return raw complex amplitudes along lines through the image, metres from where the target truly is.

    ``solution``: whose positions it was focused with; with the true ones metres count from the peak.
    """
    return [
        {
            "direction": name,
            "offset_ms": offset_ms,
            "filter": solution,
            "run": 1,
            "at_m": (cut.offset_m if solution == ERRORLESS else cut.shift_m + cut.offset_m).tolist(),
            "real": cut.value.real.tolist(),
            "imaginary": cut.value.imag.tolist(),
        }
        for name, cut in response.cuts.items()
    ]


def study_chapters(options: StudyOptions, document: Document, results: Results) -> list[Chapter]:
    """Return the chapters in the order of the page."""
    offsets_ms, estimates = options.offsets_ms, Estimates(estimates_of(document))
    uncompensated = [image_table(estimates, offsets_ms), paired_table(estimates, offsets_ms)]
    return [
        Chapter("tolerances", [], [tolerance_table(estimates_of(document))], document["notes"]),
        Chapter(
            "errors",
            error_figures(results, offsets_ms),
            [*paper_tables(results, estimates, offsets_ms), bias_table(estimates, offsets_ms)],
        ),
        Chapter("image", image_figures(results, offsets_ms, augmented=False), uncompensated),
        Chapter(
            "recovery",
            [*offset_figure(results, offsets_ms), *recovered_figure(results)],
            [recovered_table(estimates), long_table(estimates, offsets_ms)],
        ),
        Chapter(
            "compensated", image_figures(results, offsets_ms, augmented=True), [several_table(estimates, offsets_ms)]
        ),
        Chapter("observability", observability_figures(results), [observability_table(estimates)]),
        Chapter("assumptions", [], _word_tables()),
    ]


def tolerance_table(estimates: Sequence[Estimate]) -> Table:
    """Return everything that is judged, what failed first."""
    judged = [estimate for estimate in estimates if estimate.verdict != "none"]
    rows = [
        (
            estimate.quantity.replace("_", " "),
            _where(estimate.conditions),
            said(estimate),
            estimate.unit,
            _end(estimate.conditions.get("at_least")),
            _end(estimate.conditions.get("at_most")),
            estimate.verdict,
        )
        for estimate in sorted(judged, key=lambda estimate: estimate.verdict != "fail")
    ]
    heads = ("quantity", "case", "value", "unit", "at least", "at most", "verdict")
    caption = "The value is judged; its standard uncertainty is that of the number of runs"
    return Table("Tolerances", caption, heads, rows, prose=True)


def _end(value: float | None) -> str:
    return "–" if value is None else plain(value)


def _where(conditions: Document) -> str:
    if conditions["filter"] == ERRORLESS:
        return "without errors"
    shown = {
        name: value for name, value in conditions.items() if name not in ("at_least", "at_most") and value is not None
    }
    units = {"offset_ms": "{} ms", "at_s": "at {} s"}
    return ", ".join(
        units.get(name, "{}").format(f"{value:g}" if isinstance(value, float) else value)
        for name, value in shown.items()
    )


def _word_tables() -> list[Table]:
    assumed = ("What the paper does not state", "Assumed here; another choice changes the numbers")
    cannot = ("What cannot be matched, and why", "")
    misprints = ("Equations as they must read", "Errors are estimate minus truth")
    return [
        Table(*assumed, ("item", "assumption"), ASSUMED, prose=True),
        Table(*cannot, ("item", "why"), UNMATCHED, prose=True),
        Table(*misprints, ("equation", "printed", "here"), MISPRINTS, prose=True),
    ]
