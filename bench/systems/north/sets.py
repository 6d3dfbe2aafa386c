"""Sets of eight samples of a north finder: two lock-ins at four positions of the index, and the records beside them
with their raw waveform, output against the encoder.

Source: FOG paper (digital north finding), equations (13a-d) and (14a-d): lock-in #1 reads sines, #2 cosines.

What is left out of a north finder's data before anything is fitted, and named: readings and samples that stand still
or are pinned at a level, single samples unlike all others, and the one set whose eight samples contradict each other.

Four samples of one lock-in a quarter of a turn apart, with signs in turn, add to zero whatever signal, offset, gain and
placement are: what is left is noise, or one bad reading.
Source: FOG paper (digital north finding), equations (13a-d) and (14a-d); F test of one against all others, the union
bound over the readings.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis import Document, Floats, Material, Reading, flag_problem
from bench.maths.arrays import Flags, Integers
from bench.maths.samples import few, longest_still, pinned, scatter
from bench.maths.tests import f_tail, of_many
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.systems.north.estimators.likelihood import LikelihoodNorth
from bench.systems.north.estimators.phasors import POSITIONS
from bench.systems.north.wording import item_name, say

_SIGNS = np.array([1.0, -1.0, 1.0, -1.0])
_ODD = 1e-3  # chance that a right campaign loses a set
_LEAST_SHARE = 1e-3  # of the amplitude: rounding of the lock-ins is not looked at
_FEWEST = 6
_STILL_deg, _STILL = 10.0, 5  # of the turn, samples: a sine of few steps stands still at its crests
_PINNED, _PINNED_SHARE = 10, 1e-3
_FAR = 8.0  # standard deviations


if TYPE_CHECKING:
    from bench.record import RecordRow, Samples

CALIBRATION, TEST, SEARCH = "calibration", "test", "search"
ITEMS = (CALIBRATION, TEST, SEARCH)
LOG = "log"  # a set that is a part of one
SINE, COSINE, LEVEL, MEASURE = "lock_in_1", "lock_in_2", "level", "measure"
VARYING = "TVP"  # parameters of a set whose amplitude and swing vary
SENSES = {1: "counter-clockwise", -1: "clockwise"}  # of the table, seen from above
MOST_OFF = 2e-3  # of the turning frequency: a lock-in that reads another one follows something else
_PLACE = ("item", "place", "parameters", "head_deg", "repeat", "index")
_OF_THE_SIGNAL = Quality.OVER_RANGE | Quality.TRIPPED | Quality.NOT_SETTLED  # in the lock-ins as in the samples
MOST_LOST_s = 0.5  # more than that is no disturbance of the line: the gyroscope itself may have been off
_NEAR_s = 30.0  # a reading belongs to the record that ended at most so long before it


@dataclass
class NorthSet:
    """Eight samples of one heading, and what was recorded with them.

    ``u1_V``, ``u2_V``: (4,) X of the lock-ins on index B (sines) and A (cosines), volt RMS, by index position; NaN
    where there is none.   ``rate_deg_s``: of the table, counter-clockwise from above positive.   ``tilt_mrad``: of the
    rotation axis about the sensing axis at encoder zero and about the direction 90 degrees clockwise of it; None if
    nobody measured it.   ``faults``: why the eight samples must not be used, by sentence.   ``raw_faults``: the same
    for the raw waveform.   ``parameters``: TIP or TVP, constant or varying, as the sequence
    says, "" if it says nothing.   ``left_out``: (n,) samples of its waveform unlike all others, None for none.
    """

    item: str
    place: str
    head_deg: float
    repeat: int
    rate_deg_s: float = math.nan
    u1_V: Floats = field(default_factory=lambda: np.full(POSITIONS, np.nan))
    u2_V: Floats = field(default_factory=lambda: np.full(POSITIONS, np.nan))
    rows: dict[int, RecordRow] = field(default_factory=dict)
    tilt_mrad: tuple[float, float] | None = None
    faults: list[str] = field(default_factory=list)
    raw_faults: list[str] = field(default_factory=list)
    left_out: Flags | None = None
    parameters: str = ""
    begin_s: float = math.inf
    end_s: float = -math.inf

    @property
    def sense(self) -> int:
        """+1 if the table turned counter-clockwise seen from above, -1 if clockwise."""
        return -1 if self.rate_deg_s < 0.0 else 1

    def turned_deg_s(self) -> float:
        """Return the rate of the table by encoder and clock over its longest record; NaN without samples."""
        rows = [row for row in self.rows.values() if row.samples is not None and len(row.samples) > 1 and not row.lost]
        if not rows:
            return math.nan
        row = max(rows, key=lambda row: row.frames)
        assert row.samples is not None
        theta_deg = np.unwrap(row.samples.scaled("encoder"), period=360.0)
        seconds = 1e-9 * (row.window.t_end_ns - row.window.t_start_ns)
        return float(theta_deg[-1] - theta_deg[0]) / seconds if seconds > 0.0 else math.nan

    @property
    def name(self) -> str:
        """How a sentence speaks of it."""
        key = "set.part" if self.item == LOG else "set.name_with" if self.parameters else "set.name"
        about = {"head": self.head_deg, "repeat": self.repeat, "parameters": self.parameters}
        return say(key, item=item_name(self.item), **about)

    @property
    def group(self) -> tuple[str, str, float, str]:
        """Return item, place, heading and kind of parameters, which repeats have in common."""
        return self.item, self.place, self.head_deg, self.parameters


def north_sets(material: Material) -> list[NorthSet]:
    """Every set the session holds, in the order of time; a sample that was taken again counts as it was taken last.

    Raises: FitError B-FOG-002 if no lock-in was read in a calibration, test or search.
    """
    rows = [row for row in material.rows if row.window.conditions.get("item") in ITEMS]
    sets: dict[tuple[Any, ...], NorthSet] = {}
    for row in rows:
        _keep(sets, row.window.conditions, row)
    samples: dict[tuple[int, int, str], Reading] = {}
    for reading in sorted(material.readings, key=lambda reading: reading.t_s):
        if reading.role not in (SINE, COSINE) or reading.name != MEASURE:
            continue
        conditions = _around(reading, rows)
        if conditions.get("item") in ITEMS:
            north_set = _keep(sets, conditions, None)
            samples[id(north_set), int(conditions.get("index", 0)), reading.role] = reading
            north_set.begin_s, north_set.end_s = min(north_set.begin_s, reading.t_s), max(north_set.end_s, reading.t_s)
    if not samples:
        raise FitError(
            "B-FOG-002",
            "the session holds no reading of a lock-in beside a record of a calibration, test or search",
            next_step="records need the condition 'item', and 'lock_in_1.measure', 'lock_in_2.measure' behind each",
        )
    for north_set in sets.values():
        _fill(north_set, {key[1:]: reading for key, reading in samples.items() if key[0] == id(north_set)})
        north_set.tilt_mrad = _tilt(north_set, material.readings)
        if not abs(north_set.rate_deg_s) > 0.0:
            north_set.faults.append(say("fault.no_rate"))
    return sorted(sets.values(), key=lambda north_set: north_set.begin_s)


def _keep(sets: dict[tuple[Any, ...], NorthSet], conditions: Document, row: RecordRow | None) -> NorthSet:
    """The set of these conditions, new if need be, with the record in it."""
    key = (
        str(conditions["item"]), str(conditions.get("place", "")), float(conditions.get("head_deg", 0.0)),
        int(conditions.get("repeat", 1)),
    )  # fmt: skip
    parameters = str(conditions.get("parameters", ""))
    north_set = sets.setdefault((*key, parameters), NorthSet(*key, parameters=parameters))
    if "rate_deg_s" in conditions:
        north_set.rate_deg_s = float(conditions["rate_deg_s"])
    if row is not None:
        north_set.rows[int(conditions.get("index", 0))] = row
        north_set.begin_s = min(north_set.begin_s, 1e-9 * row.window.t_start_ns)
        north_set.end_s = max(north_set.end_s, 1e-9 * row.window.t_end_ns)
    return north_set


def _around(reading: Reading, rows: Iterable[RecordRow]) -> dict[str, Any]:
    """Return conditions of a reading: its own, and those of the record that ended just before it."""
    own = dict(reading.conditions)
    before = [row for row in rows if 0.0 <= reading.t_s - 1e-9 * row.window.t_end_ns + 0.1 <= _NEAR_s]
    near = [dict(row.window.conditions) for row in before if agree(row.window.conditions, own)]
    return near[-1] | own if near else own


def agree(first: Document, second: Document, keys: Sequence[str] = _PLACE) -> bool:
    """Return whether two sets of conditions say nothing different about where a sample belongs."""
    return all(first[key] == second[key] for key in keys if key in first and key in second)


def _fill(north_set: NorthSet, samples: Mapping[tuple[int, str], Reading]) -> None:
    for k in range(1, POSITIONS + 1):
        for role, into in ((SINE, north_set.u1_V), (COSINE, north_set.u2_V)):
            value = samples[k, role].value if (k, role) in samples else None
            if not isinstance(value, Mapping):
                north_set.faults.append(say("fault.no_reading", role=role, index=k))
                continue
            into[k - 1] = _stated(value, role, "x_V")
            north_set.faults += [
                say("fault.at_index", role=role, index=k, fault=fault) for fault in _wrong(value, north_set.rate_deg_s)
            ]
        row = north_set.rows.get(k)
        if row is not None and (flags := flag_problem(row)):
            into_both = row.quality & _OF_THE_SIGNAL
            for told in (north_set.faults, north_set.raw_faults) if into_both else (north_set.raw_faults,):
                told.append(say("fault.flagged", index=k, flags=flags))
        if row is None or row.samples is None or len(row.samples) < 2:
            north_set.raw_faults.append(say("fault.no_samples", index=k))
        elif row.lost:
            north_set.raw_faults.append(say("fault.samples_lost", count=row.lost, index=k))
            if (lost_s := _lost_s(row)) > MOST_LOST_s:
                north_set.faults.append(say("fault.gyroscope_off", seconds=lost_s, index=k))


def _stated(value: Document, role: str, name: str) -> float:
    """Return a number of a reading. Raises: FitError B-FOG-002 if the reading has none of this name."""
    try:
        return float(value[name])
    except (KeyError, TypeError, ValueError) as error:
        raise FitError(
            "B-FOG-002",
            f"a reading of {role} has no number {name!r}",
            next_step="docs/session-format.md lists what a reading needs",
        ) from error


def _lost_s(row: RecordRow) -> float:
    """Time for which there are no samples in a record, second."""
    length_s = 1e-9 * (row.window.t_end_ns - row.window.t_start_ns)
    return length_s * row.lost / (row.frames + row.lost)


def _wrong(value: Document, rate_deg_s: float) -> list[str]:
    faults = [say(f"fault.{word}") for word in ("overload", "unlocked") if value.get(word)]
    if not math.isfinite(float(value["x_V"])):
        faults.append(say("fault.no_number"))
    frequency_Hz, due_Hz = float(value.get("frequency_Hz", math.nan)), abs(rate_deg_s) / 360.0
    if math.isfinite(frequency_Hz) and abs(frequency_Hz - due_Hz) > MOST_OFF * due_Hz:
        faults.append(say("fault.reference", frequency=frequency_Hz, due=due_Hz))
    return faults


def _tilt(north_set: NorthSet, readings: Iterable[Reading]) -> tuple[float, float] | None:
    """Return the level reading of the same head next to the middle of the set."""
    own = {"item": north_set.item, "place": north_set.place, "head_deg": north_set.head_deg, "repeat": north_set.repeat}
    own |= {"parameters": north_set.parameters} if north_set.parameters else {}
    middle_s = (north_set.begin_s + north_set.end_s) / 2.0
    near = [
        reading
        for reading in readings
        if (reading.role, reading.name) == (LEVEL, MEASURE)
        and isinstance(reading.value, Mapping)
        and agree(own, reading.conditions)
    ]
    if not near:
        return None
    value = min(near, key=lambda reading: abs(reading.t_s - middle_s)).value
    return _stated(value, LEVEL, "x_mrad"), _stated(value, LEVEL, "y_mrad")


@dataclass(frozen=True)
class Waveform:
    """Samples of a set: ``u_V`` and ``theta_deg`` (n,), ``record`` (n,) index position; ``rate_Hz`` of the samples."""

    u_V: Floats
    theta_deg: Floats
    record: Integers
    rate_Hz: float

    @property
    def seconds(self) -> float:
        """How long was measured."""
        return len(self.u_V) / self.rate_Hz

    @property
    def swing_deg(self) -> float:
        """RMS of what a steady rotation leaves of the encoder angle, degrees."""
        squares = []
        for record in np.unique(self.record):
            theta_deg = np.unwrap(self.theta_deg[self.record == record], period=360.0)
            at = np.linspace(-1.0, 1.0, len(theta_deg))
            slope = float(at @ theta_deg) / float(at @ at)
            squares.append(np.mean((theta_deg - theta_deg.mean() - slope * at) ** 2))
        return float(np.sqrt(np.mean(squares)))

    def standing(self) -> list[int]:
        """Return records in which the table turned at less than half of the highest rate of the set, or backwards."""
        per_sample_deg = {}
        for record in np.unique(self.record).tolist():
            theta_deg = np.unwrap(self.theta_deg[self.record == record], period=360.0)
            per_sample_deg[record] = float(theta_deg[-1] - theta_deg[0]) / len(theta_deg)
        fastest_deg = max(per_sample_deg.values(), key=abs)
        return [record for record, each in per_sample_deg.items() if not each / fastest_deg > 0.5]

    def turns(self, record: int) -> tuple[Floats, Floats, float]:
        """Output (n,) V, unwrapped table angle (n,) deg and samples per turn of one record."""
        own = self.record == record
        theta_deg = np.unwrap(self.theta_deg[own], period=360.0)
        per_turn = 360.0 * (len(theta_deg) - 1) / max(abs(float(theta_deg[-1] - theta_deg[0])), 1e-9)
        return self.u_V[own], theta_deg, per_turn


def waveform_of(north_set: NorthSet) -> Waveform | None:
    """Return the four records of a set in one; None if any of them is missing or has gaps."""
    if north_set.raw_faults:
        return None
    samples = [(index, row.samples) for index, row in sorted(north_set.rows.items()) if row.samples is not None]
    u_V = np.concatenate([each.scaled("output") for _, each in samples])
    return Waveform(
        u_V=u_V if north_set.left_out is None else np.where(north_set.left_out, math.nan, u_V),
        theta_deg=np.concatenate([each.scaled("encoder") for _, each in samples]),
        record=np.concatenate([np.full(len(each), index, np.int64) for index, each in samples]),
        rate_Hz=float(np.mean([_rate_Hz(each, north_set.rate_deg_s) for _, each in samples])),
    )


def _rate_Hz(samples: Samples, rate_deg_s: float) -> float:
    """Return samples per second by the turning of the table: a serial line hands samples over in blocks."""
    theta_deg = np.unwrap(samples.scaled("encoder"), period=360.0)
    return (len(samples) - 1) * abs(rate_deg_s) / max(abs(float(theta_deg[-1] - theta_deg[0])), 1e-9)


def screen(sets: Sequence[NorthSet]) -> None:
    """Name what stands still, is pinned or contradicts itself as a fault of its set."""
    for north_set in sets:
        north_set.faults += [
            say("fault.same_value", role=role)
            for role, read_V in ((SINE, north_set.u1_V), ("lock_in_2", north_set.u2_V))
            if (read_V[1:3] == read_V[:2]).all() or (read_V[2:] == read_V[1:3]).all()
        ]
        waveform = waveform_of(north_set)
        if waveform is not None:
            north_set.raw_faults += _still_or_pinned(waveform)
    _unlike(sets)


def _unlike(sets: Sequence[NorthSet]) -> None:
    """Name the set with one reading that all others speak against, unless it is the only one of its kind."""
    good = [north_set for north_set in sets if not north_set.faults]
    if len(good) < _FEWEST:
        return
    left_V = np.array([[each.u1_V @ _SIGNS, each.u2_V @ _SIGNS] for each in good])
    size_V = float(np.median([np.ptp(each.u1_V) + np.ptp(each.u2_V) for each in good])) / 2.0
    which, role = np.unravel_index(int(np.argmax(np.abs(left_V))), left_V.shape)
    worst_V, count = float(left_V[which, role]), left_V.size
    left_V[which, role] = 0.0
    rest_V2 = float(np.sum(left_V**2)) / (count - 1)
    if abs(worst_V) <= _LEAST_SHARE * size_V or not rest_V2 > 0.0:
        return
    chance = of_many(f_tail(worst_V**2 / rest_V2, 1, count - 1), count)
    own = good[int(which)]
    if chance < _ODD and Counter((each.item, each.sense) for each in good)[own.item, own.sense] > 1:
        own.faults.append(
            say("fault.contradicts", number=int(role) + 1, value=worst_V, ratio=abs(worst_V) / rest_V2**0.5)
        )


def _still_or_pinned(waveform: Waveform) -> list[str]:
    faults = []
    for record in np.unique(waveform.record).tolist():
        u_V, theta_deg, per_turn = waveform.turns(record)
        least = max(_STILL, int(per_turn * _STILL_deg / 360.0))
        for what, column, most in (("output", u_V, least), ("encoder", theta_deg, _STILL)):
            if (still := longest_still(column)) > most:
                faults.append(say(f"fault.{what}_still", count=still, index=record))
        for level_V, end in ((float(u_V.max()), u_V), (float(u_V.min()), -u_V)):
            if (count := pinned(end)) > max(_PINNED, _PINNED_SHARE * len(u_V)):
                faults.append(say("fault.pinned", count=count, level=level_V, index=record))
    return faults


def far_samples(waveform: Waveform, fit: LikelihoodNorth, orders: Sequence[int]) -> Flags | None:
    """Return which samples are unlike all others, (n,); None for none, or for more than one in a thousand."""
    theta = np.deg2rad(waveform.theta_deg)
    left_V = waveform.u_V - fit.offset_V
    for order, phasor in ((1, fit.phasor), *zip(orders, fit.harmonics.tolist(), strict=True)):
        left_V = left_V - phasor.real * np.sin(order * theta) - phasor.imag * np.cos(order * theta)
    beside_V = np.abs(left_V - np.median(left_V))
    far = np.asarray(beside_V > _FAR * float(scatter(beside_V)))
    return far if far.any() and few(np.count_nonzero(far), far.size) else None
