"""True values of ring lasers: what a perfect analysis of the records would find. Nothing of the product reads it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.world import entry
from sim_instruments.worlds.lock_in.core import RingLaser
from sim_instruments.worlds.lock_in.unit import Life

Entry = dict[str, Any]

ARW_UNIT = "deg/h^0.5"
KEPT = ("path_length_m", "clock_Hz", "phase_setting_deg")  # conditions an entry carries
_POINTS = 11  # of a window


def estimates(lives: Sequence[Life], windows: Sequence[RecordWindow]) -> list[Entry]:
    """Return True values in the contract's form, by the conditions of the records.

    ``angle_random_walk`` is what theory says of the laser that was on: W_L / sqrt(K W_D) of lock-in and dither and the
    quantum noise, root of the sum of squares; ``quantum_random_walk`` is the floor under every compensation.
    """
    found: dict[str, Entry] = {}
    seen: dict[tuple[Any, ...], dict[float, RingLaser]] = {}
    for window in windows:
        life = _life(lives, window)
        if window.conditions.get("item", "lock_in") != "lock_in" or life is None:
            continue
        place = {name: window.conditions[name] for name in KEPT if name in window.conditions}
        for one in _of_window(life, window, place):
            found.setdefault(f"{one['quantity']} {sorted(one['conditions'].items())}", one)
        rest = tuple((name, value) for name, value in place.items() if name != "path_length_m")
        seen.setdefault(rest, {})[life.block.laser.path_m] = life.block.laser
    exponents = [_exponent(lasers, dict(rest)) for rest, lasers in seen.items() if len(lasers) > 1]
    return [*found.values(), *exponents]


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
