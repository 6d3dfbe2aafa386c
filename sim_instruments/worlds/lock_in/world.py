"""The world of the ring-laser bench: laser blocks by path length, their supply, mirror transducers; its truth.

The ring laser on the bench: mounted block, supply, mirror transducers; edges and housekeeping by bench time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bench.frame import load_frame
from bench.model.arrays import Floats, Integers
from bench.model.clock import NS, Clock, to_ns
from bench.model.lab import find_shipped
from bench.model.ports import RecordWindow
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.port import OnePortUnit, Port
from sim_instruments.worlds.common.thermal import LAB_DEGC, Thermal
from sim_instruments.worlds.common.world import Operation, World, entry
from sim_instruments.worlds.lock_in.core import (
    DITHER_DEG_S,
    DITHER_HZ,
    LOCK_IN_DEG_S,
    LOCK_IN_PATH_M,
    S_PER_H,
    RingLaser,
    quantum_deg_rt_h,
)
from sim_instruments.worlds.lock_in.options import USUAL
from sim_instruments.worlds.lock_in.stream import PS, Columns, EdgeStream, joined

PPM = 1e-6
MM = 1000.0
BEAT_VOLT = 1.2
SELF_HEATING_DEGC, SELF_HEATING_S = 8.0, 900.0
_VOLT_PER_DEGC = -2e-4  # relative, of the intensity
PERIOD_NS = NS // 10
BOOT_NS = NS // 2  # from power to the first frame
NO_BEAT = 1  # status bit
AT_ONCE = 64
_NOISE_DEGC, _NOISE_V, _NOISE_DEG_S = 0.01, 2e-4, 0.05
_STEP_DEGC, _STEP_V, _STEP_DEG_S = 0.01, 1e-4, 0.01  # of the frame's fields
_MOST = (1 << 16) - 1


@dataclass(frozen=True)
class LaserBlock:
    """One laser block; blocks of one path are one and the same.

    ``laser``: without its backscatter phase, which mirror transducers set.   ``phase_offset_deg``: what is added to the
    setting.   ``drift_deg_h``: of that phase while the laser is on.   ``dither_gain``: of the amplitude's sensor.
    ``warmth_degC``: of its thermometer against others.   ``beat_V``: amplitude of the beat at the laboratory's
    temperature.   ``current_A``: from its supply.
    """

    number: int
    laser: RingLaser
    phase_offset_deg: float
    drift_deg_h: float
    dither_gain: float
    warmth_degC: float
    beat_V: float
    current_A: float

    @classmethod
    def drawn(cls, seed: int, path_m: float, options: Mapping[str, Any]) -> LaserBlock:
        """Return the block of a path length, with completed options of the world."""
        number = round(path_m * MM)
        draws = generator(seed, "ring laser block", number).standard_normal(7)
        second_rad = generator(seed, "ring laser second harmonic", number).uniform(-math.pi, math.pi)
        laser = RingLaser(
            path_m=path_m,
            lock_in_deg_s=LOCK_IN_DEG_S * (LOCK_IN_PATH_M / path_m) ** 2 * (1.0 + 0.01 * draws[0]),
            rate_deg_h=float(options["rate_deg_h"]),
            dither_deg_s=DITHER_DEG_S * (1.0 + 0.005 * draws[1]),
            dither_Hz=DITHER_HZ + 0.3 * draws[2],
            dither_noise=float(options["dither_noise_ppm"]) * PPM,
            quantum_deg_rt_h=quantum_deg_rt_h(path_m) if options["quantum_noise"] else 0.0,
            beat_noise=float(options["beat_noise_ppm"]) * PPM,
            second_harmonic=float(options["second_harmonic_ppm"]) * PPM,
            second_phase_rad=second_rad,
        )
        return cls(
            number=number,
            laser=laser,
            phase_offset_deg=2.0 * draws[3],
            drift_deg_h=float(options["backscatter_drift_deg_h"]),
            dither_gain=1.0 + 0.01 * draws[4],
            warmth_degC=0.3 * draws[5],
            beat_V=BEAT_VOLT * (1.0 + 0.03 * draws[6]),
            current_A=0.55 + 0.5 * path_m,
        )

    def beta_deg(self, setting_deg: Any, on_s: Any) -> Any:
        """Return phase of the backscatter for a setting of the transducers, so long after switching on, degree."""
        return setting_deg + self.phase_offset_deg + self.drift_deg_h * on_s / S_PER_H

    def degC(self, on_s: Floats) -> Floats:
        """Return what its thermometer shows so long after switching on, without noise: it always starts cold."""
        warmed = SELF_HEATING_DEGC * -np.expm1(-on_s / SELF_HEATING_S)
        return LAB_DEGC + self.warmth_degC + warmed

    def intensity_V(self, degC: Floats) -> Floats:
        """Return amplitude of the beat while the laser runs, without noise."""
        return self.beat_V * (1.0 + _VOLT_PER_DEGC * (degC - LAB_DEGC))


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

    def _append(self, number: Integers) -> None:
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
