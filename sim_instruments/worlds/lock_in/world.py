"""The world of the ring-laser bench: laser blocks by path length, their supply, mirror transducers, comparators."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from bench.model.clock import Clock
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.lock_in.block import LaserBlock
from sim_instruments.worlds.lock_in.options import completed
from sim_instruments.worlds.lock_in.stream import Columns
from sim_instruments.worlds.lock_in.truth import estimates
from sim_instruments.worlds.lock_in.unit import PORT, START_V, RlgUnit

FIRST_PATH_M, FIRST_PHASE_DEG = 0.28, 90.0
LEAST_PATH_M, MOST_PATH_M, MOST_PHASE_DEG = 0.05, 1.0, 360.0


class RlgWorld(World):
    """One simulated ring-laser bench.

    Args: clock, seed: as of every world.   options: checked ones of rlg_options, any of them may be missing.
    """

    ports = (PORT,)
    operations: ClassVar[tuple[str, ...]] = ("path_length", "backscatter_phase")

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        self._completed = completed(options)
        self.laser_unit = RlgUnit(clock, seed, LaserBlock.drawn(seed, FIRST_PATH_M, self._completed), FIRST_PHASE_DEG)
        super().__init__(clock=clock, seed=seed, unit=self.laser_unit, thermal=Thermal(), options=options)

    def operate(self, name: str, value: Any) -> None:
        """What a person does at the bench: ``path_length`` (m), ``backscatter_phase`` (deg, mirror transducers).

        Raises: InputError B-SIM-018 for another name, B-SIM-019 for a value that cannot be.
        """
        self.check_operation(name, value)
        number = float(value)
        with self.lock:
            if name == "path_length":
                self.laser_unit.mount(LaserBlock.drawn(self.seed, number, self._completed))
            else:
                self.laser_unit.set_phase(number)

    @classmethod
    def check_operation(cls, name: str, value: Any) -> None:
        """Raises: InputError B-SIM-018, B-SIM-019."""
        super().check_operation(name, value)
        least, most, unit = LEAST_PATH_M, MOST_PATH_M, "m"
        if name == "backscatter_phase":
            least, most, unit = -MOST_PHASE_DEG, MOST_PHASE_DEG, "deg"
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not least <= number <= most:
            raise InputError(
                "B-SIM-019", f"{name} cannot be {value!r}", where="sets of a prompt",
                next_step=f"give {least:g} to {most:g} {unit}",
            )  # fmt: skip

    @property
    def load(self) -> tuple[float, float]:
        return START_V, self.laser_unit.block.current_A

    # --- what the tagger sees ----------------------------------------------------------------------------------

    @property
    def edges_epoch_ns(self) -> int:
        """Bench time from which the times of edges count, nanoseconds."""
        return self.laser_unit.epoch_ns

    def edges_until(self, t_ns: int) -> Columns:
        """All edges before a bench time that were not yet handed out, in order of time.

        Returns: (n,) int64 picoseconds of the bench clock since ``edges_epoch_ns``; (n,) uint8 channel, 0 beat,
            1 dither pick-off; (n,) uint8 level of that channel behind the edge; (n,) uint8 level of the comparator of
            the cosine then.
        """
        return self.laser_unit.edges_until(t_ns)

    def skip_edges(self, t_ns: int) -> None:
        """Nobody looked at any edge before a bench time: they are not computed, the phase goes on with a draw."""
        self.laser_unit.skip_edges(t_ns)

    # --- the truth ---------------------------------------------------------------------------------------------

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return estimates(self.laser_unit.lives, windows)


WORLD = RlgWorld
