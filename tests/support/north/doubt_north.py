"""Wrong worlds of a north finder: what the model says is not so, in one respect and by a stated size.

A physics of its own, which shares no line with the product's simulators: one sine per turn, white noise, two lock-ins
as means over each record. Every switch changes one step of it.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from doubt_classes import Seen, Switch
from fog_material import record_row

from bench.analysis import Material, Reading, build_results, estimates_of
from bench.model.errors import FitError
from bench.record import RecordRow
from bench.systems.north.analysis import analyse
from bench.systems.north.sets import north_sets
from bench.systems.north.solve import site_of, solve

SYSTEM = "north"
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "doubt"}
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


class OncePerTurn(World):
    """A magnet or a motor on the bench: it turns with the dividing head and not with the Earth."""

    def signal_V(self, heading_deg: float, theta_deg: Any, at: Place) -> Any:
        return super().signal_V(heading_deg, theta_deg, at) + self.size * np.cos(np.deg2rad(70.0 - theta_deg))


class FieldMagnet(World):
    """A magnetic effect at the place to be found, across north: nothing but north changes by it."""

    def signal_V(self, heading_deg: float, theta_deg: Any, at: Place) -> Any:
        turned = np.cos(np.deg2rad(heading_deg + 90.0 - theta_deg)) if at.item == "search" else 0.0
        return super().signal_V(heading_deg, theta_deg, at) + self.size * turned


class FieldMotor(World):
    """The same along north: the amplitude changes as well."""

    def signal_V(self, heading_deg: float, theta_deg: Any, at: Place) -> Any:
        turned = np.cos(np.deg2rad(heading_deg + 45.0 - theta_deg)) if at.item == "search" else 0.0
        return super().signal_V(heading_deg, theta_deg, at) + self.size * turned


class Modulated(World):
    """The gain goes with twice the angle of the table."""

    def signal_V(self, heading_deg: float, theta_deg: Any, at: Place) -> Any:
        gain = 1.0 + self.size * np.cos(np.deg2rad(2.0 * theta_deg + 25.0))
        return gain * super().signal_V(heading_deg, theta_deg, at)


class MarkWrong(World):
    """The mark is another way than the sequence states."""

    def heading_deg(self, at: Place) -> float:
        return super().heading_deg(at) + (self.size if at.item != "search" else 0.0)


class HeadScale(World):
    """The dividing head turns too far by a part of the angle."""

    def heading_deg(self, at: Place) -> float:
        return super().heading_deg(at) + self.size * at.head_deg


class BenchTurns(World):
    """The bench turns slowly on its feet, at the mark."""

    def heading_deg(self, at: Place) -> float:
        return super().heading_deg(at) + (self.size * at.share if at.item != "search" else 0.0)


class BenchKnocked(World):
    """Somebody runs against the bench in the middle of the tests."""

    def heading_deg(self, at: Place) -> float:
        return super().heading_deg(at) + (self.size if at.item == "test" and at.share > 0.5 else 0.0)


class Restless(World):
    """North is another one in every set, by more than the noise."""

    def heading_deg(self, at: Place) -> float:
        wandered = np.random.default_rng(at.number).standard_normal()
        return super().heading_deg(at) + self.size * float(wandered)


class DelayAfterMove(World):
    """The lock-ins' reference comes later after the bench was carried."""

    def pulse_deg(self, letter: str, at: Place) -> float:
        return super().pulse_deg(letter, at) + (self.size if at.item == "search" else 0.0)


class OneBadReading(World):
    """One reading of one lock-in is off by a part of its amplitude."""

    AT = ("test", 90.0, 1, 2)

    def read_V(self, x_V: float, number: int, at: Place) -> float:
        hit = (at.item, at.head_deg, at.repeat, at.index) == self.AT and number == 1
        return x_V + self.size if hit else x_V


class Clipped(World):
    """The output of the gyroscope ends at a level."""

    def output_V(self, u_V: Any, at: Place) -> Any:
        return np.minimum(u_V, 2.0 - self.size)


class Frozen(World):
    """A part of every record's samples stands still, the lock-ins work on."""

    def output_V(self, u_V: Any, at: Place) -> Any:
        cut = len(u_V) - round(self.size * len(u_V))
        return np.concatenate((u_V[:cut], np.full(len(u_V) - cut, u_V[cut - 1])))


class Spike(World):
    """One sample of one record is far off."""

    def output_V(self, u_V: Any, at: Place) -> Any:
        spiked = u_V.copy()
        if (at.item, at.repeat, at.index) == ("search", 2, 3):
            spiked[100] += self.size
        return spiked


class NoisyField(World):
    """There is more noise at the place to be found."""

    def noise_V(self, at: Place) -> float:
        return NOISE_V * (1.0 + self.size if at.item == "search" else 1.0)


class EncoderSlips(World):
    """The zero of the encoder lies beside the one that is stated."""

    def shown_deg(self, theta_deg: Any, at: Place) -> Any:
        return theta_deg + self.size


class RateStated(World):
    """The sequence states another rate of the table."""

    def told(self, name: str, value: float) -> float:
        return value * (1.0 - self.size) if name == "rate_deg_s" else value


class LatitudeStated(World):
    """The sequence states another latitude; the bench is level, so that nothing depends on it."""

    def told(self, name: str, value: float) -> float:
        return value + self.size if name == "latitude_deg" else value


SWITCHES = (
    Switch("once_per_turn", OncePerTurn, (1e-4, 1e-2, 1e-1), "magnetic_effect"),
    Switch("field_magnet", FieldMagnet, (1e-3, 1e-2, 1e-1), "magnetic_effect"),
    Switch("field_motor", FieldMotor, (1e-3, 1e-2, 1e-1), "magnetic_effect"),
    Switch("modulated", Modulated, (1e-4, 1e-2, 1e-1), "magnetic_effect"),
    Switch("mark_wrong", MarkWrong, (1e-3, 0.5, 5.0), "azimuth_of_mark"),
    Switch("head_scale", HeadScale, (1e-5, 3e-3, 3e-2), "dividing_head"),
    Switch("bench_turns", BenchTurns, (0.01, 1.0, 10.0), "dividing_head"),
    Switch("bench_knocked", BenchKnocked, (0.01, 1.0, 10.0), "dividing_head"),
    Switch("restless", Restless, (0.01, 0.5, 5.0), "dividing_head"),
    Switch("delay_after_move", DelayAfterMove, (0.01, 1.0, 10.0), "delay_of_lock_ins"),
    Switch("one_bad_reading", OneBadReading, (1e-3, 0.1, 1.0)),
    Switch("clipped", Clipped, (0.1, 0.9, 1.5)),
    Switch("frozen", Frozen, (0.01, 0.1, 0.5)),
    Switch("spike", Spike, (1.0, 100.0, 1000.0)),
    Switch("noisy_field", NoisyField, (0.1, 1.0, 10.0)),
    Switch("encoder_slips", EncoderSlips, (1e-3, 1.0, 10.0), "zero_of_table"),
    Switch("rate_stated", RateStated, (1e-3, 0.5, 2.0)),
    Switch("latitude_stated", LatitudeStated, (0.1, 5.0, 30.0), "latitude"),
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
