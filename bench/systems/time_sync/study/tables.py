"""Tables of the study, the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bench.analysis import Estimate, Table, number, with_uncertainty
from bench.systems.time_sync.study.errors import BODY, over_time
from bench.systems.time_sync.study.study import (
    AUGMENTED,
    BASE,
    FLOWN,
    LOOSE,
    TIGHT,
    UNAUGMENTED,
    ACCELERATION_m_s2,
    Group,
    MANOEUVRE_s,
    POSITION_m,
    RATE_deg_s,
    RECOVERED_ms,
    Results,
    SPEED_m_s,
    VELOCITY_m_s,
    YAW_deg,
)

Row = Estimate
_DASH = "–"


class Estimates:
    """The flat list, by quantity and conditions."""

    def __init__(self, estimates: Sequence[Row]) -> None:
        self._estimates = estimates

    def all(self, quantity: str, **conditions: Any) -> list[Row]:
        """Return those that hold for all the conditions given."""
        return [
            estimate
            for estimate in self._estimates
            if estimate.quantity == quantity and conditions.items() <= estimate.conditions.items()
        ]

    def value(self, quantity: str, **conditions: Any) -> str:
        """Return the value with its standard uncertainty as text; a dash if there is none."""
        results = self.all(quantity, **conditions)
        return said(results[0]) if results else _DASH


def said(estimate: Row) -> str:
    """Return a value, to the digits its uncertainty supports."""
    return (
        with_uncertainty(estimate.value, estimate.std_uncertainty)
        if estimate.std_uncertainty
        else plain(estimate.value)
    )


def plain(value: float) -> str:
    """Four significant digits."""
    return number(float(f"{value:.4g}"))


def paper_tables(results: Results, estimates: Estimates, offsets_ms: Sequence[float]) -> list[Table]:
    """Return tables 5 to 7."""
    return [
        _position(estimates, offsets_ms),
        _velocity(results, estimates, offsets_ms),
        _yaw(results, estimates, offsets_ms),
    ]


def _paper(printed: Mapping[float, float], offset_ms: float) -> str:
    return plain(printed[offset_ms]) if offset_ms in printed else _DASH


def _position(estimates: Estimates, offsets_ms: Sequence[float]) -> Table:
    rows = [
        (
            f"{offset_ms:g}",
            _paper(POSITION_m, offset_ms),
            estimates.value("position_rms", manoeuvre="linear", offset_ms=offset_ms),
            estimates.value("position_rms_ratio", manoeuvre="linear", offset_ms=offset_ms),
            estimates.value("position_mean", manoeuvre="linear", offset_ms=offset_ms),
            plain(0.0 - SPEED_m_s * offset_ms * 1e-3),
        )
        for offset_ms in offsets_ms
    ]
    heads = ("T_d / ms", "paper / m", "RMS / m", "over √(RMS0² + (v T_d)²)", "mean / m", "−v T_d / m")
    caption = "Position error north in linear motion. RMS over the runs and t > 5 s; base noise"
    return Table("Table 5", caption, heads, rows)


def _velocity(results: Results, estimates: Estimates, offsets_ms: Sequence[float]) -> Table:
    flight = results.flight("acceleration", augmented=False)
    rows = [
        (
            f"{offset_ms:g}",
            _paper(VELOCITY_m_s, offset_ms),
            estimates.value("velocity_rms_max", manoeuvre="acceleration", offset_ms=offset_ms),
            plain(over_time(flight, "velocity_m_s", Group(offset_ms), 0, MANOEUVRE_s)),
            plain(ACCELERATION_m_s2 * offset_ms * 1e-3),
            estimates.value("velocity_lag", manoeuvre="acceleration", offset_ms=offset_ms),
        )
        for offset_ms in offsets_ms
    ]
    heads = ("T_d / ms", "paper / m/s", "greatest RMS / m/s", "RMS 20-40 s / m/s", "a T_d / m/s", "mean over −a T_d")
    caption = "Velocity error north in acceleration; base noise. Judged is the greatest RMS over time"
    return Table("Table 6", caption, heads, rows)


def _yaw(results: Results, estimates: Estimates, offsets_ms: Sequence[float]) -> Table:
    flight = results.flight("turn", augmented=False)
    rows = [
        (
            f"{offset_ms:g}",
            _paper(YAW_deg, offset_ms),
            estimates.value("yaw_rms_max", manoeuvre="turn", offset_ms=offset_ms),
            plain(over_time(flight, "attitude_deg", Group(offset_ms), 2, MANOEUVRE_s)),
            plain(RATE_deg_s * offset_ms * 1e-3),
        )
        for offset_ms in offsets_ms
    ]
    heads = ("T_d / ms", "paper / deg", "greatest RMS / deg", "RMS 20-40 s / deg", "w T_d / deg")
    caption = "Yaw error in the turn; base noise. Judged is the greatest RMS over time"
    return Table("Table 7", caption, heads, rows)


def bias_table(estimates: Estimates, offsets_ms: Sequence[float]) -> Table:
    """Return which biases an offset reaches, figures 5 to 7."""
    rows = []
    for manoeuvre in ("acceleration", "turn"):
        for quantity, unit in (("accel_bias_rms", "ug"), ("gyro_bias_rms", "deg/h")):
            for axis in BODY:
                where = {"manoeuvre": manoeuvre, "axis": axis}
                values = (estimates.value(quantity, offset_ms=offset_ms, **where) for offset_ms in offsets_ms)
                rows.append((manoeuvre, f"{quantity.partition('_')[0]} {axis} / {unit}", *values))
    heads = ("manoeuvre", "bias", *(f"{offset_ms:g} ms" for offset_ms in offsets_ms))
    return Table("Errors of the biases", "RMS over the runs and 20-40 s; tight noise", heads, rows)


def recovered_table(estimates: Estimates) -> Table:
    """Return the offsets that the augmented filter was asked to find, by manoeuvre and time."""
    rows = []
    for offset_ms in RECOVERED_ms:
        for manoeuvre in ("turn", "acceleration", "linear"):
            for rms in estimates.all("offset_error_rms", manoeuvre=manoeuvre, offset_ms=offset_ms, noise=BASE):
                at_s = rms.conditions["at_s"]
                where = {"manoeuvre": manoeuvre, "offset_ms": offset_ms, "at_s": at_s}
                mean, nees = (estimates.value(name, **where) for name in ("offset_error_mean", "offset_nees"))
                rows.append((f"{offset_ms:g}", manoeuvre, f"{at_s:.0f}", mean, said(rms), nees))
    heads = ("T_d / ms", "manoeuvre", "at / s", "mean error / ms", "RMS error / ms", "NEES")
    caption = (
        "Augmented filter, base noise, position of 10 m at the begin. In linear motion it must not converge: nothing "
        "there tells an offset from a distance. A NEES below 1 is due there, since the offsets are smaller than the "
        "30 ms that the filter begins with"
    )
    return Table("Recovered offsets", caption, heads, rows)


def long_table(estimates: Estimates, offsets_ms: Sequence[float]) -> Table:
    """Return offset and consistency on the flight with images."""
    rows = []
    for noise in (LOOSE, TIGHT):
        for offset_ms in offsets_ms:
            where = {"manoeuvre": "sar", "offset_ms": offset_ms, "noise": noise, "filter": AUGMENTED}
            names = ("offset_error_mean", "offset_error_rms", "offset_sigma", "offset_nees", "nis_ratio", "nis_outside")
            rows.append((noise, f"{offset_ms:g}", *(estimates.value(name, **where) for name in names)))
    heads = ("noise", "T_d / ms", "mean error / ms", "RMS error / ms", "sigma / ms", "NEES", "NIS", "NIS outside 95 %")
    caption = (
        "Flight with images, at 100 s. NEES and NIS are 1 for a filter that knows its errors: the EGI's are coloured, "
        "so that with tight noise the filter believes too much of the offset, and with loose noise it does not. The "
        "NIS is small because the EGI is better than the noise assumed"
    )
    return Table("Consistency", caption, heads, rows)


def observability_table(estimates: Estimates) -> Table:
    """Figure 16 in numbers."""
    rows = []
    for manoeuvre in FLOWN:
        names = ("offset_eigenvalue", "offset_variance_ratio", "offset_eigenvalue_rms")
        rows.append((manoeuvre, *(estimates.value(name, manoeuvre=manoeuvre) for name in names)))
    heads = ("manoeuvre", "eigenvalue at 22 s", "P'_TdTd at 22 s", "eigenvalue, RMS over 60 s")
    caption = "Small is well observed; covariance over that of the begin"
    return Table("Observability of the offset", caption, heads, rows)


def image_table(estimates: Estimates, offsets_ms: Sequence[float]) -> Table:
    """Return figures 10 and 14 in numbers."""
    names = ("azimuth_shift", "azimuth_resolution", "pslr", "islr", "peak", "range_shift", "range_resolution")
    rows = _by_filter(offsets_ms, lambda place: [_value_only(estimates, quantity, **place) for quantity in names])
    units = ("shift / m", "resolution / m", "PSLR / dB", "ISLR / dB", "peak", "range shift / m", "range resolution / m")
    caption = "Means over the runs; along the track where nothing else is said; shift = image - target"
    return Table("Indices of the image", caption, ("filter", "T_d / ms", *units), rows)


def _by_filter(offsets_ms: Sequence[float], cells: Callable[[dict[str, Any]], Sequence[str]]) -> list[Sequence[str]]:
    """Return a row for each filter and offset: what ``cells`` says of the conditions behind their names."""
    return [
        (name, f"{offset_ms:g}", *cells({"manoeuvre": "sar", "filter": name, "offset_ms": offset_ms}))
        for name in (UNAUGMENTED, AUGMENTED)
        for offset_ms in offsets_ms
    ]


def _value_only(estimates: Estimates, quantity: str, **place: Any) -> str:
    results = estimates.all(quantity, **place)
    return plain(results[0].value) if results else _DASH


def paired_table(estimates: Estimates, offsets_ms: Sequence[float]) -> Table:
    """Return every run against itself without an offset."""
    names = ("shift_against_none", "shift_over_lag", "shift_unexplained_rms", "resolution_ratio", "islr_against_none")
    rows = _by_filter(offsets_ms, lambda place: [estimates.value(quantity, **place) for quantity in names])
    figures = ("shift / m", "shift over −v T_d", "not explained / m", "resolution ratio", "ISLR / dB")
    caption = (
        "Every run against the same run at 0 ms. Not explained: RMS of the shift seen in the image minus along-track "
        "error - (R0 / v) x velocity error along the line of sight"
    )
    return Table("What the offset does to the image", caption, ("filter", "T_d / ms", *figures), rows)


def several_table(estimates: Estimates, offsets_ms: Sequence[float]) -> Table:
    """Return three targets of one scene."""
    rows = _by_filter(
        offsets_ms, lambda place: [estimates.value("target_shift", target=number, **place) for number in (1, 2, 3)]
    )
    heads = ("filter", "T_d / ms", "middle / m", "100 m ahead, 12 m near / m", "100 m behind, 12 m far / m")
    return Table("Shift of several targets", "One scene, run 1: the image moves as a whole", heads, rows)
