"""The ring laser on the bench: mounted block, supply, mirror transducers; edges and housekeeping by bench time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS, Clock, to_ns
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.port import OnePortUnit
from sim_instruments.worlds.lock_in.block import Housekeeping, LaserBlock
from sim_instruments.worlds.lock_in.stream import PS, Columns, EdgeStream, joined

PORT = "rlg"
START_V = 13.5  # the discharge does not start below
BEAT_S = 3.0  # from power to the first edge
PS_PER_NS = PS // NS


@dataclass
class Life:
    """One switching-on of a block: from ``on_ns`` to ``off_ns`` (None: it still runs), with every transducer setting.

    ``settings``: (bench time, degree) from which each holds, the first one from the beginning.
    """

    block: LaserBlock
    on_ns: int
    settings: list[tuple[int, float]]
    off_ns: int | None = None
    stream: EdgeStream | None = field(default=None, repr=False)

    def beta_deg(self, t_ns: Integers) -> Floats:
        """Return phase of the backscatter at bench times, degree."""
        since, values = zip(*self.settings, strict=True)
        which = np.maximum(np.searchsorted(np.array(since), t_ns, side="right") - 1, 0)
        return np.asarray(self.block.beta_deg(np.array(values)[which], (t_ns - self.on_ns) / NS))


class RlgUnit(OnePortUnit):
    """The unit under test of the world ``ring_laser``.

    Args: clock: of the bench.   seed: of all draws.   block: mounted at the beginning.   phase_deg: transducers then.
    Attributes: epoch_ns: bench time from which the times of edges count.   lives: every switching-on so far.
    """

    port_name = PORT

    def __init__(self, clock: Clock, seed: int, block: LaserBlock, phase_deg: float) -> None:
        super().__init__(clock)
        self.block, self.phase_deg = block, phase_deg
        self.epoch_ns = clock.now_ns()
        self.lives: list[Life] = []
        self._seed = seed
        self._supplied = False
        self._housekeeping: Housekeeping | None = None
        self._running: deque[Life] = deque()  # whose edges are not all handed out; the last one may still be on

    # --- the bench ---------------------------------------------------------------------------------------------

    def set_power(self, on: bool, t_ns: int, voltage_V: float) -> None:
        """Supply on or off; switched on, the laser beats after ``BEAT_S``."""
        with self.lock:
            self._upto(max(t_ns, self._clock.now_ns()))
            supplied = on and voltage_V >= START_V
            if supplied == self._supplied:
                return
            self._supplied = supplied
            if supplied:
                self._start(t_ns)
            else:
                self._stop(t_ns)

    def mount(self, block: LaserBlock) -> None:
        """Another block; with the supply on it starts at once. The one that is there already stays as it is."""
        with self.lock:
            if block.number == self.block.number:
                return
            now_ns = self._upto(self._clock.now_ns())
            self._stop(now_ns)
            self.block = block
            if self._supplied:
                self._start(now_ns)

    def set_phase(self, phase_deg: float) -> None:
        """Mirror transducers to another phase of the backscatter; a running laser follows within a half cycle."""
        with self.lock:
            now_ns = self._upto(self._clock.now_ns())
            self.phase_deg = phase_deg
            life = self.lives[-1] if self.lives else None
            if life is not None and life.off_ns is None and life.stream is not None:
                life.settings.append((now_ns, phase_deg))
                life.stream.change((now_ns - self.epoch_ns) * PS_PER_NS)

    # --- edges -------------------------------------------------------------------------------------------------

    def edges_until(self, t_ns: int) -> Columns:
        """Return edges before a bench time that were not yet handed out, see world."""
        with self.lock:
            parts: list[Columns] = []
            for life in self._with_edges(t_ns):
                assert life.stream is not None
                parts.append(life.stream.until(self._end_ps(life, t_ns)))
            return joined(parts)

    def skip_edges(self, t_ns: int) -> None:
        """Nobody looked at anything before a bench time."""
        with self.lock:
            for life in self._with_edges(t_ns):
                if life.off_ns is None and life.stream is not None:
                    life.stream.skip(self._end_ps(life, t_ns))

    def _with_edges(self, t_ns: int) -> list[Life]:
        """Return lives that may have edges before a time; those that ended by then are forgotten."""
        edges = list(self._running)
        while self._running and self._running[0].off_ns is not None and self._running[0].off_ns <= t_ns:
            self._running.popleft()
        return edges

    def _end_ps(self, life: Life, t_ns: int) -> int:
        end_ns = t_ns if life.off_ns is None else min(t_ns, life.off_ns)
        return (end_ns - self.epoch_ns) * PS_PER_NS

    # --- time --------------------------------------------------------------------------------------------------

    def _upto(self, now_ns: int) -> int:
        if self._housekeeping is not None:
            self._housekeeping.send(now_ns)
        return now_ns

    def _start(self, t_ns: int) -> None:
        life_number = len(self.lives)
        block = self.block

        def draw(purpose: str, *indexes: int) -> np.random.Generator:
            return generator(self._seed, f"ring laser {purpose}", block.number, life_number, *indexes)

        beat_ns = t_ns + to_ns(BEAT_S)
        life = Life(block, t_ns, [(t_ns, self.phase_deg)])

        def beta_rad(t_ps: Integers) -> Floats:
            return np.radians(life.beta_deg(self.epoch_ns + t_ps // PS_PER_NS))

        stream = EdgeStream(block.laser, (beat_ns - self.epoch_ns) * PS_PER_NS, beta_rad, draw)
        life.stream = stream

        def dither_deg_s(at_ns: int) -> float:
            return stream.dither_deg_s((at_ns - self.epoch_ns) * PS_PER_NS, 0.1)

        self._housekeeping = Housekeeping(self.port, block, t_ns, beat_ns, dither_deg_s, draw)
        self.lives.append(life)
        self._running.append(life)

    def _stop(self, t_ns: int) -> None:
        if self.lives and self.lives[-1].off_ns is None:
            self.lives[-1].off_ns = t_ns
        self._housekeeping = None
