"""Wrong worlds of a ring laser: what the equation says is not so, in one respect and by a stated size.

A physics of its own (``laser_physics``), which shares no line with the product's simulators. A campaign is one record
of 2 s, so that a hundred of them are quick.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from coverage_blocks import in_right_world
from doubt_classes import PROVENANCE, Seen, Switch, changed
from laser_physics import KNOTS, Array, Cycles, World, blocks, crossings, half_cycles
from rlg_rig import as_row, material

from bench.analysis import build_results, estimates_of
from bench.systems.lock_in.analysis import analyse
from bench.systems.lock_in.compensation import GLOBAL, RAW
from bench.systems.lock_in.records import laser_records
from bench.systems.lock_in.result import LaserResult, laser_result

SYSTEM = "lock_in"
_OF_ITSELF = ("random_walk_ratio raw", "alignment_time_ratio raw")  # 1 by definition
QUANTITIES = ("lock_in_rate", "backscatter_phase", "angle_random_walk", "alignment_time", "random_walk_ratio",
              "alignment_time_ratio")  # fmt: skip
_PROMISED = 8  # rate, phase; walk and time before and behind the global fit; two ratios
_SUM = 10  # half cycles in a sum
_SENSOR = 0.01  # standard uncertainty of the dither's sensor
_EARTH_deg_h, _LATITUDE_deg, _ERROR_deg = 15.041067, 37.0, 360.0 / 6400.0


wrong = partial(changed, World)  # ``spoils``: the crossings are not where the phase is


def turned(of: Callable[[World, Array], Array]) -> type[World]:
    """The base turns by so many seconds of arc beside the earth."""
    return wrong(turned_rad=lambda w, time_s: np.radians(of(w, time_s) / 3600.0))


def beta(of: Callable[[World, Array, Array], Array]) -> type[World]:
    """The backscatter's phase is another one by so many degrees."""
    return wrong(beta_rad=lambda w, share, sense: World.beta_rad(w, share, sense) + np.radians(of(w, share, sense)))


def jittered(w: World, rng: np.random.Generator, rate_rad_s: Array) -> Array:
    """Phase noise of the beat's comparator, rad."""
    return w.size * rng.standard_normal(rate_rad_s.size) / np.maximum(rate_rad_s, 1e5)


def lost_pairs(w: World, words: list[Array], rng: np.random.Generator) -> list[Array]:
    """So many times two neighbouring edges are lost in a run of one direction: 2 pi that nobody counts."""
    for block in np.sort(rng.choice(len(words), round(w.size), replace=False)):
        events = words[block]
        beat = np.flatnonzero(events[1] == 0)
        at = int(rng.choice(np.flatnonzero(np.diff(events[0][beat]) < np.median(np.diff(events[0][beat]))))) or 1
        words[block] = np.delete(events, beat[at : at + 2], axis=1)
    return words


def stuck_bits(w: World, words: list[Array], rng: np.random.Generator) -> list[Array]:
    """The tagger counts in steps of so many ticks."""
    for events in words:
        events[0] = events[0] // round(w.size) * round(w.size)
    return words


def repeated(w: World, words: list[Array], rng: np.random.Generator) -> list[Array]:
    """So many blocks hold the events of the one before."""
    for block in np.sort(rng.choice(np.arange(1, len(words)), round(w.size), replace=False)):
        words[block] = words[block - 1]
    return words


