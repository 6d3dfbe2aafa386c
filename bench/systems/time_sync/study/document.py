"""study.json and its page: every estimate with tolerance and verdict, what is assumed, and what cannot be matched.

The same tasks give the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from bench.analysis import Chapter, Document, Estimate, Table, documents, estimates_of
from bench.systems.time_sync.study.errors import error_estimates, recovery_estimates
from bench.systems.time_sync.study.figures import (
    error_figures,
    image_figures,
    observability_figures,
    offset_figure,
    recovered_figure,
)
from bench.systems.time_sync.study.images import image_estimates
from bench.systems.time_sync.study.study import ERRORLESS, NAME, SIGMA_R, Cut, Results, StudyOptions, tasks_of, unjudged
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
        "cuts": [_cut(cut) for cut in _all_cuts(results)],
        "notes": [*([] if options.judged else [QUICK]), *NOTES],
        "provenance": {"simulated": True, "software": software},
    }


def study_json(document: Document) -> str:
    """Canonical text: sorted keys, shortest exact floats, one newline at the end."""
    return json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def _all_cuts(results: Results) -> list[Cut]:
    return [*results.ideal().cuts, *(cut for image in results.images() for cut in image.cuts)]


def _cut(cut: Cut) -> dict[str, Any]:
    """Raw complex amplitude along a line through the image; the ideal one has no filter."""
    return {
        "direction": cut.direction,
        "offset_ms": cut.offset_ms,
        "filter": cut.solution,
        "run": 1,
        "at_m": cut.at_m.tolist(),
        "real": cut.amplitude.real.tolist(),
        "imaginary": cut.amplitude.imag.tolist(),
    }


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
