"""One serial output of a simulated unit: frames with the times at which their bytes are on the line."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench.model.arrays import Integers, Octets
from bench.model.clock import NS, Clock
from sim_instruments.faults.switchboard import LinkFaults

BITS_PER_BYTE = 10  # start bit, eight bits, stop bit


@dataclass(frozen=True)
class _Stretch:
    """Some frames in a row. ``ready_ns``, ``start_ns``, ``end_ns``: made, first bit and last bit on the line, (n,).

    ``stops``: stream offset behind each frame, (n,); the bytes begin at stream offset ``base`` and stay where the
    frames were made until somebody reads them.
    """

    ready_ns: Integers
    start_ns: Integers
    end_ns: Integers
    stops: Integers
    base: int
    chunk: memoryview

    def cut(self, keep: int) -> _Stretch:
        """Return the first ``keep`` frames, at least one."""
        stops = self.stops[:keep]
        chunk = self.chunk[: int(stops[-1]) - self.base]
        return _Stretch(self.ready_ns[:keep], self.start_ns[:keep], self.end_ns[:keep], stops, self.base, chunk)

    @property
    def stop(self) -> int:
        """Stream offset behind the last frame."""
        return self.base + len(self.chunk)

    def arrived(self, now_ns: int, baud: int) -> int:
        """Return stream offset up to which bytes have arrived."""
        at = int(self.start_ns.searchsorted(now_ns, "right")) - 1
        if at < 0:
            return self.base
        before = int(self.stops[at - 1]) if at else self.base
        sent = (now_ns - int(self.start_ns[at])) * baud // (BITS_PER_BYTE * NS)
        return min(before + sent, int(self.stops[at]))

    def arrived_by(self, t_ns: Integers, baud: int) -> Integers:
        """Return ``arrived`` at several times, (n,); 0 before the first bit."""
        at = self.start_ns.searchsorted(t_ns, "right") - 1
        before = np.where(at > 0, self.stops[np.maximum(at - 1, 0)], self.base)
        sending_ns = np.minimum(t_ns, self.end_ns[at]) - self.start_ns[at]
        arrived = np.minimum(before + sending_ns * baud // (BITS_PER_BYTE * NS), self.stops[at])
        return np.where(at < 0, 0, arrived)


class Port:
    """Frames go in with the time they are ready, bytes come out when the line has carried them.

    The unit may generate ahead of time and later take back what is not yet true: ``produced`` numbers every frame, so
    frames that are made again but were kept are recognised and never change.
    """

    def __init__(self) -> None:
        self.produced = 0
        self._baud = 115_200
        self._kept = 0
        self._busy_ns = 0
        self._total = 0
        self._read = 0
        self._stretches: deque[_Stretch] = deque()
        self._faults: LinkFaults | None = None
        self._arrived = (-1, 0)  # time of the last question, stream offset that had arrived then
        self.listened = False

    def connect(self, baud: int, faults: LinkFaults | None) -> None:
        """Somebody listens from now on at this baud rate; ``faults`` damages what is made from now on."""
        self._baud, self._faults, self.listened = baud, faults, True
        self._arrived = (-1, 0)

    def disconnect(self) -> None:
        """Nobody listens any more."""
        self.listened = False

    # --- the unit's side ---------------------------------------------------------------------------------------

    def append(self, ready_ns: Integers, frames: Octets) -> None:
        """Queue frames (n, length) made at ``ready_ns`` (n,), rising; those that were kept already are passed over."""
        skip = min(max(self._kept - self.produced, 0), len(frames))
        first = self.produced + skip
        self.produced += len(frames)
        if skip == len(frames):
            return
        ready_ns, frames = ready_ns[skip:], frames[skip:]
        self._kept = self.produced
        each_ns = -(-BITS_PER_BYTE * NS * frames.shape[1] // self._baud)
        took = np.arange(len(frames), dtype=np.int64) * each_ns
        waited = ready_ns - took
        waited[0] = max(int(waited[0]), self._busy_ns)
        start_ns = np.maximum.accumulate(waited) + took
        self._busy_ns = int(start_ns[-1]) + each_ns
        chunk, stops = self._on_line(first, frames)
        base = self._total
        self._stretches.append(_Stretch(ready_ns, start_ns, start_ns + each_ns, base + stops, base, chunk))
        self._arrived = (-1, 0)
        self._total += len(chunk)

    def take_back(self, t_ns: int, produced: int) -> None:
        """Forget frames made after ``t_ns``; the unit makes them again from its frame number ``produced`` on."""
        while self._stretches and int(self._stretches[-1].ready_ns[-1]) > t_ns:
            last = self._stretches.pop()
            keep = int(last.ready_ns.searchsorted(t_ns, "right"))
            self._kept -= len(last.ready_ns) - keep
            self._total = last.base
            if keep:
                self._stretches.append(last.cut(keep))
                self._total = int(last.stops[keep - 1])
        self.produced = produced
        self._arrived = (-1, 0)
        self._busy_ns = int(self._stretches[-1].end_ns[-1]) if self._stretches else 0

    def _on_line(self, first: int, frames: Octets) -> tuple[memoryview, Integers]:
        """Return bytes that arrive, and the offset behind each frame, (n,), with the faults of the link."""
        n, length = frames.shape
        if self._faults is None or not self._faults.active:
            return frames.reshape(-1).data, np.arange(1, n + 1, dtype=np.int64) * length
        frames = self._faults.frames(first, frames)
        copies = self._faults.copies(first, n)
        return np.repeat(frames, copies, axis=0).reshape(-1).data, np.cumsum(copies) * length

    # --- the listener's side -----------------------------------------------------------------------------------

    def waiting(self, now_ns: int) -> int:
        """Return bytes that have arrived and are not read."""
        if self._arrived[0] != now_ns:
            arrived = self._read
            for stretch in self._stretches:
                arrived = max(arrived, stretch.arrived(now_ns, self._baud))
                if arrived < stretch.stop:
                    break
            self._arrived = (now_ns, arrived)
        return self._arrived[1] - self._read

    def arrivals(self, t_ns: Integers) -> Integers:
        """Return bytes that can be read at each of the coming times, (n,), if nobody reads before."""
        arrived = np.full(t_ns.shape, self._read, np.int64)
        for stretch in self._stretches:
            np.maximum(arrived, stretch.arrived_by(t_ns, self._baud), out=arrived)
        return arrived - self._read

    def read(self, size: int, now_ns: int) -> bytes:
        """Return up to ``size`` bytes of those that have arrived."""
        stop = self._read + min(size, self.waiting(now_ns))
        parts = []
        for stretch in self._stretches:
            if stretch.base >= stop:
                break
            parts.append(stretch.chunk[max(self._read - stretch.base, 0) : stop - stretch.base])
        self._read = stop
        self._drop_read(now_ns)
        return b"".join(parts)

    def discard(self, now_ns: int) -> None:
        """Lose what has arrived."""
        self._read += self.waiting(now_ns)
        self._drop_read(now_ns)

    def _drop_read(self, now_ns: int) -> None:
        while self._stretches:
            oldest = self._stretches[0]
            if oldest.stop > self._read or int(oldest.end_ns[-1]) > now_ns:
                break
            self._stretches.popleft()


class PortedUnit:
    """Base of simulated units with serial ports: they send what is due in ``_upto_now``.

    Args: ports: by name.   Attributes: lock: held while the unit does anything.
    """

    def __init__(self, ports: Mapping[str, Port]) -> None:
        self._ports = ports
        self.lock = threading.RLock()

    def port_at(self, name: str) -> tuple[PortedUnit, str] | None:
        """Return the unit behind a port of the bench and its own name for it; None without such a port."""
        return (self, name) if name in self._ports else None

    def connect(self, name: str, baud: int, faults: LinkFaults | None = None) -> None:
        """Listen to a port from now on; ``faults`` damages what is sent from now on."""
        with self.lock:
            self._upto_now()
            self._ports[name].connect(baud, faults)

    def disconnect(self, name: str) -> None:
        """Stop listening."""
        with self.lock:
            self._upto_now()
            self._ports[name].disconnect()

    def waiting(self, name: str) -> int:
        """Return bytes that have arrived by now and are not read."""
        with self.lock:
            return self._ports[name].waiting(self._upto_port(name))

    def read(self, name: str, size: int) -> bytes:
        """Return up to ``size`` bytes of those that have arrived by now."""
        with self.lock:
            return self._ports[name].read(size, self._upto_port(name))

    def arrivals(self, name: str, t_ns: Integers) -> Integers:
        """Return bytes that can be read at each of the coming times, before which nobody changes anything, if known."""
        with self.lock:
            return self._ports[name].arrivals(self._foreseen(name, t_ns))

    def discard(self, name: str) -> None:
        """Lose what has arrived by now."""
        with self.lock:
            self._ports[name].discard(self._upto_port(name))

    def write(self, name: str, sent: bytes) -> None:
        """The unit does not listen."""

    def _foreseen(self, name: str, t_ns: Integers) -> Integers:
        """Send ahead; returns those of the coming times by which all that is sent is known: none."""
        del name
        return t_ns[:0]

    def _upto_port(self, name: str) -> int:
        """Send what is due at one port at least; returns the time of now."""
        del name
        return self._upto_now()

    def _upto_now(self) -> int:
        """Send everything that is due; returns the time of now."""
        raise NotImplementedError


class OnePortUnit(PortedUnit):
    """Base of units with one port, which they say the name of; what nobody hears is lost.   Attributes: port."""

    port_name: ClassVar[str]

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.port = Port()
        super().__init__({self.port_name: self.port})

    def _upto(self, now_ns: int) -> int:
        """Let happen and send what is due by a time; returns it."""
        raise NotImplementedError

    def _upto_now(self) -> int:
        now_ns = self._upto(self._clock.now_ns())
        if not self.port.listened:
            self.port.discard(now_ns)
        return now_ns