BENT = wrong(
    spoils=True,
    bent=lambda w, time_s: w.size * (1.0 - np.cos(3.0 * w.omega * time_s)),
    curved=property(lambda w: 1.0 - 9.0 * w.size),
    rounds=(math.inf,) * 4,
)
SWITCHES = (
    Switch(
        "wrong_path",
        wrong(stated_path_m=property(lambda w: w.path_m * (1.0 + w.size))),
        (1e-4, 1e-2, 0.3),
        "path_length",
    ),
    Switch("wrong_clock", wrong(clock_share=property(lambda w: 1.0 + w.size)), (1e-5, 1e-2, 0.3), "tagger_clock"),
    Switch("second_harmonic", wrong(second_harmonic=property(lambda w: w.size)), (1e-2, 0.1, 0.5)),
    Switch("phase_steps", beta(lambda w, share, _: w.size * (share > 0.6)), (0.3, 5.0, 60.0)),
    # it differs between maxima and minima of the angle, as where the body bends
    Switch("phase_of_sides", beta(lambda w, _, sense: w.size * (sense > 0)), (0.3, 5.0, 60.0)),
    Switch("lock_in_fades", wrong(kappa_share=lambda w, share: 1.0 - w.size * share), (0.01, 0.1, 0.7)),
    Switch("rate_ramp", turned(lambda w, time_s: w.size * time_s**2 / 2.0), (0.05, 2.0, 100.0)),  # deg/h in a second
    Switch(
        "rate_step", turned(lambda w, time_s: w.size * np.maximum(time_s - 0.6 * w.seconds, 0.0)), (0.05, 2.0, 100.0)
    ),
    Switch("vibration", turned(lambda w, time_s: w.size * np.sin(2.0 * np.pi * 7.3 * time_s)), (1e-3, 0.03, 1.0)),
    # a comparator switches beside zero: rising edges late, falling ones early
    Switch(
        "comparator_offset",
        wrong(spoils=True, level_off_rad=lambda w, n: np.where(n % 2 == 0, w.size, -w.size)),
        (1e-3, 0.03, 0.5),
    ),
    # the dither's amplitude scatters so many times less
    Switch(
        "regular_dither", wrong(scatter=lambda w, rng, count: World.scatter(w, rng, count) / w.size), (2.0, 20.0, 500.0)
    ),
    Switch("bent_dither", BENT, (1e-6, 1e-4, 1e-2)),
    Switch("jitter", wrong(spoils=True, jitter_s=jittered), (1e-3, 0.03, 0.3)),
    Switch("lost_pairs", wrong(told=lost_pairs), (1.0, 5.0, 50.0)),
    Switch("stuck_bits", wrong(spoils=True, told=stuck_bits), (2.0, 8.0, 64.0)),
    Switch("repeated_blocks", wrong(told=repeated), (1.0, 5.0, 50.0)),
)


@dataclass(frozen=True)
class Simulated:
    """A campaign and its truth by quantity and method."""

    material: Any
    truths: dict[tuple[str, str], float]


def simulated(seed: int, world: World, *, quiet: bool = False) -> Simulated:
    """One record; ``quiet``: neither quantum noise nor that of the pick-off, and ticks of 0.25 ns."""
    rng = np.random.default_rng(seed)
    cycles = half_cycles(world, rng, quiet=quiet)
    clock_Hz = 4_000_000_000 if quiet else world.clock_Hz
    events = blocks(world, crossings(world, cycles), cycles.turn_rad.size, rng, clock_Hz, quiet=quiet)
    row = as_row(
        _columns(events, clock_Hz), 7 + np.arange(len(events)), 1,
        {"clock_Hz": clock_Hz, "item": "lock_in", "path_length_m": world.stated_path_m},
        dither_deg_s=100.0 * (1.0 + (0.0 if quiet else _SENSOR * rng.standard_normal())),
    )  # fmt: skip
    found = Simulated(material(row), {})
    return Simulated(found.material, truths(world, cycles, _own_walk(found, cycles, world) if world.spoils else 0.0))


