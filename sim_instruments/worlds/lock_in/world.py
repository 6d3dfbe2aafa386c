"""The world of the ring-laser bench: laser blocks by path length, their supply, mirror transducers; its truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bench.model.clock import Clock
from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import Operation, World, entry
from sim_instruments.worlds.lock_in.block import LaserBlock
from sim_instruments.worlds.lock_in.core import RingLaser
from sim_instruments.worlds.lock_in.options import USUAL
from sim_instruments.worlds.lock_in.stream import Columns
from sim_instruments.worlds.lock_in.unit import PORT, START_V, Life, RlgUnit

Entry = dict[str, Any]
ARW_UNIT = "deg/h^0.5"
KEPT = ("path_length_m", "clock_Hz", "phase_setting_deg")  # conditions an entry carries
_POINTS = 11  # of a window
FIRST_PATH_M, FIRST_PHASE_DEG = 0.28, 90.0
LEAST_PATH_M, MOST_PATH_M, MOST_PHASE_DEG = 0.05, 1.0, 360.0


def estimates(lives: Sequence[Life], windows: Sequence[RecordWindow]) -> list[Entry]:
    """Return true values in the contract's form, by the conditions of the records.

    ``angle_random_walk`` is what theory says of the laser that was on: W_L / sqrt(K W_D) of lock-in and dither and the
    quantum noise, root of the sum of squares; ``quantum_random_walk`` is the floor under every compensation.
    """
    entries: dict[str, Entry] = {}
    seen: dict[tuple[Any, ...], dict[float, RingLaser]] = {}
    for window in windows:
        life = _life(lives, window)
        if window.conditions.get("item", "lock_in") != "lock_in" or life is None:
            continue
        place = {name: window.conditions[name] for name in KEPT if name in window.conditions}
        for true in _of_window(life, window, place):
            entries.setdefault(f"{true['quantity']} {sorted(true['conditions'].items())}", true)
        rest = tuple((name, value) for name, value in place.items() if name != "path_length_m")
        seen.setdefault(rest, {})[life.block.laser.path_m] = life.block.laser
    exponents = [_exponent(lasers, dict(rest)) for rest, lasers in seen.items() if len(lasers) > 1]
    return [*entries.values(), *exponents]


def walk_deg_rt_h(laser: RingLaser) -> float:
    """Return angle random walk of the laser without any compensation, theory, deg/rt-h."""
    return math.hypot(laser.lock_in_walk_deg_rt_h, laser.quantum_deg_rt_h)


def _life(lives: Sequence[Life], window: RecordWindow) -> Life | None:
    for life in reversed(lives):
        if life.on_ns <= window.t_start_ns and (life.off_ns is None or window.t_end_ns <= life.off_ns):
            return life
    return None


def _of_window(life: Life, window: RecordWindow, place: Mapping[str, Any]) -> list[Entry]:
    laser = life.block.laser
    times_ns = np.linspace(window.t_start_ns, window.t_end_ns, _POINTS).astype(np.int64)
    turned = np.exp(1j * np.radians(life.beta_deg(times_ns))).mean()
    raw = {**place, "method": "raw"}
    return [
        entry("lock_in_rate", "deg/s", math.degrees(laser.lock_in_rad_s), place),
        entry("backscatter_phase", "deg", math.degrees(float(np.angle(turned))), place),
        entry("angle_random_walk", ARW_UNIT, walk_deg_rt_h(laser), raw),
        entry("quantum_random_walk", ARW_UNIT, laser.quantum_deg_rt_h, place),
    ]


def _exponent(lasers: Mapping[float, RingLaser], place: Mapping[str, Any]) -> Entry:
    paths = sorted(lasers)
    slope = np.polyfit(np.log(paths), np.log([walk_deg_rt_h(lasers[path]) for path in paths]), 1)[0]
    return entry("path_length_exponent", "1", slope, {**place, "method": "raw"})


class RlgWorld(World):
    """One simulated ring-laser bench.

    Args: clock, seed: as of every world.   options: checked ones of rlg_options, any of them may be missing.
    """

    ports = (PORT,)

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        self._completed = {**USUAL, **options}
        self.laser_unit = RlgUnit(clock, seed, LaserBlock.drawn(seed, FIRST_PATH_M, self._completed), FIRST_PHASE_DEG)
        super().__init__(clock=clock, seed=seed, unit=self.laser_unit, thermal=Thermal(), options=options)

    def _mount(self, path_m: float) -> None:
        self.laser_unit.mount(LaserBlock.drawn(self.seed, path_m, self._completed))

    operations: ClassVar[Mapping[str, Operation]] = {
        "path_length": Operation.number(_mount, LEAST_PATH_M, MOST_PATH_M, "m"),
        "backscatter_phase": Operation.number(
            lambda world, phase_deg: world.laser_unit.set_phase(phase_deg), -MOST_PHASE_DEG, MOST_PHASE_DEG, "deg"),
    }  # fmt: skip

    @property
    def load(self) -> tuple[float, float]:
        return START_V, self.laser_unit.block.current_A

    # --- what the tagger sees ----------------------------------------------------------------------------------

    @property
    def edges_epoch_ns(self) -> int:
        """Bench time from which the times of edges count, nanoseconds."""
        return self.laser_unit.epoch_ns

    def edges_until(self, t_ns: int) -> Columns:
        """Return all edges before a bench time that were not yet handed out, in order of time.

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
