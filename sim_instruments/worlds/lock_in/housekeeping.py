"""Housekeeping of a ring laser: ten frames a second from half a second after switching on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.frame import load_frame
from bench.model.clock import NS
from bench.model.shipped import find_shipped
from sim_instruments.worlds.common.port import Port
from sim_instruments.worlds.lock_in.block import LaserBlock

Int64 = NDArray[np.int64]

PERIOD_NS = NS // 10
BOOT_NS = NS // 2  # from power to the first frame
NO_BEAT = 1  # status bit
AT_ONCE = 64
_NOISE_DEGC, _NOISE_V, _NOISE_DEG_S = 0.01, 2e-4, 0.05
_STEP_DEGC, _STEP_V, _STEP_DEG_S = 0.01, 1e-4, 0.01  # of the frame's fields
_MOST = (1 << 16) - 1


class Housekeeping:
    """Sends the housekeeping of one switching-on.

    Args:
        port: where to.   block: of which laser.   on_ns: when it got power.   beat_ns: when it begins to beat.
        dither_deg_s: mean amplitude over the last 0.1 s at a bench time.   draw: generator of a purpose and a number.
    """

    def __init__(
        self,
        port: Port,
        block: LaserBlock,
        on_ns: int,
        beat_ns: int,
        dither_deg_s: Callable[[int], float],
        draw: Callable[..., np.random.Generator],
    ) -> None:
        self._definition = load_frame(find_shipped("frames", "rlg_housekeeping"))
        self._port, self._block, self._on_ns, self._beat_ns = port, block, on_ns, beat_ns
        self._dither_deg_s, self._draw = dither_deg_s, draw
        self._sent = 0

    def send(self, upto_ns: int) -> None:
        """Send all frames due; nobody listens = nothing is made, the counter goes on."""
        due = max(0, (upto_ns - self._on_ns - BOOT_NS) // PERIOD_NS + 1)
        if not self._port.listened:
            self._sent = max(self._sent, due)
        while self._sent < due:
            stop = min(due, (self._sent // AT_ONCE + 1) * AT_ONCE)
            self._append(np.arange(self._sent, stop, dtype=np.int64))
            self._sent = stop

    def _append(self, number: Int64) -> None:
        t_ns = self._on_ns + BOOT_NS + number * PERIOD_NS
        beats = t_ns >= self._beat_ns
        noise = self._draw("housekeeping", int(number[0]) // AT_ONCE).standard_normal((AT_ONCE, 3))[number % AT_ONCE]
        degC = self._block.degC((t_ns - self._on_ns) / NS)
        volt = self._block.intensity_V(degC) * beats + _NOISE_V * noise[:, 1]
        true = np.array([self._dither_deg_s(int(t)) for t in t_ns])
        dither = (true * self._block.dither_gain + _NOISE_DEG_S * noise[:, 2]) * (true > 0.0)
        columns = {
            "counter": (number % 2**32).astype(np.uint32),
            "temperature": np.rint((degC + _NOISE_DEGC * noise[:, 0]) / _STEP_DEGC).astype(np.int16),
            "intensity": np.clip(np.rint(volt / _STEP_V), 0, _MOST).astype(np.uint16),
            "dither_amplitude": np.clip(np.rint(dither / _STEP_DEG_S), 0, _MOST).astype(np.uint16),
            "status": np.where(beats, 0, NO_BEAT).astype(np.uint16),
        }
        self._port.append(t_ns, self._definition.encode(columns, len(number)))
