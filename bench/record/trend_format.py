"""How the trend of a session lies on the disk (docs/session-format.md, section Trend)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame import BENCH, FrameDefinition, Signal
from bench.model.clock import NS

VERSION = 1
FOLDER = "trend"
HEAD = "trend.json"
LEVELS_S = (1, 10, 100)
HELD_S = 90.0  # how long a temperature of the bench stands that is read once a minute


@dataclass(frozen=True)
class TrendSource:
    """A link or the bench with its signals; ``period_s`` is the time between two of its frames or readings."""

    name: str
    signals: tuple[Signal, ...]
    period_s: float

    @property
    def row_type(self) -> np.dtype[np.void]:
        """One row of its files: start of the bucket in UTC, then least and greatest value of each signal."""
        return np.dtype([("t_utc_s", "<f8"), ("span", "<f4", (len(self.signals), 2))])

    def path(self, folder: Path, level_s: int) -> Path:
        """File of one level in the folder of the trend."""
        return folder / f"{self.name}.{level_s:03d}s"


@dataclass(frozen=True)
class TrendHead:
    """What the files of a trend hold: sources, and UTC minus monotonic time of each part of the session, ns."""

    sources: tuple[TrendSource, ...]
    offsets_ns: tuple[int, ...]

    @property
    def signals(self) -> tuple[Signal, ...]:
        """All signals, source by source."""
        return tuple(signal for source in self.sources for signal in source.signals)


def sources_of(signals: Sequence[Signal], frames: Mapping[str, FrameDefinition]) -> tuple[TrendSource, ...]:
    """Links in the order of their first signal; a link whose frames name no rate counts as one of each second."""
    found = []
    for link in dict.fromkeys(signal.link for signal in signals):
        rate_Hz = 1.0 if link == BENCH else frames[link].rate_Hz or 1.0
        own = tuple(signal for signal in signals if signal.link == link)
        found.append(TrendSource(link, own, 1.0 / rate_Hz))
    return tuple(found)


def write_head(folder: Path, head: TrendHead) -> None:
    """Write the head in one piece. Raises: OSError."""
    content: dict[str, Any] = {
        "version": VERSION,
        "levels_s": list(LEVELS_S),
        "offsets_ns": list(head.offsets_ns),
        "sources": [asdict(source) for source in head.sources],
    }
    fresh = folder / f"{HEAD}.new"
    fresh.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    fresh.replace(folder / HEAD)


def read_head(folder: Path) -> TrendHead | None:
    """The head of a trend; None if there is none, or it is damaged or of another version: it can be made again."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        content = json.loads((folder / HEAD).read_text(encoding="utf-8"))
        if content["version"] == VERSION and content["levels_s"] == list(LEVELS_S):
            sources = tuple(_source(one) for one in content["sources"])
            return TrendHead(sources, tuple(int(one) for one in content["offsets_ns"]))
    return None


def _source(content: Mapping[str, Any]) -> TrendSource:
    signals = tuple(Signal(**one) for one in content["signals"])
    return TrendSource(str(content["name"]), signals, float(content["period_s"]))


def seconds_of(t_utc_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bucket of 1 s of each time, by its start; a time on the border belongs to the bucket that ends there.

    Under the virtual clock a link is read on the second: what came before it belongs together.
    """
    seconds: NDArray[np.int64] = (t_utc_ns - 1) // NS
    return seconds
