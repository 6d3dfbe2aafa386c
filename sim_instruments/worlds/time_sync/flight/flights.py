"""One flight of the simulated vehicle: its path as commands and the turning table make it, and its sensors' draws.

The path is one of pieces of constant yaw rate. Where the table changes its rate the pieces are 1 ms long, with yaw
exact at their ends; in between it is off by 1.3e-4 deg at 1000 deg/s2. A piece begins as it is planned then; a command
ends it where it comes, and the first ms behind it makes up for what the piece before was off. So the path depends on
commands and their times alone, never on when somebody looked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from bench.model.arrays import Integers
from bench.model.clock import NS
from sim_instruments.worlds.common.motion import AxisMotion, Piece
from sim_instruments.worlds.time_sync.flight.imu import ImuErrors
from sim_instruments.worlds.time_sync.flight.path import FlightPath
from sim_instruments.worlds.time_sync.stream import UnitClock

STANDING = 1000  # number of the time before the first flight, whose number is 0
RAMP_S = 1e-3
_SAME_DEG = 1e-10


class TableAxis(AxisMotion):
    """The axis that carries the vehicle's heading: whoever changes its motion tells the flight before.

    Attributes: on_change: called with the bench time of a change in ns, before it holds.
    """

    def __init__(self) -> None:
        super().__init__()
        self.on_change: Callable[[int], None] = lambda _t_ns: None

    def _plan(self, t_ns: int, here_deg: float, speed: float, phases: list[tuple[float, float]]) -> None:
        self.on_change(t_ns)
        super()._plan(t_ns, here_deg, speed, phases)

    def plan_at(self, t_ns: float) -> tuple[Piece, float]:
        """Return the piece of motion that holds at a bench time, and when it ends, in ns (inf: not planned)."""
        end_ns = math.inf
        for piece in reversed(self._pieces):
            begin_ns = piece.base_ns + NS * piece.start_s
            if begin_ns <= t_ns + 0.5:
                return piece, end_ns
            end_ns = begin_ns
        return self._pieces[0], end_ns


class Flight:
    """A flight from ``begin_ns`` on, north with a speed, until the next one begins.

    Args:
        seed, number: name the draws of its sensors.   begin_ns: bench time.   speed_m_s: along track, not negative.
        table: turns the vehicle; heading = - (angle now - angle at the beginning), so a right turn is a negative rate.
        flies: False for the time before the first one, when the EGI is not aligned yet.
    Attributes: path: in seconds since the beginning; complete up to the last ``upto``.   imu: errors of the IMU.
    """

    def __init__(
        self, seed: int, number: int, begin_ns: int, speed_m_s: float, table: TableAxis, *, flies: bool = True
    ) -> None:
        self.seed, self.number, self.begin_ns, self.speed_m_s, self.flies = seed, number, begin_ns, speed_m_s, flies
        self.imu = ImuErrors(seed, number)
        self._table = table
        self._first_deg = float(table.angle_deg(begin_ns))
        self._acceleration_m_s2 = 0.0
        self._yaw_deg, self._rate_deg_s = 0.0, 0.0  # at the begin of the newest piece, and of it
        self._begin_s, self._end_s = 0.0, 0.0  # of the newest piece
        self.path = FlightPath([(0.0, 0.0, 0.0)], speed_m_s=speed_m_s)

    def seconds(self, t_ns: int) -> float:
        """Return time of the flight at a bench time."""
        return (t_ns - self.begin_ns) / NS

    def upto(self, t_ns: int) -> None:
        """Make the path complete up to a bench time that nobody can change any more."""
        while self._end_s < self.seconds(t_ns):
            self._add(self._end_s)

    def accelerate(self, acceleration_m_s2: float, t_ns: int) -> None:
        """Another acceleration along track from a bench time on."""
        self.break_at(t_ns)
        self._acceleration_m_s2 = acceleration_m_s2

    def break_at(self, t_ns: int) -> None:
        """Something changes at a bench time: the piece of then ends there."""
        self.upto(t_ns)
        self._end_s = max(self.seconds(t_ns), self._begin_s)

    def _add(self, begin_s: float) -> None:
        """The next piece, as it is planned now."""
        self._yaw_deg += self._rate_deg_s * (begin_s - self._begin_s)
        at_ns = self.begin_ns + NS * begin_s
        plan, planned_ns = self._table.plan_at(at_ns)
        end_s = (planned_ns - self.begin_ns) / NS
        behind_deg = self._heading_deg(plan, begin_s) - self._yaw_deg
        self._rate_deg_s = -plan.rate_deg_s
        if plan.acceleration_deg_s2 or abs(behind_deg) > _SAME_DEG:
            end_s = min(end_s, begin_s + RAMP_S)
            self._rate_deg_s = (self._heading_deg(plan, end_s) - self._yaw_deg) / (end_s - begin_s)
        self._begin_s, self._end_s = begin_s, end_s
        self.path.add(begin_s, self._acceleration_m_s2, self._rate_deg_s)

    def _heading_deg(self, plan: Piece, flight_s: float) -> float:
        since_s = (self.begin_ns - plan.base_ns) / NS + flight_s - plan.start_s
        angle_deg = plan.angle_deg + since_s * (plan.rate_deg_s + 0.5 * plan.acceleration_deg_s2 * since_s)
        return self._first_deg - angle_deg


class Flights:
    """All flights of a bench, the first one before anybody started one.

    Args: seed: of their draws.   begin_ns: bench time of the beginning.   table: turns the vehicle.
    """

    def __init__(self, seed: int, begin_ns: int, table: TableAxis) -> None:
        self._seed, self._table = seed, table
        self.all = [Flight(seed, STANDING, begin_ns, 0.0, table, flies=False)]
        table.on_change = self._break_at

    @property
    def newest(self) -> Flight:
        """The flight of now."""
        return self.all[-1]

    def begin(self, speed_m_s: float, t_ns: int) -> None:
        """A new flight from a bench time on."""
        self.newest.break_at(t_ns)
        self.all.append(Flight(self._seed, len(self.all) - 1, t_ns, speed_m_s, self._table))

    def _break_at(self, t_ns: int) -> None:
        self.newest.break_at(t_ns)

    def at(self, t_ns: int) -> Flight:
        """Return the flight of a bench time."""
        return next((flight for flight in reversed(self.all) if flight.begin_ns <= t_ns), self.all[0])

    def split(self, clock: UnitClock, period_s: float, number: Integers) -> Iterator[tuple[Flight, int, slice]]:
        """Yield samples in a row by flight: the flight, the number of its first sample on that clock, and which ones.

        A sample belongs to the flight of the moment it is valid, at the end of its interval. The paths are complete up
        to the last of them, which must be in the past or sure.
        """
        stop = number.size
        for flight in reversed(self.all):
            first = math.ceil(clock.reading_s(flight.begin_ns) / period_s)
            begin = min(max(first - int(number[0]), 0), stop) if flight is not self.all[0] else 0
            if begin < stop:
                if flight is self.newest:
                    flight.upto(int(clock.times_ns(number[stop - 1 : stop] * period_s)[0]))
                yield flight, first, slice(begin, stop)
            stop = begin
