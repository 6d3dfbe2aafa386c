"""The wires of a bench: calibrator, relay matrix, channels of the unit.

The matrix is a two-pole 4 x 10 card: column = channel, row 1 joins the calibrator's HI and LO to the channel
directly, row 2 crossed. Rows 3 and 4 go nowhere. Columns of further cards, each of a unit, are counted on. Every
current is piecewise constant between switching events.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from sim_instruments.seeds import generator

CHANNELS = 10
DIRECT_ROW, REVERSED_ROW = 1, 2
LEAKAGE_A = 1e-10
TRIP_CURRENT_A = 1e-7  # a larger current that loses its path drives the calibrator into its compliance limit

Crosspoint = tuple[int, int]


class UnitInputs(Protocol):
    """The inputs of the unit under test, as far as wires reach it."""

    def set_input(self, channel: int, current_A: float, t_ns: int) -> None:
        """External current into a channel, ampere, positive = into the positive terminal; 0 if nothing is connected."""


class Wiring:
    """Closed crosspoints and the current the calibrator drives; keeps the unit's inputs up to date."""

    def __init__(self, unit: UnitInputs, seed: int, channels: int = CHANNELS) -> None:
        self._unit, self._channels = unit, range(1, channels + 1)
        self._closed: frozenset[Crosspoint] = frozenset()
        self._source_A: float | None = None
        self._applied: dict[int, float | None] = dict.fromkeys(self._channels)
        draws = generator(seed, "switch leakage").uniform(-LEAKAGE_A, LEAKAGE_A, (2, channels))
        self.leakage_A: np.ndarray = draws  # (row - 1, channel - 1)
        self.on_lost_path: Callable[[], None] = lambda: None

    @property
    def closed(self) -> frozenset[Crosspoint]:
        """Closed crosspoints as (row, column)."""
        return self._closed

    @property
    def has_path(self) -> bool:
        """Whether the calibrator's current can flow: some column is joined, or HI and LO are shorted."""
        return any(row in (DIRECT_ROW, REVERSED_ROW) for row, _ in self._closed)

    @property
    def loop_current_A(self) -> float:
        """Current in the calibrator's leads, ampere; 0 in standby or without a path."""
        return self._source_A if self._source_A is not None and self.has_path else 0.0

    def drive(self, current_A: float | None, t_ns: int) -> None:
        """Let the calibrator drive a current (None: output off, its terminals are open)."""
        self._source_A = current_A
        self._update(t_ns)

    def switch(self, closed: frozenset[Crosspoint], t_ns: int) -> None:
        """Move relays; a current that loses its path trips the calibrator."""
        self._closed = closed
        lost = self._source_A is not None and abs(self._source_A) > TRIP_CURRENT_A and not self.has_path
        if lost:
            self.on_lost_path()
        self._update(t_ns)

    def channel_inputs_A(self) -> dict[int, float | None]:
        """Return current into each channel, ampere; None where nothing is connected.

        Parallel columns share the current evenly (equal input resistances); a column with both rows closed shorts
        HI to LO, so no channel gets the calibrator's current then.
        """
        rows = {channel: self._rows(channel) for channel in self._channels}
        joined = [channel for channel, closed in rows.items() if closed]
        shorted = any(len(closed) == 2 for closed in rows.values())
        share_A = 0.0 if shorted or self._source_A is None else self._source_A / max(1, len(joined))
        inputs: dict[int, float | None] = {}
        for channel, closed in rows.items():
            leakage_A = sum(float(self.leakage_A[row - 1, channel - 1]) for row in closed)
            sign = -1.0 if REVERSED_ROW in closed else 1.0
            inputs[channel] = sign * share_A + leakage_A if closed else None
        return inputs

    def _rows(self, channel: int) -> list[int]:
        return [row for row in (DIRECT_ROW, REVERSED_ROW) if (row, channel) in self._closed]

    def _update(self, t_ns: int) -> None:
        for channel, current_A in self.channel_inputs_A().items():
            if current_A == self._applied[channel]:
                continue
            self._applied[channel] = current_A
            self._unit.set_input(channel, current_A or 0.0, t_ns)
