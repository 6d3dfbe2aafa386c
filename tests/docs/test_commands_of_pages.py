"""Every command in the pages: run, or checked in place of a long run, or at least parsed."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest
import typer
from commands_not_run import MOST_CHECKED, MOST_PARSED, NOT_RUN
from doc_blocks import ROOT, Block, blocks, words_of
from rehearsal import Inside, writable_copy

from bench.cli import app

GOLDEN = ROOT / "tests" / "golden" / "sessions"
TUTORIAL = "docs/tutorial.md"  # is executed by a shell: test_tutorial.py
BLOCKS = [block for block in blocks("sh") if block.page != TUTORIAL]
QUICK = {"first_check"}
SESSION_OF = {
    "docs/fog-north.md": "20000101T000002Z_golden_fog_GOLDEN",
    "docs/gnc-module.md": "20000101T000002Z_gnc_unit_test_GOLDEN",
    "docs/ring-laser.md": "20000101T000000Z_golden_rlg_GOLDEN",
}
EXAMPLES = {  # what stands for the things of the reader
    "MAKE_UP_SESSION": "SESSION",
    "sessions/20000101T000000Z_scale_factor_38h_SIM-1": "SESSION",
    "sessions/20000101T000000Z_scale_factor_short_SIM-1": "SESSION",
    "SIM-1": "GOLDEN",
    "--uut GNC-02": "--uut GOLDEN",
    "sequences/my_campaign.yaml": "scale_factor_short",
    "FRAME FILE": "ngu_a capture.bin",
    "CAPTURE": "capture.bin",
    "frames/my_device.yaml": "my_device.yaml",
    "$S/": f"{GOLDEN}/",
}
NOT_OURS = ("ssh ", "dask ", "export ", "OMP_NUM_THREADS=1 ", "rm ", "pip install -e . --no-deps", "cd our_lab")


def reason(line: str) -> str:
    """Return why a command is not run, "" if it is."""
    return next((why for beginning, why in NOT_RUN.items() if line.startswith(beginning)), "")


def of_the_bench(block: Block) -> list[str]:
    """Return the command lines of a block that begin with ``bench``."""
    lines = [line.removeprefix(".venv/bin/") for line in block.command_lines]
    return [line for line in lines if line.startswith("bench ")]


def is_long(line: str) -> bool:
    """Return whether a command runs a campaign that takes more than a second or two: its plan is checked instead."""
    return line.startswith("bench run ") and line.split()[2] not in QUICK


def for_this_test(line: str, session: str) -> list[str]:
    """Return the words of a command line with the things of this test in place of the reader's."""
    for theirs, ours in EXAMPLES.items():
        line = line.replace(theirs, ours)
    words = words_of(re.sub(r"(?<![A-Z_])SESSION\b", session, line))[1:]
    if is_long(line):
        kept = ("--set", "--station")
        pairs = [word for pair in pairwise(words) if pair[0] in kept for word in pair]
        return ["check", words[1], *pairs]
    return [name for word in words for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]


@pytest.fixture
def lab(golden: Path, tmp_path: Path) -> Path:
    """Return a folder with what a reader has: a session and its history, a laboratory file, a capture, a log."""
    place = tmp_path / "lab"
    writable_copy(golden.parent, place / "sessions")
    for name in ("laboratory.yaml", "corrected.yaml"):
        shutil.copy(ROOT / "docs" / name, place)
    frame = bytes.fromhex((ROOT / "tests" / "golden" / "ngu_a.hex").read_text())
    (place / "capture.bin").write_bytes(frame * 20)
    rows = "".join(f"{0.01 * row:.2f},{0.1 * (row % 7):.1f}\n" for row in range(200))
    (place / "log.csv").write_text(f"time [s],gyro x [deg/s]\n{rows}")
    return place


@pytest.mark.parametrize("block", [block for block in BLOCKS if of_the_bench(block)], ids=lambda block: block.place)
def test_the_commands_of_a_block_run(
    block: Block, lab: Path, golden: Path, inside: Inside, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run them one behind the other, as a reader does; what is refused has another status than 0 and 1."""
    monkeypatch.chdir(lab)
    session = f"sessions/{SESSION_OF.get(block.page, golden.name)}"
    if block.page in SESSION_OF:
        shutil.copytree(GOLDEN / "0.1.0" / SESSION_OF[block.page], session)
    for line in block.command_lines:
        line = line.removeprefix(".venv/bin/")
        if line.startswith("cd "):
            monkeypatch.chdir(line.split()[1])
        elif line.startswith("bench ") and not reason(line):
            done = inside(*for_this_test(line, session))
            assert done.returncode in (0, 1), f"{block.place}: {line}: {done.stderr}"


@pytest.mark.parametrize("line", sorted({line for block in BLOCKS for line in of_the_bench(block) if reason(line)}))
def test_what_is_not_run_is_parsed(line: str) -> None:
    top = typer.main.get_command(app)
    words = words_of(line)[1:]
    context = top.make_context("bench", words)
    name, command, rest = top.resolve_command(context, words)
    command.make_context(name, rest, parent=context)


def test_other_programs_are_known() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    lines = [
        line for block in BLOCKS for line in block.command_lines if line.removeprefix(".venv/bin/")[:6] != "bench "
    ]
    targets = [words_of(line)[1] for line in lines if line.startswith("make ")]
    assert [target for target in targets if f"\n{target}:" not in makefile] == []
    assert [line for line in lines if not line.startswith(("make ", *NOT_OURS))] == []


def test_few_commands_are_not_run() -> None:
    lines = [line for block in BLOCKS for line in of_the_bench(block)]
    unused = [beginning for beginning in NOT_RUN if not any(line.startswith(beginning) for line in lines)]
    counted = Counter("parsed" if reason(line) else "checked" if is_long(line) else "run" for line in lines)
    print(f"commands of the pages: {dict(counted)}")
    assert unused == []
    assert counted["parsed"] <= MOST_PARSED
    assert counted["checked"] <= MOST_CHECKED
