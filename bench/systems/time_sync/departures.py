"""What a recording says against its model: one motion of both units, a constant offset, errors as they are stated.

Readings are the differences between all solutions of the EGI and the unaided integration of the inertial unit, as means
over blocks, and the least delays of the frames of both ports in parts of the recording. Free are errors of the first
state and biases, the offset, its drift, and a line of the delays of either port; the offset by receive stamps and the
stated latencies is a row beside them. So filters and stamps are two opinions, of which either can be the wrong one.
Source: docs/method-uncertainty.md (doubt, departures).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, special

from bench.analysis import (
    Departure,
    Estimate,
    Estimates,
    Evidence,
    Labels,
    Residuals,
    Searched,
    departures_of,
    operators_of,
    search,
)
from bench.maths.arrays import Floats
from bench.maths.samples import MOST
from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimates import SyncResult
from bench.systems.time_sync.estimators.differences import STATES, Differences, Guess, Noise, differences
from bench.systems.time_sync.estimators.kalman.setup import (
    OFFSET,
    EgiSpread,
    ImuDensities,
    STANDARD_GRAVITY_m_s2,
)
from bench.systems.time_sync.estimators.port_clocks import LEAST_FRAMES, PortClock, port_clock
from bench.systems.time_sync.filtering import COMPENSATED, GROUPS, METHODS, OFFSET_STD_s
from bench.systems.time_sync.limits import DIFFERENCE, UNCERTAINTY
from bench.systems.time_sync.records import NS, Recording, Stream
from bench.systems.time_sync.wording import say

OF_FILTER = ("time_offset", UNCERTAINTY, "accel_bias", "gyro_bias", "image_shift")
_PLAUSIBLE_s = 4.0 * OFFSET_STD_s  # of what is left for the filter: more is not what it was told to look for
_PARTS = 8  # of a recording, in which the delays of a port must be alike
_PARTS_OF_STEPS = 4  # where stamps come in steps: what tells a line in a part takes frames
_LOW = 0.1  # quantile of the delays that stands for a part
_RARE = 5.0  # standard deviations
_LEAST_s = 1e-9  # of the scatter of a delay: resolution of the stamps
_RESTS = 0.05  # of the largest motion: a lesser one is none that tells an age
_MS, _PPM, _hour = 1e-3, 1e-6, 3600.0
_AXES, _BODY = ("north", "east", "down"), "xyz"
_UNITS = {"position": ("m", 1.0), "velocity": ("m/s", 1.0), "attitude": ("deg", math.radians(1.0))}
_OF_STATES = {  # first state and scale of an estimate
    "time_offset": (OFFSET, 1.0),
    UNCERTAINTY: (OFFSET, 1.0),
    "accel_bias": (9, 1e6 / STANDARD_GRAVITY_m_s2),
    "gyro_bias": (12, math.degrees(_hour)),
}
_OWN = {"lever_arm": ("m", 1.0), "axes": _UNITS["attitude"]}  # scales in ppm
_ADVICE = {"velocity": "position", "attitude": "position", "gyro_scale": "scale", "accelerometer_scale": "scale"}


def searched_rows(rows: Rows, residuals: Residuals) -> Searched:
    """Return the search of the rows of a recording."""
    return Searched(search(residuals, rows.departures()), _words, _advice)


def implausible(result: SyncResult) -> list[Evidence]:
    """Return what cannot be, and offsets that the motion did not show."""
    return [*_refused(result), *_stuck(result)]


def _refused(result: SyncResult) -> Iterator[Evidence]:
    """Yield the offsets that the motion did not show, which are what was assumed beforehand, and implausible ones."""
    for name in METHODS:
        offset, where = result.found.offsets[name], {"method": name}
        left_s = offset.offset_s - result.found.shift_s
        if not offset.seen:
            said = say("evidence.not_observable", share=offset.normalised, std=1e3 * OFFSET_STD_s)
            yield Evidence("not_observable", said, offset.normalised, 0.0, math.inf, OF_FILTER[:1], where, refuses=True)
        if abs(left_s) > _PLAUSIBLE_s:
            said = say("evidence.implausible", offset=1e3 * left_s, bound=1e3 * _PLAUSIBLE_s)
            yield Evidence("implausible_offset", said, 1e3 * left_s, 0.0, math.inf, OF_FILTER, where, refuses=True)


def _stuck(result: SyncResult) -> Iterator[Evidence]:
    stuck = result.ready.stuck_egi
    if stuck > max(1.0, MOST * result.found.samples):
        said = say("evidence.stuck", count=stuck)
        yield Evidence("stuck_solutions", said, float(stuck), 0.0, quantities=OF_FILTER)


def _advice(departure: Departure) -> str:
    """Return what to look for, by what departs."""
    return say(f"departs.advice.{_ADVICE.get(departure.carrier, departure.carrier)}")


def _words(label: str, value: Any) -> str:
    """Return how a person names a label or carrier."""
    if value is None:
        return say(f"departs.of.{label}")
    if label == "visit":
        return say("departs.at_time", at=_MS * value)
    return say(f"departs.{label}.{value}") if value else ""


# --- rows -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Delays:
    """Low delays of a port in parts of a recording, second above its line, ``since_s`` (k,) from the middle on."""

    since_s: Floats
    delay_s: Floats
    std_s: Floats

    @property
    def line(self) -> Floats:
        """What level in the middle and rate gain per second of each delay, (2, k), by least squares."""
        free = np.column_stack([np.ones(self.since_s.size), self.since_s])
        return np.asarray(np.linalg.pinv(free / self.std_s[:, None]) / self.std_s)


def delays_of(port: PortClock, stream: Stream, at_s: Floats, middle_s: float) -> Delays:
    """Return low delays of a port in parts; where stamps come in steps, those of a line of each part.

    Scatter of the low ones is such that 5 of it are as rare upwards, where delays have their tail, as normal errors.
    Source: distribution of a sample quantile by that of a count, David and Nagaraja, Order Statistics (2003), 2.1.
    """
    fine = port.grid_s == 0.0
    parts = np.array_split(np.arange(at_s.size), _PARTS if fine else min(_PARTS_OF_STEPS, at_s.size // LEAST_FRAMES))
    mean_s = [float(at_s[part].mean()) for part in parts]
    since_s = np.array(mean_s) - middle_s
    if not fine:
        received_s = np.asarray(NS * (stream.received_ns - stream.received_ns[0]))
        lines = [port_clock(at_s[part], stream.counter[part], received_s[part], port.grid_s) for part in parts]
        pairs = list(zip(lines, mean_s, strict=True))
        above_s = [line.least_s(at) - port.least_s(at) for line, at in pairs]
        return Delays(since_s, np.array(above_s), np.array([line.std_s(at) for line, at in pairs]))
    low_s = [np.quantile(port.above_s[part], _LOW) for part in parts]
    within_s = np.concatenate([port.above_s[part] - low for part, low in zip(parts, low_s, strict=True)])
    count = np.array([part.size for part in parts])
    far = special.betaincinv(_LOW * count, (1.0 - _LOW) * count + 1.0, special.ndtr(_RARE))
    beyond_s = np.quantile(within_s, far) - np.quantile(within_s, _LOW)
    return Delays(since_s, np.array(low_s), np.maximum(beyond_s / _RARE, _LEAST_s))


@dataclass(frozen=True)
class Rows:
    """All readings of a recording, (r,): blocks of 9 differences one behind the other, delays of both ports.

    ``guess_s``: offset about which they are.   ``priors`` (2, 7): of biases and offset, and their uncertainties.
    """

    result: SyncResult
    guess_s: float
    priors: Floats
    seen: Differences
    imu: Delays
    egi: Delays

    def _all(self, differences: Any = 0.0, imu: Any = 0.0, egi: Any = 0.0) -> Floats:
        """Return a column of all readings, (r,), from those of blocks (b, 9) and ports or what they have in common."""
        parts = (differences, self.seen.y), (imu, self.imu.delay_s), (egi, self.egi.delay_s)
        return np.concatenate([np.broadcast_to(part, like.shape).ravel() for part, like in parts])

    def _of_state(self, method: str, state: int) -> Floats:
        """Return what a state of a filter gains per unit of each reading, (r,).

        The drift by stamps is taken out of the tags beforehand: what the filter makes of a wrong one is that of 1 s/s.
        """
        response = self.result.found.run.response
        assert response is not None
        of_blocks = -response[GROUPS.index(method), state, self.seen.block]
        drift = float(np.sum(of_blocks * self.seen.drifting))
        return self._all(of_blocks, -drift * self.imu.line[1], drift * self.egi.line[1])

    def residuals(self, entries: Estimates) -> Residuals:
        """Return the rows."""
        seen, imu, egi, clocks = self.seen, self.imu, self.egi, self.result.clocks
        root = linalg.block_diag(linalg.cholesky(seen.covariance, lower=True), *map(np.diag, (imu.std_s, egi.std_s)))
        by_stamps = self._all(0.0, imu.line[0], -egi.line[0])
        std_s = math.inf if clocks.offset_s is None else clocks.difference.std_s
        apart_s = (clocks.offset_s or 0.0) - self.result.found.shift_s - self.guess_s

        def whiten(columns: Floats) -> Floats:
            white = linalg.solve_triangular(root, columns, lower=True)
            return np.vstack([white, by_stamps @ columns / std_s, np.zeros((self.priors.shape[1], columns.shape[1]))])

        free = [
            *(self._all(state) for state in np.moveaxis(seen.states, 2, 0)),
            self._all(seen.motion),
            self._all(seen.drifting, 0.0, -egi.since_s),
            self._all(0.0, imu.since_s, egi.since_s),
            self._all(0.0, 1.0),
            self._all(0.0, 0.0, 1.0),
        ]
        design = whiten(np.column_stack(free))
        white = whiten(self._all(seen.y, imu.delay_s, egi.delay_s)[:, None])[:, 0]
        design[len(root)], white[len(root)] = 0.0, apart_s / std_s
        design[len(root), STATES] = 1.0 / std_s
        white[len(root) + 1 :] = self.priors[0] / self.priors[1]
        design[len(root) + 1 :, STATES - 6 : STATES + 1] = np.diag(1.0 / self.priors[1])
        operator, stated = operators_of(entries, lambda entry: self._operator(entry, by_stamps), len(root))
        of_blocks = operator[:, : seen.y.size]
        return Residuals(
            readings=np.full(len(root), np.inf),  # nothing is in proportion to a difference
            white=white,
            design=design,
            whiten=whiten,
            operator=operator,
            expanded=np.array([entry.expanded_uncertainty or entry.value for entry in stated]),
            noise=coverage_factor() * np.sqrt(np.einsum("ki,ij,kj->k", of_blocks, seen.covariance, of_blocks)),
            stated=stated,
        )

    def _operator(self, entry: Estimate, by_stamps: Floats) -> Floats | None:
        """Return what an estimate gains per unit of each reading, (r,); None of one that does not follow from them."""
        name, where, image = entry.quantity, entry.conditions, self.result.image
        if name in _OF_STATES:
            first, scale = _OF_STATES[name]
            return scale * self._of_state(where["method"], first + _BODY.index(where.get("axis", "x")))
        rates = {"imu": self._all(0.0, self.imu.line[1]), "egi": self._all(0.0, 0.0, self.egi.line[1])}
        rate = rates.get(where.get("link", ""), rates["imu"] - rates["egi"])
        speed_m_s = image.speed_m_s if image else 0.0
        return {
            "time_offset_from_stamps": by_stamps,
            DIFFERENCE: self._of_state(self.result.method, OFFSET) - by_stamps,
            "time_offset_drift": rate / _PPM,
            "clock_rate": rate / _PPM,
            "receive_jitter": rate * 0.5 * self.result.ready.span_s,  # delays that are not steady look like jitter
            "image_shift": speed_m_s * self._of_state(COMPENSATED, OFFSET),
        }.get(name)

    def departures(self) -> list[Departure]:
        """Return what could be true instead: what no label makes, that of the solutions, that of the delays.

        For the delays both ports have the same parts.
        """
        seen, imu, egi = self.seen, self.imu, self.egi
        motion = seen.motion.reshape(-1, 3, 3)
        moves = np.abs(motion) > _RESTS * np.abs(motion).max(axis=(0, 2), keepdims=True)
        found = [Departure("age", "constant", "ms", self._all(_MS * seen.motion)[:, None])]
        for name, columns in seen.others.items():
            unit, size = _OWN.get(name, ("ppm", _PPM))
            for axis, column in zip(_BODY, np.moveaxis(size * columns, 2, 0), strict=False):
                about = {"body": axis} if name in _OWN else {}
                found.append(Departure(name, "constant", unit, self._all(column)[:, None], about))
        count, ports = len(motion), ["imu"] * imu.delay_s.size + ["egi"] * egi.delay_s.size
        quantity = np.array([*np.tile(np.repeat(list(_UNITS), 3), count), *ports])
        carriers = {name: (unit, np.where(quantity == name, size, 0.0)) for name, (unit, size) in _UNITS.items()}
        solutions = Labels(
            kinds={"quantity": quantity, "axis": np.array([*np.tile(_AXES, 3 * count), *[""] * len(ports)])},
            hours=self._all(seen.at_s[:, None], seen.at_s[0], seen.at_s[0]) / _hour,
            visit=np.rint(self._all(seen.at_s[:, None], seen.at_s[0], seen.at_s[0]) / _MS).astype(int),
            carriers=carriers | {"age": ("ms", self._all((_MS * motion * moves).reshape(-1, 9)))},
            scopes=[(), ("quantity",), ("axis",)],
        )
        part_ms = np.rint((self.result.found.at_s + max(imu.since_s, egi.since_s, key=len)) / _MS)
        delays = Labels(
            kinds={"quantity": quantity},
            hours=self._all(imu.since_s[0], imu.since_s, egi.since_s) / _hour,
            visit=self._all(part_ms[0], part_ms[: imu.since_s.size], part_ms[: egi.since_s.size]).astype(int),
            carriers={"delay": ("ms", self._all(0.0, _MS, _MS))},
            scopes=[(), ("quantity",)],
        )
        return [*found, *departures_of(solutions), *departures_of(delays)]


def rows_of(result: SyncResult, densities: ImuDensities, spread: EgiSpread, taken: Recording) -> Rows:
    """Hold all solutions of a recording against the inertial unit at once, about what the chosen filter found."""
    found, clocks = result.found, result.clocks
    run, group, egi = found.run, GROUPS.index(result.method), found.egi
    guess = Guess(float(run.offset_s[-1, group, 0]), run.accel_bias[-1, group, 0], run.gyro_bias[-1, group, 0])
    noise = Noise(densities, spread, clocks.egi.tag_noise_s)
    seen = differences(result.ready.imu, egi, guess, noise, found.at_s)
    expected = np.concatenate((guess.accel_bias, guess.gyro_bias, [-guess.offset_s]))
    priors = np.stack([expected, [*np.repeat(densities.bias_sigmas, 3), OFFSET_STD_s]])
    imu, egi_delays = (
        delays_of(port, stream, at_s, found.at_s)
        for port, stream, at_s in ((clocks.imu, taken.imu, clocks.imu_s), (clocks.egi, taken.egi, clocks.egi_s))
    )
    return Rows(result, guess.offset_s, priors, seen, imu, egi_delays)


def chi2_of(rows: Residuals) -> tuple[float, int]:
    """Return the chi-square of what a fit leaves over, and its degrees of freedom."""
    q, _ = np.linalg.qr(rows.design / np.linalg.norm(rows.design, axis=0))
    left = rows.white - q @ (q.T @ rows.white)
    return float(left @ left), left.size - q.shape[1]
