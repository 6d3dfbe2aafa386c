"""The shipped unit tests on modules with faults: each fails exactly the items of its table, a sound one none."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from rehearsal import Inside

from sim_instruments.worlds.gnc.options import FAULTS

SOUND = "S-00"
SHORT = (
    "cpu_carry", "timer_slow", "sdram_address_short", "flash_weak_cell", "imu_frozen", "gps_no_satellites",
    "ad_reference", "io_swapped", "spi_receive_bit", "sci_silent", "can_identifier", "current_high",
    "contact_resistance",
)  # fmt: skip


def failed_items(folder: Path, unit: str) -> set[str]:
    items = json.loads((folder / "units" / unit / "summary.json").read_text())["items"]
    return {item for item, verdict in items.items() if verdict != "pass"}


def elapsed_s(folder: Path, unit: str) -> float:
    """From the first command to the last answer: the paper's "functional test time" of 8 to 10 s."""
    elapsed_s = json.loads((folder / "units" / unit / "summary.json").read_text())["elapsed_s"]
    assert isinstance(elapsed_s, float)
    return elapsed_s


def run_with(inside: Inside, names: Sequence[str], out: Path) -> None:
    """One session: a sound unit, then one unit for each fault."""
    units = {f"F-{FAULTS[name].code:02}": name for name in names}
    words = ["--set", f"units={','.join([SOUND, *units])}"]
    words += ["--set", "world.faults=" + ",".join(f"{unit}={name}" for unit, name in units.items())]
    done = inside("run", "gnc_unit_test", *words, "--clock", "virtual", "--seed", "5", "--out", str(out))
    assert done.returncode == 1, done.stderr[-2000:]
    (folder,) = (path for path in out.iterdir() if path.is_dir())
    assert (folder / "results.json").is_file(), done.stderr[-2000:]
    assert failed_items(folder, SOUND) == set()
    assert 8.0 <= elapsed_s(folder, SOUND) <= 10.0
    found = {name: failed_items(folder, unit) for unit, name in units.items()}
    assert found == {name: set(FAULTS[name].fails) for name in names}


def test_a_fault_of_each_item_fails_exactly_its_items(inside: Inside, tmp_path: Path) -> None:
    run_with(inside, SHORT, tmp_path)


@pytest.mark.sweep
def test_every_fault_fails_exactly_its_items(inside: Inside, tmp_path: Path) -> None:
    run_with(inside, list(FAULTS), tmp_path)


@pytest.mark.sweep
def test_two_hundred_sound_units_pass(inside: Inside, tmp_path: Path) -> None:
    units = [f"S-{number:03}" for number in range(1, 201)]
    words = ["--set", f"units={','.join(units)}", "--clock", "virtual", "--seed", "77", "--out", str(tmp_path)]
    done = inside("run", "gnc_unit_test", *words)
    assert done.returncode == 0, done.stderr[-2000:]
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert [unit for unit in units if failed_items(folder, unit)] == []
    times_s = [elapsed_s(folder, unit) for unit in units]
    print(f"200 units of 200 pass, {min(times_s):.3f} to {max(times_s):.3f} s each")
    assert min(times_s) >= 8.0
    assert max(times_s) <= 10.0
