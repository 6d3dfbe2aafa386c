"""Samples of a recording as the filter takes them: increments without holes, solutions in one tangent frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from bench.maths.arrays import Flags, Floats
from bench.maths.geodesy import TangentFrame, body_to_level
from bench.maths.samples import off_course, repeats
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.kalman.setup import EgiSamples, ImuSamples
from bench.systems.time_sync.estimators.port_clocks import even_tags_s
from bench.systems.time_sync.records import Recording, Stream
from bench.systems.time_sync.wording import say

LONGEST_GAP = 20  # samples of the inertial unit, 0.1 s: a longer gap is not bridged
LEAST_s = 15.0  # of a recording
_LEAST_SHARE = 0.5  # of the recording that must be in one piece
_LEAST_EGI = 200
_NAVIGATING = 3  # mode of the EGI: GPS and inertial
_MOVED_m = 1e-3  # between two solutions: a vehicle that does so is not where it was


@dataclass(frozen=True)
class Prepared:
    """Samples that the filter takes in, and counts of those left out on the way.

    ``filled``: samples of the inertial unit made up.   ``lost_egi``, ``unsound_egi``: solutions that are missing or not
    used.   ``odd_egi``, ``odd_imu``: single ones that were left out because
    they are unlike their neighbours.   ``stuck_egi``: solutions that repeat the one before while the vehicle moves.
    ``notes``: sentences about it.
    """

    imu: ImuSamples
    egi: EgiSamples
    filled: int
    lost_egi: int
    unsound_egi: int
    odd_egi: int = 0
    odd_imu: int = 0
    stuck_egi: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def span_s(self) -> float:
        """Length of what is analysed."""
        return float(self.imu.t_s[-1] - self.imu.t_s[0])

    @property
    def middle_s(self) -> float:
        """Middle of what is analysed, time of the inertial unit."""
        return 0.5 * float(self.imu.t_s[-1] + self.imu.t_s[0])


def prepared(taken: Recording) -> Prepared:
    """Inputs of the filter.

    Raises: FitError B-SYNC-003 (too short), B-SYNC-007 (a gap cuts the recording), B-SYNC-008 (no sound solutions).
    """
    notes: list[str] = []
    sound = taken.imu.part(taken.imu.columns["status"] == 0)
    piece = _longest_piece(sound, notes)
    even = _without_odd_increments(piece, notes)
    imu = _filled(even)
    egi, odd_egi = _without_odd_solutions(_egi(taken.egi), taken.egi, notes)
    navigating = int(np.count_nonzero(_navigating(taken.egi)))
    return Prepared(
        imu=imu,
        egi=egi,
        filled=int(imu.filled.sum()),
        lost_egi=taken.egi.lost,
        unsound_egi=len(taken.egi) - navigating,
        odd_egi=odd_egi,
        odd_imu=len(piece) - len(even),
        stuck_egi=_stuck(egi),
        notes=notes,
    )


def steady_s(stream: Stream) -> Floats:
    """Return the time tags of a stream without their noise, (n,), as ``even_tags_s``."""
    return even_tags_s(stream.tick_s, stream.counter)


def _longest_piece(imu: Stream, notes: list[str]) -> Stream:
    """Return the longest stretch without a gap of more than ``LONGEST_GAP`` samples."""
    steps = np.diff(imu.counter)
    cuts = np.flatnonzero(steps > LONGEST_GAP + 1) + 1
    edges = [0, *cuts.tolist(), len(imu)]
    begin, end = max(pairwise(edges), key=lambda piece_edges: piece_edges[1] - piece_edges[0], default=(0, 0))
    whole_s = float(imu.tick_s[-1] - imu.tick_s[0]) if len(imu) else 0.0
    piece_s = float(imu.tick_s[end - 1] - imu.tick_s[begin]) if end > begin else 0.0
    if cuts.size:
        at_s = float(imu.tick_s[cuts[0] - 1] - imu.tick_s[0])
        gap = say("gap", count=int(steps[cuts[0] - 1]) - 1, at=at_s)
        if piece_s < max(_LEAST_SHARE * whole_s, LEAST_s):
            raise FitError(
                "B-SYNC-007",
                f"{gap}; {LONGEST_GAP} can be bridged, and the longest piece without such a gap is {piece_s:.1f} s of "
                f"{whole_s:.1f} s",
                next_step="records of one motion must follow each other ('follows: true'); look at the link of the "
                "inertial unit: baud rate, cable, load; record again",
            )
        notes.append(say("note.piece", gap=gap, piece=piece_s, whole=whole_s))
    if piece_s < LEAST_s:
        raise FitError(
            "B-SYNC-003",
            f"{piece_s:.1f} s of samples of the inertial unit, {LEAST_s:g} s are the least",
            next_step="record longer: straight motion, a manoeuvre, straight motion",
        )
    return imu.part(slice(begin, end))


def _filled(imu: Stream) -> ImuSamples:
    """Increments on every counter; missing ones by their neighbours on both sides."""
    counter = np.arange(imu.counter[0], imu.counter[-1] + 1)
    there = np.zeros(counter.size, bool)
    there[imu.counter - imu.counter[0]] = True

    def even(column: Floats) -> Floats:
        parts = [np.interp(counter, imu.counter, column[:, axis]) for axis in range(3)]
        return np.stack(parts, axis=1)[:, None, :]

    t_s = np.interp(counter, imu.counter, steady_s(imu))
    return ImuSamples(t_s, even(imu.columns["delta_velocity"]), even(imu.columns["delta_angle"]), ~there)


def _navigating(egi: Stream) -> Flags:
    return np.asarray((egi.columns["status"] == 0) & (egi.columns["mode"] == _NAVIGATING))


def _without_odd_increments(imu: Stream, notes: list[str]) -> Stream:
    """Return samples without single ones that are unlike their neighbours; what is missing is filled in."""
    values = np.concatenate((imu.columns["delta_velocity"], imu.columns["delta_angle"]), axis=1)
    odd = off_course(values, imu.counter)
    if not odd.size:
        return imu
    notes.append(_left_out("imu", odd.size, float(imu.tick_s[odd[0]] - imu.tick_s[0])))
    keep = np.ones(len(imu), bool)
    keep[odd] = False
    return imu.part(keep)


def _without_odd_solutions(egi: EgiSamples, stream: Stream, notes: list[str]) -> tuple[EgiSamples, int]:
    """Return solutions without single ones that are unlike their neighbours, and how many these are."""
    counter = stream.counter[_navigating(stream)]
    odd = off_course(np.concatenate((egi.p, egi.v, egi.C.reshape(-1, 9)), axis=1), counter)
    if not odd.size:
        return egi, 0
    notes.append(_left_out("egi", odd.size, float(egi.t_s[odd[0]] - egi.t_s[0])))
    keep = np.ones(egi.t_s.size, bool)
    keep[odd] = False
    return egi.part(keep), int(odd.size)


def _left_out(link: str, count: int, after_s: float) -> str:
    return say(f"note.odd_{link}", count=count, after=after_s)


def _stuck(egi: EgiSamples) -> int:
    """Return how many solutions repeat the one before bit by bit, although they say that the vehicle moves."""
    moved_m = np.linalg.norm(egi.v[1:], axis=1) * np.diff(egi.t_s)
    return int(np.count_nonzero(repeats(egi.p, egi.v) & (moved_m > _MOVED_m)))


def _egi(egi: Stream) -> EgiSamples:
    """Sound solutions in the tangent frame at the first of them."""
    sound = _navigating(egi)
    if np.count_nonzero(sound) < _LEAST_EGI:
        raise FitError(
            "B-SYNC-008",
            f"{int(np.count_nonzero(sound))} of {len(egi)} solutions of the EGI are sound (status 0, mode "
            f"{_NAVIGATING}), {_LEAST_EGI} are the least",
            next_step="wait until the EGI navigates with GPS before the first record; look at its status",
        )
    solutions = egi.part(sound)
    tags_s = steady_s(egi)[sound]
    latitude, longitude = solutions.columns["latitude"], solutions.columns["longitude"]
    frame = TangentFrame(float(latitude[0]), float(longitude[0]))
    turn = frame.from_level(latitude, longitude)
    attitude = solutions.columns["attitude"]
    return EgiSamples(
        t_s=tags_s,
        p=frame.positions_m(latitude, longitude, solutions.columns["height"]),
        v=np.einsum("nij,nj->ni", turn, solutions.columns["velocity"]),
        C=turn @ body_to_level(attitude[:, 0], attitude[:, 1], attitude[:, 2]),
        frame=frame,
        position_std_m=float(np.median(solutions.columns["position_sigma"])),
    )
