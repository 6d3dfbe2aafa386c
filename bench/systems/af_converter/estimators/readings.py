"""Pulses of records as arrays, and the readings of one channel at one temperature that they make: clock corrections,
currents, covariance, the effects that rows share, and the bias of rows with the input open.

Independent part of the covariance: quantisation of the gated counts, white noise and random walk of the converter.
Shared part: one unknown offset per calibrator range and one linearity error per level; both change sign with the
polarity switch and are the same for every channel and temperature, so their sensitivities are kept by label.
Source: docs/method-af-converter.md; AF-converter paper equations (1) to (3), sections 3.3 and 4.1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from bench.maths.arrays import Flags, Floats, Integers
from bench.model.errors import FitError

QUANTISATION = "quantisation of the counts"
SCATTER = "scatter of the records of a point"
GAIN = "gain"


def clock_ratio(af_count: Floats, gate_s: Floats, af_clock_Hz: float) -> Floats:
    """Return ratio r = (1 + dMSTR) / (1 + dAF) = f_AF0 * t_INT0 / n_AF, which turns counted rates into current.

    Args:    af_count: AF-clock pulses counted in each gate, (m,).   gate_s: nominal gate t_INT0 = master pulses over
             nominal master frequency, (m,), second.   af_clock_Hz: nominal AF clock, hertz.
    Returns: r, (m,), near 1; NaN where no AF pulse was counted.
    Source:  AF-converter paper equation (1); docs/method-af-converter.md.
    """
    counted = np.where(af_count > 0, af_count, np.nan)
    return af_clock_Hz * gate_s / counted


def master_clock_error(fg_count: Floats, gate_s: Floats, fg_Hz: float) -> Floats:
    """Relative error dMSTR of the master clock: 1 + dMSTR = f_FG * t_INT0 / n_FG; positive = runs fast.

    Args:    fg_count: function-generator pulses counted in each gate, (m,).   gate_s: nominal gate, (m,), second.
             fg_Hz: frequency of the function generator, hertz.
    Returns: dMSTR, (m,), dimensionless; NaN where the generator was off.
    Source:  AF-converter paper section 4.1; docs/method-af-converter.md.
    """
    counted = np.where(fg_count > 0, fg_count, np.nan)
    return fg_Hz * gate_s / counted - 1.0


def count_noise(count: Floats) -> Floats:
    """Relative standard uncertainty of a gated count, (m,): difference of two uniform residues over the count.

    Source: docs/method-af-converter.md (quantisation); two uniform residues of one pulse have the variance 1/6.
    """
    return np.asarray(1.0 / (np.sqrt(6.0) * np.where(count > 0, count, np.nan)))


@dataclass(frozen=True)
class Converter:
    """Declared constants of one converter channel."""

    k0_C: float  # nominal charge per pulse, coulomb, same for N and P
    af_clock_Hz: float
    white_A_rtHz: float  # one-sided amplitude density: 100 s average to white / sqrt(200 s)
    walk_A_rth: float  # random walk of the bias: standard deviation after one hour


@dataclass(frozen=True)
class RelativeError:
    """An error of a standard in proportion to its current; equal labels are one and the same error."""

    label: str
    std: float  # standard uncertainty, relative
    dof: float = math.inf


@dataclass(frozen=True)
class RangeSpecification:
    """One range of a standard: 95 % (k = 2) uncertainty, and the correction from its certificate.

    The current delivered for a set-point I is I * (1 + gain) + offset_A. ``label``: of the error that ``relative`` is
    the uncertainty of.   ``calibration``: error of the certificate, None if the specification holds it or nobody states
    it; ``traced`` says which.
    """

    relative: float
    floor_A: float
    gain: float = 0.0
    offset_A: float = 0.0
    label: str = GAIN
    calibration: RelativeError | None = None
    traced: bool = False

    @property
    def errors(self) -> dict[str, float]:
        """Errors in proportion to the current by label: relative standard uncertainties."""
        own = {self.label: self.relative / 2.0}
        return own if self.calibration is None else own | {self.calibration.label: self.calibration.std}


@dataclass(frozen=True)
class Readings:
    """Rows of one channel at one temperature, in order of time; all arrays (m,)."""

    polarity: Floats  # +1 or -1: how the switch connects the calibrator
    level_A: Floats  # nominal magnitude of the calibrator current, 0 for a zero row
    range_A: Floats  # full scale of the calibrator range in use
    n_count: Floats
    p_count: Floats
    af_count: Floats
    gate_s: Floats  # nominal gate from the master count
    gaps: Floats  # lost frames inside the gate: each cuts the counts once more
    time_s: Floats  # middle of the gate, any origin
    unit_temperature_degC: Floats
    temperature_std_degC: Floats  # standard uncertainty of an interpolated temperature, 0 where measured
    temperature_gap: Floats  # rows with the same number share one error of interpolation
    scatter: Floats  # variance of (n - p) / af_count by the scatter of records; for rows with ``scatter_dof`` only
    scatter_dof: Floats  # its degrees of freedom; 0: the noise is as declared
    halves: Floats  # first less second half of the gate of (n - p) / af_count; NaN: not known

    def take(self, rows: Flags) -> Readings:
        """The rows where the mask is true."""
        return Readings(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


@dataclass(frozen=True)
class Effects:
    """Common unknowns with a prior: readings shift by ``matrix @ z`` with z independent, zero mean, unit variance."""

    labels: tuple[str, ...]
    matrix: Floats  # (m, k), ampere


def pulse_currents_A(rows: Readings, converter: Converter) -> tuple[Floats, Floats]:
    """Return currents K0 C_N and K0 C_P, (m,) each, ampere, corrected by the clock ratio.

    Source: AF-converter paper equations (1), (2).
    """
    scale = converter.k0_C * clock_ratio(rows.af_count, rows.gate_s, converter.af_clock_Hz) / rows.gate_s
    return np.asarray(scale * rows.n_count), np.asarray(scale * rows.p_count)


def quantisation_A2(rows: Readings, converter: Converter) -> Floats:
    """Variance of gated counts, (m,): the difference of two uniform residues of one pulse, (q / t)^2 / 6 per stretch.

    Source: docs/method-af-converter.md; rectangular distribution of JCGM 100:2008 4.3.7.
    """
    return (converter.k0_C / rows.gate_s) ** 2 / 6.0 * (1.0 + rows.gaps)


def halves_A2(rows: Readings, converter: Converter) -> Floats:
    """Variance of the difference of both halves of a gate, (m,): quantisation of counts and clock, white noise, walk.

    Three residues of a pulse, the middle one twice, are (1 + 4 + 1) / 12 of it squared, over half the gate.
    Source:  rectangular distribution of JCGM 100:2008 4.3.7; means of a random walk over two halves of a gate.
    """
    quantised = (quantisation_A2(rows, converter) + clock_A2(rows, converter)) * 12.0
    return quantised + 4.0 * white_A2(rows, converter) + converter.walk_A_rth**2 / 3600.0 * rows.gate_s / 3.0


def clock_A2(rows: Readings, converter: Converter) -> Floats:
    """Variance of the measured current by the quantised AF-clock count, (m,)."""
    current = converter.k0_C * (rows.n_count - rows.p_count) / rows.gate_s
    return (current * count_noise(rows.af_count)) ** 2 * (1.0 + rows.gaps)


def white_A2(rows: Readings, converter: Converter) -> Floats:
    """Variance of an average over the gate of white noise with a one-sided density, (m,)."""
    return converter.white_A_rtHz**2 / (2.0 * rows.gate_s)


def walk_A2(rows: Readings, converter: Converter) -> Floats:
    """Covariance (m, m) of gate averages of a random walk that starts with the first row.

    For gates that do not overlap it is sigma^2 times the earlier middle; on the diagonal a sixth of a gate less.
    """
    start_s = np.min(rows.time_s - rows.gate_s / 2)
    middle_s = rows.time_s - start_s
    shared_s = np.minimum.outer(middle_s, middle_s)
    shared_s[np.diag_indices_from(shared_s)] -= rows.gate_s / 6.0
    return converter.walk_A_rth**2 / 3600.0 * shared_s


def scatter_A2(rows: Readings, converter: Converter) -> Floats:
    """Variance of rows that are known by the scatter of their records, (m,), 0 for others; never below quantisation."""
    seen_A2 = (converter.k0_C * converter.af_clock_Hz) ** 2 * rows.scatter
    least_A2 = quantisation_A2(rows, converter) + clock_A2(rows, converter)
    return np.where(rows.scatter_dof > 0, np.maximum(seen_A2, least_A2), 0.0)


def noise_parts(rows: Readings, converter: Converter) -> dict[str, Floats]:
    """Independent part of the covariance by name, each (m, m), ampere squared.

    What scatter tells of a row stands for its quantisation and white noise, which the scatter holds.
    """
    declared = rows.scatter_dof == 0
    parts = {
        QUANTISATION: np.diag(quantisation_A2(rows, converter) * declared),
        "quantisation of the AF clock count": np.diag(clock_A2(rows, converter) * declared),
        "white noise of the converter": np.diag(white_A2(rows, converter) * declared),
        "random walk of the bias": walk_A2(rows, converter),
    }
    return parts if declared.all() else {**parts, SCATTER: np.diag(scatter_A2(rows, converter))}


def interpolation_A2(rows: Readings, response_A_degC: Floats) -> Floats:
    """Covariance (m, m) of rows whose unit temperature is interpolated; rows of one gap share the error.

    Args:    response_A_degC: change of each row's reading per degC of unit temperature, (m,), signed.
    Source:  JCGM 100:2008 5.2 (correlated input quantities).
    """
    effect_A = response_A_degC * rows.temperature_std_degC
    return np.outer(effect_A, effect_A) * np.equal.outer(rows.temperature_gap, rows.temperature_gap)


def specification(standard: Mapping[float, RangeSpecification], range_A: float) -> RangeSpecification:
    """Entry of the standards register for a calibrator range.

    Raises: FitError B-FIT-003 if the register has no such range.
    """
    for full_scale_A, entry in standard.items():
        if abs(full_scale_A - range_A) <= 1e-6 * range_A:
            return entry
    known = ", ".join(f"{full_scale_A:g}" for full_scale_A in standard) or "none"
    raise FitError(
        "B-FIT-003",
        f"the standards register gives no uncertainty for the calibrator range {range_A:g} A (known: {known} A)",
        next_step="add the range to the calibrator's entry in the station file",
    )


def calibrator_effects(rows: Readings, standard: Mapping[float, RangeSpecification]) -> Effects:
    """Return offsets of the calibrator ranges and linearity errors of its levels, prior floor / 2 each.

    Raises: FitError B-FIT-003 for a range the register does not hold.
    """
    columns: dict[str, Floats] = {}
    for range_A in sorted(set(rows.range_A.tolist())):
        sigma_A = specification(standard, range_A).floor_A / 2.0
        inside = rows.range_A == range_A
        columns[offset_label(range_A)] = sigma_A * rows.polarity * inside
        for level_A in sorted(set(rows.level_A[inside & (rows.level_A > 0)].tolist())):
            at_level = inside & (rows.level_A == level_A)
            columns[linearity_label(range_A, level_A)] = sigma_A * rows.polarity * at_level
    return Effects(tuple(columns), np.column_stack(list(columns.values())))


def offset_label(range_A: float) -> str:
    """Return the name of the offset of a range of the calibrator."""
    return f"offset of the range {range_A:g} A"


def linearity_label(range_A: float, level_A: float) -> str:
    """Return the name of the linearity error of a level of the calibrator."""
    return f"linearity of the range {range_A:g} A at {level_A:g} A"


def relative_errors(range_A: Floats, standard: Mapping[float, RangeSpecification]) -> dict[str, Floats]:
    """Return relative standard uncertainty of each row, (m,), by the label of an error in proportion to the current.

    Args:    range_A: range of the standard in use, (m,).   standard: its register.
    Raises:  FitError B-FIT-003 for a range the register does not hold.
    Source:  docs/method-uncertainty.md.
    """
    of_rows = [specification(standard, float(full_A)).errors for full_A in range_A]
    labels = dict.fromkeys(label for errors in of_rows for label in errors)
    return {label: np.array([errors.get(label, 0.0) for errors in of_rows]) for label in labels}


@dataclass(frozen=True)
class Bias:
    """i_AFbias in ampere: the correction added to the reading (the IEEE bias is its negative)."""

    value_A: float
    std_uncertainty_A: float
    unit_temperature_degC: float


def open_input_bias(row: Readings, converter: Converter, dsf_ppm: tuple[float, float] = (0.0, 0.0)) -> Bias:
    """Bias from rows with the input open: i_AFbias = -(K_N C_N - K_P C_P), the negative of the reading.

    Args:    row: open rows, (m,), m >= 1.   converter: declared constants.   dsf_ppm: scale-factor errors (N, P).
    Returns: Bias, the mean over the rows.
    Source:  AF-converter paper equation (1) with i_SEN = 0.
    """
    n_A, p_A = pulse_currents_A(row, converter)
    reading_A = n_A * (1.0 + 1e-6 * dsf_ppm[0]) - p_A * (1.0 + 1e-6 * dsf_ppm[1])
    variance = quantisation_A2(row, converter) + white_A2(row, converter)
    return Bias(
        value_A=-float(np.mean(reading_A)),
        std_uncertainty_A=float(np.sqrt(np.sum(variance)) / variance.size),
        unit_temperature_degC=float(np.mean(row.unit_temperature_degC)),
    )


TIMING = ("moment1", "moment2", "first", "last", "at_first", "at_last")


@dataclass(frozen=True)
class Pulses:
    """Pulses of one polarity; all (m, c) for m records and c channels, x_j the count of frame j = 1 ... n.

    ``moment1`` = sum of j x_j, ``moment2`` = sum of j^2 x_j; ``first``, ``last``: unwrapped counters of the first and
    last frame with a pulse (-1: none), ``at_first``, ``at_last``: pulses in them. Meaningless where not timed.
    """

    count: Integers
    moment1: Integers
    moment2: Integers
    first: Integers
    last: Integers
    at_first: Integers
    at_last: Integers


@dataclass(frozen=True)
class PulseRecords:
    """m records in order of time, (m,) unless said otherwise.

    ``frames``: good frames; ``lost``: missing or unusable ones; ``gate_s``: nominal gate of the good frames;
    ``timed`` (bool): the record has timing, so no frame is missing; ``n``, ``p``: pulses of each polarity.
    """

    first_counter: Integers
    frames: Integers
    lost: Integers
    gate_s: Floats
    af_count: Floats
    timed: Flags
    n: Pulses
    p: Pulses

    @property
    def frame_s(self) -> Floats:
        """Nominal length of a frame, (m,), second; NaN without a gate."""
        return np.where(self.gate_s > 0, self.gate_s, np.nan) / np.maximum(self.frames, 1)

    @property
    def follows(self) -> Flags:
        """True where a record begins with the frame right after the record before it, both without a gap; (m,).

        A record that lost frames does not reach the next one: its good frames are fewer than its counters.
        """
        joined = np.zeros(self.frames.size, dtype=np.bool_)
        stop = self.first_counter + self.frames
        joined[1:] = (self.first_counter[1:] == stop[:-1]) & (self.lost[1:] == 0)
        return joined


@dataclass(frozen=True)
class PulseConverters:
    """Declared constants of c channels: charge of a pulse of each polarity and white noise, (c,) or one for all.

    ``white_A_rtHz``: one-sided density. With a scale-factor error d known, k = k0 (1 + d).
    """

    k_n_C: ArrayLike
    k_p_C: ArrayLike
    white_A_rtHz: ArrayLike
    af_clock_Hz: float

    def ratio(self, records: PulseRecords) -> Floats:
        """Clock ratio r of each record, (m, 1), which turns counted rates into current; NaN without AF clock."""
        return clock_ratio(records.af_count, records.gate_s, self.af_clock_Hz)[:, None]

    def ratio_std(self, records: PulseRecords) -> Floats:
        """Relative standard uncertainty of the clock ratio of each record, (m, 1)."""
        return count_noise(records.af_count)[:, None]


def stack_records(
    windows: Sequence[tuple[int, int, int]],
    sums: Sequence[Mapping[str, Any]],
    timing: Sequence[Mapping[str, Any]],
    master_Hz: float,
) -> PulseRecords:
    """Arrays from the records of a session, in order of time.

    Args:    windows: per record the unwrapped counter of its first frame, its good frames, its lost frames.
             sums: per record "npp", "ppp" (c,), "af_clock", "master_count" () over the good frames.
             timing: per record "npp.moment1" ... "ppp.at_last" (c,), empty where there is none.
             master_Hz: nominal master clock, which makes the gate of the master count.
    Returns: PulseRecords of m records and c channels.
    Raises:  nothing.
    Source:  AF-converter paper equation (1): the gate is counted in pulses of the master clock.
    """
    first, frames, lost = np.array(windows, dtype=np.int64).reshape(-1, 3).T
    return PulseRecords(
        first_counter=first,
        frames=frames,
        lost=lost,
        gate_s=np.array([int(record["master_count"]) for record in sums]) / master_Hz,
        af_count=np.array([int(record["af_clock"]) for record in sums], dtype=np.float64),
        timed=np.array([bool(record) for record in timing]) & (lost == 0),
        n=_pulses("npp", sums, timing),
        p=_pulses("ppp", sums, timing),
    )


def _pulses(name: str, sums: Sequence[Mapping[str, Any]], timing: Sequence[Mapping[str, Any]]) -> Pulses:
    count = np.array([record[name] for record in sums], dtype=np.int64)
    empty = np.full(count.shape[1:], -1, dtype=np.int64)
    columns = {
        key: np.array([record.get(f"{name}.{key}", empty) for record in timing], dtype=np.int64) for key in TIMING
    }
    return Pulses(count, **columns)


def count_step(counts: Floats, apart: float = np.inf) -> tuple[int, float]:
    """Return the largest step of which counts are multiples, apart from a remainder that all share.

    Where points are missing, the few counts that are left may go in steps of the levels of the stimulus: that is no
    step of the counter.

    Args:    counts: of gates that differ, (m,); zeros and counts that occur twice say nothing.
             apart: pulses between neighbouring levels.
    Returns: the step, 1 for single pulses, and the probability of one as large by chance.
    Source:  d whole numbers are all multiples of k with probability k^-d; sum over all k from the step on.
    """
    differences = np.diff(np.unique(counts[counts > 0])).astype(np.int64)
    if differences.size < 2:  # one alone is a multiple of itself
        return 1, 1.0
    step = int(np.gcd.reduce(differences))
    if 2 * step > apart:
        return 1, 1.0
    return step, 1.0 if step == 1 else min(1.0, float(special.zeta(differences.size, step)))
