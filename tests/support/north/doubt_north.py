"""Wrong worlds of a north finder: what the model says is not so, in one respect and by a stated size.

A physics of its own, which shares no line with the product's simulators: one sine per turn, white noise, two lock-ins
as means over each record. Every switch changes one step of it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from doubt_classes import PROVENANCE, Seen, Switch, changed
from fog_material import record_row

from bench.analysis import Material, Reading, build_results, estimates_of
from bench.model.errors import FitError
from bench.record import RecordRow
from bench.systems.north.analysis import analyse
from bench.systems.north.sets import north_sets
from bench.systems.north.solve import site_of, solve

SYSTEM = "north"
LATITUDE_DEG, MARK_DEG, FIELD_DEG, MARK_STD_DEG = 37.0, 20.0, 213.4, 0.02
HEADS_DEG = tuple(45.0 * k for k in range(8))
CALIBRATIONS, REPEATS, SEARCHES = 4, 2, 3
FS_Hz, RECORD_s, RATE_DEG_S, NOISE_V, OFFSET_V = 250.0, 3.0, 360.0, 0.15, 0.3
PLACEMENT_DEG, GAINS = (0.4, -0.7), (1.02, 0.97)  # of index A and B, of lock-in 1 and 2
SETS = CALIBRATIONS + REPEATS * len(HEADS_DEG) + SEARCHES
OF_NOISE = ("noise", "azimuth_bound")
JUDGED = ("azimuth", "azimuth_error", "index_placement", "scale", *OF_NOISE)


@dataclass(frozen=True)
class Place:
    """Where in the campaign one record is: ``number`` of the set, ``share`` of the campaign that is over."""

    item: str
    head_deg: float
    repeat: int
    index: int
    number: int

    @property
    def share(self) -> float:
        return self.number / (SETS - 1)


class World:
    """A right world; a wrong one changes one of its methods."""

    def __init__(self, size: float = 0.0) -> None:
        self.size = size

    def heading_deg(self, at: Place) -> float:
        """True heading of the sensing axis at encoder zero."""
        return FIELD_DEG if at.item == "search" else MARK_DEG + at.head_deg

    def signal_V(self, heading_deg: float, theta_deg: Any, at: Place) -> Any:
        return np.cos(np.deg2rad(heading_deg - theta_deg)) + OFFSET_V

    def noise_V(self, at: Place) -> float:
        return NOISE_V

    def output_V(self, u_V: Any, at: Place) -> Any:
        """What is sampled of the gyroscope's output."""
        return u_V

    def shown_deg(self, theta_deg: Any, at: Place) -> Any:
        """Angle that the encoder shows."""
        return theta_deg

    def pulse_deg(self, letter: str, at: Place) -> float:
        """Angle of an index pulse."""
        return PLACEMENT_DEG[0] if letter == "a" else 270.0 + PLACEMENT_DEG[1]

    def read_V(self, x_V: float, number: int, at: Place) -> float:
        """What a lock-in hands over."""
        return x_V

    def told(self, name: str, value: float) -> float:
        """What the sequence states of the site or of the rate."""
        return value


wrong = partial(changed, World)


def turned(by: Callable[[World, Place], float]) -> type[World]:
    """The true heading is another one by so many degrees."""
    return wrong(heading_deg=lambda w, at: World.heading_deg(w, at) + by(w, at))


def beside(of_deg: Callable[[float, Any], Any], item: str = "") -> type[World]:
    """To the signal a part is added that is a sine of this angle, of heading and table; ``item``: there alone."""

    def signal_V(w: World, heading_deg: float, theta_deg: Any, at: Place) -> Any:
        part = np.cos(np.deg2rad(of_deg(heading_deg, theta_deg))) if at.item.startswith(item) else 0.0
        return World.signal_V(w, heading_deg, theta_deg, at) + w.size * part

    return wrong(signal_V=signal_V)


def modulated_V(w: World, heading_deg: float, theta_deg: Any, at: Place) -> Any:
    """The gain goes with twice the angle of the table."""
    gain = 1.0 + w.size * np.cos(np.deg2rad(2.0 * theta_deg + 25.0))
    return gain * World.signal_V(w, heading_deg, theta_deg, at)


