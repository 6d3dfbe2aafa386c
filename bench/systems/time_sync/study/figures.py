"""Figures of the study, numbered as in the paper: errors, offset, observability over time, and the focused target."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import Figure, Series, picture, series
from bench.maths.arrays import rms
from bench.systems.time_sync.estimators.sar.image import levels_dB
from bench.systems.time_sync.study.errors import augmented, unaugmented
from bench.systems.time_sync.study.images import figures_of, image_group
from bench.systems.time_sync.study.study import BASE, LOOSE, TIGHT, FlightResult, RECOVERED_ms, Results, SHOWN_ms

_TIME = "time / s"
_FLOWN = ("linear", "acceleration", "turn")
_RMS = "Ours: RMS over the runs. The paper's axis: error over time, its scale not in the text."
_NUMBERS = {False: ("8", "9", "10"), True: ("12", "13", "14")}
_FLOOR_dB = -40.0
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
            for axis, name in enumerate(("forward", "right", "down"))
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
        series(f"{offset_ms:g} ms", flight.t_s, flight.rms[name][:, flight.at(unaugmented(offset_ms, noise)), axis])
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
            flight, at = results.long_flight(augmented(offset_ms, noise))
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
    flights = {name: results.flight(name, augmented=True) for name in _FLOWN}
    at = {name: flight.at(augmented(SHOWN_ms)) for name, flight in flights.items()}

    def compared(attribute: str, scale: float = 1.0) -> list[Series]:
        parts: list[tuple[str, FlightResult, Any]] = [
            (name, flight, scale * getattr(flight, attribute)[:, at[name]]) for name, flight in flights.items()
        ]
        return [series(name, flight.t_s, values) for name, flight, values in parts]

    whole = [rms(flights[name].eigenvalue[:, at[name]]) for name in _FLOWN]
    errors = f"Figure 15. Offset of {SHOWN_ms:g} ms, base noise; manoeuvres from 20 to 40 s. {_RMS}"
    eigen = (
        "Figure 16. Left: eigenvalue of the normalised covariance that belongs to the offset (position of 10 m at the "
        "begin); right: the offset's own element P'_TdTd. RMS over 60 s, which is the paper's axis: "
        + ", ".join(f"{name} {value:.3f}" for name, value in zip(_FLOWN, whole, strict=True))
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
        series(f"{offset_ms:g} ms", flight.t_s, 1e3 * flight.offset_mean_s[:, flight.at(augmented(offset_ms))])
        for offset_ms in RECOVERED_ms
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
        group = image_group(offset_ms, augmented=augmented)
        for cut in results.image(group)[0].cuts:
            if (cut.direction, cut.offset_ms, cut.solution) == ("azimuth", group.offset_ms, group.solution):
                level_dB = levels_dB(cut.amplitude, 1.0, _FLOOR_dB)
                parts.append(series(f"{offset_ms:g} ms", cut.at_m, level_dB))
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
        group = image_group(offset_ms, augmented=augmented)
        result, at = results.image(group)
        chip = result.chips[at]
        level_dB = np.minimum(levels_dB(chip.size, 1.0, _FLOOR_dB), 0.0)
        title = f"Fig. {number} ({letter}) {offset_ms:g} ms"
        parts = [picture(chip.azimuth_m, chip.range_m, np.round(level_dB.T, 1))]
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
        values = [figures_of(results, name, offset_ms, augmented=augmented) for offset_ms in offsets_ms]
        mean, std = np.array([of_runs.mean() for of_runs in values]), np.array([of_runs.std() for of_runs in values])
        part = series("mean", offsets_ms, mean, "points", low=mean - std, high=mean + std)
        labels = "offset / ms", f"{title} / {unit}"
        drawings.append(Figure(f"Fig. {number} {title}", caption, *labels, [part], f"figure {number}"))
    return drawings
