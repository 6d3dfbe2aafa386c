"""How seeds are soaked in blocks: what is left, what stands in the file, and the test of a seed that fails."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import soak_blocks
import soak_campaign
from block_rows import add_row, in_blocks, read_rows, seeds_left
from fault_schedule import TimedFault
from hypothesis import given
from hypothesis import strategies as st
from soak_blocks import Block, soaked_block
from soak_campaign import ROOT, SHORT, Campaign, Soaked, shortest, write_test, written_test

NEEDED = (TimedFault(12.5, "trip"), TimedFault(40.0, "stuck", "port_a", ("55",), 3.0))
OTHERS = [TimedFault(float(at), "drop", "port_b", (0.01,), 60.0) for at in range(50, 55)]


def block(first: int, last: int, campaign: str = SHORT) -> Block:
    return Block(campaign, first, last, "0123abc", "2 done; 1 B-RUN-031", 7, 30, 1, 0, 0.2, 1.9)


def violated(faults: Any) -> list[str]:
    """A bug that needs two faults."""
    return ["unsafe: supply on"] if set(NEEDED) <= set(faults) else []


@given(st.lists(st.booleans(), max_size=40))
def test_no_fault_of_a_shortest_list_can_be_left_out(noise: list[bool]) -> None:
    faults = [TimedFault(float(number), "trip") for number in range(len(noise))]
    needed = {fault for fault, kept in zip(faults, noise, strict=True) if kept}
    assert shortest(faults, lambda some: needed <= set(some)) == [fault for fault in faults if fault in needed]


def test_rows_are_read_as_they_were_added(tmp_path: Path) -> None:
    rows = [block(0, 99), block(100, 100, "scale_factor_38h")]
    for row in rows:
        add_row(row, tmp_path / "blocks.csv")
    assert read_rows(Block, tmp_path / "blocks.csv") == rows
    assert read_rows(Block, tmp_path / "none.csv") == []


def test_what_stands_in_a_row_is_not_soaked_again() -> None:
    left = seeds_left([range(4), range(8, 10)], 15)
    assert left == [4, 5, 6, 7, 10, 11, 12, 13, 14]
    assert in_blocks(left, 3) == [range(4, 7), range(7, 8), range(10, 13), range(13, 15)]
    assert seeds_left([range(15)], 15) == []


@pytest.fixture
def planted(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Soak a campaign that has a bug until ``cured`` says otherwise."""
    bug = SimpleNamespace(cured=False)

    def soaked(self: Campaign, seed: int, folder: Path, faults: Any = None, clock: Any = None) -> Soaked:
        under = ([*OTHERS[:2], *NEEDED, *OTHERS[2:]] if seed == 4 else OTHERS) if faults is None else faults
        return Soaked(seed, under, "done", [] if bug.cured else violated(under), 10, 0, 0.5)

    campaign = Campaign(SHORT, None, (), 250.0, 80.0, ())  # type: ignore[arg-type]
    monkeypatch.setattr(Campaign, "soaked", soaked)
    for module in (soak_blocks, soak_campaign):
        monkeypatch.setattr(module, "campaign_of", lambda *_: campaign)
    return bug


def test_a_seed_that_fails_is_cut_down_and_becomes_a_test(planted: SimpleNamespace, tmp_path: Path) -> None:
    row, (failure,) = soaked_block(SHORT, range(3, 6), "0123abc")
    assert (row.first, row.last, row.ended, row.violations, row.faults, row.hours) == (3, 5, "3 done", 1, 17, 1.5)
    assert (failure.seed, failure.violations) == (4, ("unsafe: supply on",))
    text = write_test(SHORT, 4, failure.test, tmp_path).read_text()
    assert "7 faults were drawn, 2 are needed" in text
    module: dict[str, Any] = {}
    exec(compile(text, "test_found_soak_4.py", "exec"), module)
    assert module["FAULTS"] == list(NEEDED)
    with pytest.raises(AssertionError):
        module["test_soak_4"](tmp_path)
    planted.cured = True
    module["test_soak_4"](tmp_path)


@pytest.mark.parametrize("faults", [[], [NEEDED[0]], [*NEEDED, *OTHERS]])
def test_a_written_test_is_as_the_house_writes_it(faults: list[TimedFault], tmp_path: Path) -> None:
    text = written_test("scale_factor_38h", 7, faults, 84, ['a "quoted" \\path', "another"], "0123abc+")
    path = write_test("scale_factor_38h", 7, text, tmp_path)
    assert path.name == "test_found_scale_factor_38h_7.py"
    words = [sys.executable, "-m", "ruff", "format", "--check", "--config", str(ROOT / "pyproject.toml"), str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
