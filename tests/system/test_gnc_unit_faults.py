"""The shipped unit tests on modules with faults: each fails exactly the items of its table, a sound one none."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from rehearsal import bench

from sim_instruments.gnc_faults import FAULTS

SOUND = "S-00"
SHORT = (
    "cpu_carry", "timer_slow", "sdram_address_short", "flash_weak_cell", "imu_frozen", "gps_no_satellites",
    "ad_reference", "io_swapped", "spi_receive_bit", "sci_silent", "can_identifier", "current_high",
    "contact_resistance",
)  # fmt: skip


def failed_items(folder: Path, unit: str) -> set[str]:
    items = json.loads((folder / "units" / unit / "summary.json").read_text())["items"]
    return {item for item, verdict in items.items() if verdict != "pass"}


def run_with(names: Sequence[str], out: Path) -> None:
    """One session: a sound unit, then one unit for each fault."""
    units = {f"F-{FAULTS[name].code:02}": name for name in names}
    words = ["--set", f"units={','.join([SOUND, *units])}"]
    words += ["--set", "world.faults=" + ",".join(f"{unit}={name}" for unit, name in units.items())]
    done = bench("run", "gnc_unit_test", *words, "--clock", "virtual", "--seed", "5", "--out", str(out))
    assert done.returncode == 1, done.stderr[-2000:]
    (folder,) = (path for path in out.iterdir() if path.is_dir())
    assert (folder / "results.json").is_file(), done.stderr[-2000:]
    assert failed_items(folder, SOUND) == set()
    found = {name: failed_items(folder, unit) for unit, name in units.items()}
    assert found == {name: set(FAULTS[name].fails) for name in names}


def test_a_fault_of_each_item_fails_exactly_its_items(tmp_path: Path) -> None:
    run_with(SHORT, tmp_path)


@pytest.mark.sweep
def test_every_fault_fails_exactly_its_items(tmp_path: Path) -> None:
    run_with(list(FAULTS), tmp_path)