def _own_walk(campaign: Simulated, cycles: Cycles, world: World) -> float:
    """Mean square of the walk that the global fit adds where it takes off jumps that were not there, rad^2/s."""
    outside = np.diff(cycles.outside_rad[::KNOTS])
    taken = np.nan_to_num(np.concatenate([fit.jumps.dpsi_rad for fit in _result(campaign).found.constants]))
    left = (np.diff(cycles.start_rad) - outside)[: taken.size] - taken
    sums = left[: left.size // _SUM * _SUM].reshape(-1, _SUM).sum(axis=1)
    return float(np.var(sums)) / (_SUM * world.half_s)


def _columns(events: list[Array], clock_Hz: int) -> dict[str, Any]:
    blobs = np.empty(len(events), object)
    for k, (tick, channel, level, cosine) in enumerate(events):
        blobs[k] = (level | cosine << 1 | channel << 2 | tick << 3).astype("<u4").tobytes()
    return {
        "tick": ((123 + np.arange(len(events))) * (clock_Hz // 100)).astype(np.uint64),
        "clock": np.full(len(events), clock_Hz, np.uint32),
        "dropped": np.zeros(len(events), np.uint32),
        "edges": np.array([block.shape[1] for block in events], np.uint16),
        "events": blobs,
    }


def truths(world: World, cycles: Cycles, own: float) -> dict[tuple[str, str], float]:
    """What the estimates are of: constants are means over the record, random walks those of jumps and quantum noise.

    Equation (6) of the paper is the root of the first part. Behind the global fit what one harmonic of one size and
    phase leaves adds to the quantum noise, and what the fit makes of spoilt crossings (``own``, rad^2/s).
    """
    half_s, e2 = world.half_s, world.second_harmonic
    wide = np.pi / (
        cycles.swing_rad * world.omega**2 * world.curved * half_s
    )  # square of the jumps of a second by kappa^2
    first, second = np.mean(cycles.kappa**2 * wide), np.mean((e2 * cycles.kappa) ** 2 * wide / 2.0)
    unit = math.degrees(60.0) / world.gain
    raw = math.hypot(unit * math.sqrt(first + second), world.quantum_deg_rth)
    pull = cycles.kappa * np.exp(1j * cycles.beta_rad)
    left = own if world.spoils else np.mean(np.abs(pull - np.mean(pull)) ** 2 * wide) + second
    behind = math.hypot(unit * math.sqrt(left), world.quantum_deg_rth)
    level = _EARTH_deg_h * math.cos(math.radians(_LATITUDE_deg)) * math.radians(_ERROR_deg)
    shares = (np.arange(cycles.turn_rad.size) + 0.5) / cycles.turn_rad.size
    found = {("lock_in_rate", ""): world.lock_in_deg_s * float(np.mean(world.kappa_share(shares)))}
    found["backscatter_phase", ""] = math.degrees(float(np.mean(cycles.beta_rad)))
    for method, walk in ((RAW, raw), (GLOBAL, behind)):
        found["angle_random_walk", method] = walk
        found["alignment_time", method] = 3600.0 * (walk / level) ** 2
        found["random_walk_ratio", method] = walk / raw
        found["alignment_time_ratio", method] = (walk / raw) ** 2
    return found


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one record states and its truth; without a switch that of the same seed in a right world.

    ``chi2`` is taken without noise only: nothing else needs it.
    """
    world = World() if switch is None else switch.world(size)
    campaign = simulated(seed, world, quiet=noise_free)
    analysis = analyse(campaign.material)
    document = build_results("doubt", analysis, {"records": 1}, PROVENANCE)
    pairs = [(entry, campaign.truths.get(_key(entry))) for entry in estimates_of(document)]
    pairs = [(entry, truth) for entry, truth in pairs if truth is not None and entry.quantity in QUANTITIES]
    chi2 = _trace(campaign) if noise_free else 0.0
    of_one = [{"conditions": {"method": _key(entry)[1]}} for entry, _ in pairs]  # one record: no other place
    entries = [entry.model_copy(update=place) for (entry, _), place in zip(pairs, of_one, strict=True)]
    return Seen(entries, [float(truth) for _, truth in pairs], chi2, _PROMISED)


def _key(entry: Any) -> tuple[str, str]:
    return entry.quantity, entry.conditions.get("method", "")


def _result(campaign: Simulated) -> LaserResult:
    (record,) = laser_records(campaign.material)
    return laser_result(record)


def _trace(campaign: Simulated) -> float:
    """Steps that the crossings show behind the global fit, the increments behind it, and the dither's sensor, each by
    the scatter of a right world.
    """
    steps, increments = _left(_result(campaign))
    step_std, increment_std = _typical()
    dither = _result(campaign).counted_dither_deg_s / 100.0 - 1.0
    chi2 = np.sum((steps / step_std) ** 2) + np.sum((increments / increment_std) ** 2) + (dither / _SENSOR) ** 2
    return float(chi2)


def _left(result: LaserResult) -> tuple[Array, Array]:
    steps = np.concatenate([fit.residual_jump_rad for fit in result.found.constants])
    increments = result.found.increments[GLOBAL]
    steps, increments = steps[np.isfinite(steps)], increments[np.isfinite(increments)]
    return steps, increments - np.mean(increments)


@cache
def _typical() -> tuple[float, float]:
    steps, increments = _left(_result(simulated(0, World())))
    return float(np.std(steps)), float(np.std(increments))


def inside(seed: int) -> dict[str, bool | None]:
    """Return of each quantity and method whether its interval holds the truth; of ratios to itself, 1, nothing."""
    right = seen(seed, None, 0.0)
    found = in_right_world(right.entries, right.truths)
    return {name: held for name, held in found.items() if name not in _OF_ITSELF}
