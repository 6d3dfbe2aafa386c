"""Records of right ring lasers: hardly one is doubted, and intervals hold the truth as often as they say."""

from collections import Counter
from dataclasses import replace

import doubt_lock_in as worlds
import pytest
from coverage_blocks import in_right_world
from doubt_lock_in import Simulated, simulated
from laser_physics import World
from scipy import stats

from bench.analysis import build_results, estimates_of
from bench.systems.lock_in.analysis import analyse

FAST = 100_000_000
SETTINGS = {
    "15 cm, 20 MHz, 65 deg": (World(), 200),
    "15 cm, 100 MHz, 90 deg": (World(clock_Hz=FAST, beta_deg=90.0), 200),
    "15 cm, 20 MHz, 0 deg, 500 Hz": (World(beta_deg=0.0, dither_Hz=500.37), 200),
    "28 cm, 100 MHz, 20 deg": (World(path_m=0.28, lock_in_deg_s=0.05, quantum_deg_rth=1.15e-4, beta_deg=20.0,
                                     clock_Hz=FAST), 200),
    "15 cm, 20 MHz, 65 deg, 8 s": (World(seconds=8.0), 50),
}  # fmt: skip
FIRST_SEED = 40_000


def held(campaign: Simulated) -> dict[str, bool | None]:
    """Return of each quantity and method whether its interval holds the truth, None where it is not sound."""
    document = build_results("doubt", analyse(campaign.material), {"records": 1}, worlds.PROVENANCE)
    pairs = [(entry, campaign.truths.get((entry.quantity, entry.conditions.get("method", ""))))
             for entry in estimates_of(document)]  # fmt: skip
    known = [(entry, truth) for entry, truth in pairs if truth is not None]
    return in_right_world([entry for entry, _ in known], [truth for _, truth in known])


def counted(world: World, seeds: range) -> tuple[Counter[str], int]:
    """Return of how many records the interval of each quantity holds the truth, and how many are doubted."""
    inside: Counter[str] = Counter()
    doubted = 0
    for seed in seeds:
        found = held(simulated(seed, world))
        doubted += None in found.values()
        inside.update(name for name, holds in found.items() if holds)
    return inside, doubted


def test_a_few_records_are_sound() -> None:
    world = replace(SETTINGS["15 cm, 100 MHz, 90 deg"][0], seconds=1.0)
    inside, doubted = counted(world, range(FIRST_SEED, FIRST_SEED + 4))
    assert doubted == 0
    assert len(inside) == 8
    assert min(inside.values()) >= 2


@pytest.mark.sweep
@pytest.mark.parametrize("setting", SETTINGS)
def test_intervals_hold_what_they_say_and_right_records_are_sound(setting: str) -> None:
    """Too few inside is wrong, beyond 99.9 % of a binomial count; more there are where quantisation hides a walk."""
    world, count = SETTINGS[setting]
    inside, doubted = counted(world, range(FIRST_SEED, FIRST_SEED + count))
    print(f"{setting}, seeds {FIRST_SEED} to {FIRST_SEED + count - 1}: {doubted} of {count} doubted")
    for name, number in sorted(inside.items()):
        print(f"{name}: {number} of {count} inside")
    assert doubted <= max(1, count // 100)
    least = stats.binom.ppf(0.001, count, 0.95)
    assert {name: number for name, number in inside.items() if number < least} == {}