def frozen_V(w: World, u_V: Any, at: Place) -> Any:
    """A part of every record's samples stands still, the lock-ins work on."""
    cut = len(u_V) - round(w.size * len(u_V))
    return np.concatenate((u_V[:cut], np.full(len(u_V) - cut, u_V[cut - 1])))


def spiked_V(w: World, u_V: Any, at: Place) -> Any:
    """One sample of one record is far off."""
    return u_V + w.size * ((at.item, at.repeat, at.index) == ("search", 2, 3)) * (np.arange(len(u_V)) == 100)


def badly_read_V(w: World, x_V: float, number: int, at: Place) -> float:
    """One reading of one lock-in is off by a part of its amplitude."""
    return x_V + w.size * ((at.item, at.head_deg, at.repeat, at.index, number) == ("test", 90.0, 1, 2, 1))


# A magnet or a motor on the bench turns with the dividing head and not with the Earth.
ONCE_PER_TURN = beside(lambda heading_deg, theta_deg: 70.0 - theta_deg)
ONE_BAD_READING, FROZEN, SPIKE = wrong(read_V=badly_read_V), wrong(output_V=frozen_V), wrong(output_V=spiked_V)
CLIPPED = wrong(output_V=lambda w, u_V, at: np.minimum(u_V, 2.0 - w.size))
SWITCHES = (
    Switch("once_per_turn", ONCE_PER_TURN, (1e-4, 1e-2, 1e-1), "magnetic_effect"),
    # a magnetic effect at the place to be found, across north: nothing but north changes by it
    Switch("field_magnet", beside(lambda h, t: h + 90.0 - t, "search"), (1e-3, 1e-2, 1e-1), "magnetic_effect"),
    # the same along north: the amplitude changes as well
    Switch("field_motor", beside(lambda h, t: h + 45.0 - t, "search"), (1e-3, 1e-2, 1e-1), "magnetic_effect"),
    Switch("modulated", wrong(signal_V=modulated_V), (1e-4, 1e-2, 1e-1), "magnetic_effect"),
    Switch("mark_wrong", turned(lambda w, at: w.size * (at.item != "search")), (1e-3, 0.5, 5.0), "azimuth_of_mark"),
    Switch("head_scale", turned(lambda w, at: w.size * at.head_deg), (1e-5, 3e-3, 3e-2), "dividing_head"),
    # the bench turns slowly on its feet, at the mark; somebody runs against it in the middle of the tests
    Switch(
        "bench_turns",
        turned(lambda w, at: w.size * at.share * (at.item != "search")),
        (0.01, 1.0, 10.0),
        "dividing_head",
    ),
    Switch(
        "bench_knocked",
        turned(lambda w, at: w.size * (at.item == "test" and at.share > 0.5)),
        (0.01, 1.0, 10.0),
        "dividing_head",
    ),
    # north is another one in every set, by more than the noise
    Switch(
        "restless",
        turned(lambda w, at: w.size * float(np.random.default_rng(at.number).standard_normal())),
        (0.01, 0.5, 5.0),
        "dividing_head",
    ),
    # the lock-ins' reference comes later after the bench was carried
    Switch(
        "delay_after_move",
        wrong(pulse_deg=lambda w, letter, at: World.pulse_deg(w, letter, at) + w.size * (at.item == "search")),
        (0.01, 1.0, 10.0),
        "delay_of_lock_ins",
    ),
    Switch("one_bad_reading", ONE_BAD_READING, (1e-3, 0.1, 1.0)),
    Switch("clipped", CLIPPED, (0.1, 0.9, 1.5)),
    Switch("frozen", FROZEN, (0.01, 0.1, 0.5)),
    Switch("spike", SPIKE, (1.0, 100.0, 1000.0)),
    Switch(
        "noisy_field", wrong(noise_V=lambda w, at: NOISE_V * (1.0 + w.size * (at.item == "search"))), (0.1, 1.0, 10.0)
    ),
    Switch(
        "encoder_slips",
        wrong(shown_deg=lambda w, theta_deg, at: theta_deg + w.size),
        (1e-3, 1.0, 10.0),
        "zero_of_table",
    ),
    # the sequence states another rate of the table, another latitude; the bench is level, so that nothing depends on it
    Switch(
        "rate_stated",
        wrong(told=lambda w, name, value: value * (1.0 - w.size * (name == "rate_deg_s"))),
        (1e-3, 0.5, 2.0),
    ),
    Switch(
        "latitude_stated",
        wrong(told=lambda w, name, value: value + w.size * (name == "latitude_deg")),
        (0.1, 5.0, 30.0),
        "latitude",
    ),
)


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one campaign states and its truth; without a switch that of the same seed in a right world."""
    world = World() if switch is None else switch.world(size)
    material = _material(seed, world, 0.0 if noise_free else 1.0)
    try:
        analysis = analyse(material)
    except FitError:  # refused as a whole
        return Seen([], [], 0.0, _promised())
    document = build_results("doubt", analysis, {"records": len(material.rows)}, PROVENANCE)
    wanted = [entry for entry in estimates_of(document) if entry.quantity in JUDGED and _by_a_sound_formula(entry)]
    return Seen(wanted, [_truth(entry, world) for entry in wanted], _left(material), _promised())


def _by_a_sound_formula(entry: Any) -> bool:
    return bool(entry.conditions.get("method") not in ("literal", "quadrant"))


@cache
def _promised() -> int:
    """How many estimates a campaign promises: those of a right one."""
    analysis = analyse(_material(0, World(), 1.0))
    return sum(entry.quantity in JUDGED and _by_a_sound_formula(entry) for entry in analysis.estimates)


def places() -> list[Place]:
    """Every record in its order."""
    sets = [("calibration", 0.0, k + 1) for k in range(CALIBRATIONS)]
    sets += [("test", head, k + 1) for head in HEADS_DEG for k in range(REPEATS)]
    sets += [("search", 0.0, k + 1) for k in range(SEARCHES)]
    return [Place(*one, index, number) for number, one in enumerate(sets) for index in (1, 2, 3, 4)]


def _material(seed: int, world: World, noise: float) -> Material:
    rng = np.random.default_rng([seed, 1810])
    rows: list[RecordRow] = []
    readings: list[Reading] = []
    t_s, n = 100.0, round(FS_Hz * RECORD_s)
    for at in places():
        conditions: dict[str, Any] = {
            "item": at.item, "head_deg": at.head_deg, "repeat": at.repeat, "index": at.index,
            "place": "field" if at.item == "search" else "mark", "rate_deg_s": world.told("rate_deg_s", RATE_DEG_S),
        }  # fmt: skip
        if at.index == 1 and at.repeat == 1:
            readings.append(_reading(t_s, readings, "level", {"x_mrad": 0.0, "y_mrad": 0.0}, conditions))
        theta_deg = RATE_DEG_S * (np.arange(n) + 0.5) / FS_Hz + 90.0 * rng.integers(4)
        u_V = world.signal_V(world.heading_deg(at), theta_deg, at)
        u_V = u_V + noise * world.noise_V(at) * rng.standard_normal(n)
        rows.append(record_row(t_s, rows, world.output_V(u_V, at), world.shown_deg(theta_deg, at), conditions, FS_Hz))
        t_s += RECORD_s + 0.01
        for number, letter in ((1, "b"), (2, "a")):
            reference = np.deg2rad(theta_deg - world.pulse_deg(letter, at) - 90.0 * (at.index - 1))
            x_V = GAINS[number - 1] * np.sqrt(2.0) * float(np.mean(u_V * np.sin(reference)))
            value = {"x_V": world.read_V(x_V, number, at), "y_V": 0.0, "frequency_Hz": RATE_DEG_S / 360.0,
                     "overload": False, "unlocked": False}  # fmt: skip
            readings.append(_reading(t_s, readings, f"lock_in_{number}", value, conditions))
        t_s += 20.0
    site = {"latitude_deg": world.told("latitude_deg", LATITUDE_DEG), "azimuth_deg": MARK_DEG,
            "azimuth_std_deg": MARK_STD_DEG, "gravity_m_s2": 9.799}  # fmt: skip
    campaign = {"analysis": "fog_north", "uut": {"model": "FOG", "serial": "FOG-1"}, "site": site}
    return Material(rows=rows, campaign=campaign, standards={}, readings=readings)


def _reading(t_s: float, before: list[Reading], role: str, value: Any, conditions: dict[str, Any]) -> Reading:
    return Reading(t_s, len(before) + 1, role, "measure", value, dict(conditions))


def _truth(entry: Any, world: World) -> float:
    """True value of an estimate; an error is that of the indication without noise against the true heading."""
    quantity, about = entry.quantity, entry.conditions
    if quantity in ("azimuth", "azimuth_error"):
        own = [at for at in places() if (at.item, at.head_deg) == (about["item"], about["head_deg"]) and at.index == 1]
        true_deg = float(np.mean([world.heading_deg(at) for at in own]))
        if quantity == "azimuth":
            return _near(true_deg, entry.value)
        indicated_deg = _bare(type(world), world.size)[about["item"], about["head_deg"], about["method"]]
        return _near(indicated_deg - true_deg, 0.0)
    if quantity == "index_placement":
        return PLACEMENT_DEG[0 if about["index"] == "a" else 1]
    if quantity == "scale":
        return {"lock_in_1": GAINS[0], "lock_in_2": GAINS[1], "waveform": 1.0}[about["source"]]
    noise_V = float(np.sqrt(np.mean([world.noise_V(at) ** 2 for at in places()])))
    return noise_V if quantity == "noise" else float(np.rad2deg(noise_V * np.sqrt(2.0 / (4.0 * FS_Hz * RECORD_s))))


def _near(angle_deg: float, value_deg: float | None) -> float:
    """Return an angle in the turn of the value."""
    about_deg = value_deg or 0.0
    return about_deg + (angle_deg - about_deg + 180.0) % 360.0 - 180.0


@cache
def _bare(world: type[World], size: float) -> dict[tuple[str, float, str], float]:
    """What each method indicates without noise, by item, head and method."""
    analysis = analyse(_material(0, world(size), 0.0))
    return {
        (entry.conditions["item"], entry.conditions["head_deg"], entry.conditions["method"]): entry.value
        for entry in analysis.estimates
        if entry.quantity == "azimuth"
    }


def _left(material: Material) -> float:
    """Chi-square of residuals, repeats and known azimuths by the noise of the right world."""
    solution = solve(north_sets(material), site_of(material.campaign))
    one_deg = float(np.rad2deg(NOISE_V * np.sqrt(2.0 / (4.0 * FS_Hz * RECORD_s))))
    apart = solution.by_method["least_squares"].azimuth_deg - solution.by_method["likelihood"].azimuth_deg
    apart = apart[np.isfinite(apart)]
    by_waveform = solution.error_deg("likelihood")
    by_waveform = by_waveform[np.isfinite(by_waveform)]
    raw = [one for one in solution.raw if one is not None]
    size = np.array([float(one.amplitude) for one in raw])
    groups = [one.group for one, found in zip(solution.sets, solution.raw, strict=True) if found is not None]
    repeats = solution.by_method["likelihood"].azimuth_deg[[found is not None for found in solution.raw]]
    within = [repeats[[each == group for each in groups]] for group in dict.fromkeys(groups) if group[0] == "search"]
    parts = [
        ((apart + 180.0) % 360.0 - 180.0) / one_deg,
        (by_waveform - by_waveform.mean()) / one_deg if by_waveform.size else np.zeros(0),
        [by_waveform.mean() / np.hypot(one_deg / np.sqrt(by_waveform.size), MARK_STD_DEG)] if by_waveform.size else [],
        *(((own - own[0] + 180.0) % 360.0 - 180.0) / one_deg for own in within),
        np.rad2deg((size - size.mean()) / size.mean()) / one_deg if size.size else np.zeros(0),
    ]  # fmt: skip
    whitened = np.concatenate([np.asarray(part, float) for part in parts])
    of_samples = sum((float(one.noise_V) / NOISE_V) ** 2 * int(one.samples) for one in raw)
    return float(np.sum(whitened**2) + of_samples)
