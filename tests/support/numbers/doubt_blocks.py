"""Blocks of wrong and right worlds: what the estimates of some seeds are, in a row of a committed file."""

import importlib
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

from block_rows import ROOT
from doubt_classes import CLASSES, LEAST_TRACE, WRONG, Seen, Switch, sorted_classes, trace_of, worst_bias

ROWS = ROOT / "tests" / "doubt" / "rows.csv"
BIASES = ROOT / "tests" / "doubt" / "biases.csv"
_NOT_WORLDS = {"doubt_blocks", "doubt_classes", "doubt_page"}


class Worlds(Protocol):
    """A module of wrong worlds: the respects in which they are wrong, and what a campaign in one of them states."""

    SYSTEM: str
    SWITCHES: tuple[Switch, ...]

    def seen(self, seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
        """Return what the campaign of a seed states and its truth; without a switch of a right world."""


@dataclass(frozen=True)
class Block:
    """Row of a block; ``switch``: "" for right worlds. ``trace``: of the noise-free run of the first seed.

    ``bias``: of the estimate that is most off in it, in expanded uncertainties. ``visible``: confidently wrong ones of
    seeds whose own trace could be seen. ``campaigns``: those with any estimate that is not sound.
    """

    system: str
    switch: str
    size: float
    first: int
    last: int
    revision: str
    trace: float
    bias: float
    right: int
    wide: int
    missed: int
    doubted: int
    refused: int
    confidently_wrong: int
    visible: int
    campaigns: int
    cpu_s: float

    @property
    def seeds(self) -> range:
        """The seeds of the block."""
        return range(self.first, self.last + 1)

    @property
    def hidden(self) -> bool:
        """Whether the violation leaves no trace that could be seen."""
        return self.trace < LEAST_TRACE


@dataclass(frozen=True)
class Bias:
    """How far a violation alone puts the estimates of a quantity off: the worst, in expanded uncertainties."""

    system: str
    switch: str
    size: float
    revision: str
    quantity: str
    worst: float


def all_worlds() -> Iterator[Worlds]:
    """Yield the modules of wrong worlds, ``doubt_*`` in the folders of the systems."""
    for path in sorted((ROOT / "tests" / "support").glob("*/doubt_*.py")):
        if path.stem not in _NOT_WORLDS:
            yield _worlds(path.stem)


@cache
def _worlds(module: str) -> Worlds:
    loaded: Any = importlib.import_module(module)
    return loaded  # type: ignore[no-any-return]


@cache
def _right(module: str, seed: int) -> Seen:
    return _worlds(module).seen(seed, None, 0.0)


def module_of(worlds: Worlds) -> str:
    """Return the name by which another process finds a module of wrong worlds."""
    return str(worlds.__name__)  # type: ignore[attr-defined]


def done_block(module: str, name: str, size: float, seeds: range, revision: str) -> tuple[Block, list[Bias]]:
    """Sort the estimates of one switch and size, or of right worlds (name ""), over some seeds."""
    begun_s = time.process_time()
    worlds = _worlds(module)
    switch = next((switch for switch in worlds.SWITCHES if switch.name == name), None)
    counted, campaigns, visible = Counter[str](), 0, 0
    for seed in seeds:
        right = _right(module, seed)
        wrong = right if switch is None else worlds.seen(seed, switch, size)
        here = sorted_classes(wrong, right)
        counted += here
        if switch and here[WRONG] and _trace(worlds, seed, switch, size) >= LEAST_TRACE:
            visible += here[WRONG]
        campaigns += any(entry.quality != "sound" for entry in wrong.entries)
    trace, biases = 0.0, {}
    if switch is not None:
        biases = worst_bias(worlds.seen(seeds[0], switch, size, noise_free=True), _right(module, seeds[0]))
        trace = _trace(worlds, seeds[0], switch, size)
    block = Block(
        worlds.SYSTEM, name, size, seeds.start, seeds.stop - 1, revision, round(trace, 1),
        round(max(biases.values(), default=0.0), 2), *(counted[kind] for kind in CLASSES), visible, campaigns,
        round(time.process_time() - begun_s, 1),
    )  # fmt: skip
    return block, [Bias(worlds.SYSTEM, name, size, revision, key, round(value, 2)) for key, value in biases.items()]


def _trace(worlds: Worlds, seed: int, switch: Switch, size: float) -> float:
    bare = worlds.seen(seed, switch, size, noise_free=True)
    return trace_of(bare, worlds.seen(seed, None, 0.0, noise_free=True))
