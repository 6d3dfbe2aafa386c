"""Streams of ngu_a frames with known counts, whole or damaged, for the tests of cutting and replay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from record_sample import NS, frame

RATE_HZ = 100
AF_CLOCK = 2560
MASTER = 100_000
FRAME_NS = NS // RATE_HZ


@dataclass
class Stream:
    """Frames of a link: ``counter`` unwrapped, ``columns`` as encoded, ``frames`` (n, 57) bytes."""

    counter: NDArray[np.int64]
    columns: dict[str, NDArray[np.int64]]
    frames: NDArray[np.uint8]

    def expected(self, name: str, keep: NDArray[np.bool_] | list[int] | slice) -> list[int]:
        """Sums by plain Python integers."""
        picked = self.columns[name][keep]
        if picked.ndim == 1:
            return [sum(int(value) for value in picked)]
        return [sum(int(value) for value in picked[:, k]) for k in range(picked.shape[1])]


def stream(count: int, seed: int = 1, first_counter: int = 0) -> Stream:
    """``count`` frames whose counts are random but possible."""
    rng = np.random.default_rng(seed)
    counter = np.arange(first_counter, first_counter + count, dtype=np.int64)
    columns = {
        "counter": counter % 65536,
        "npp": rng.integers(0, 1200, (count, 10)),
        "ppp": rng.integers(0, 1200, (count, 10)),
        "af_clock": AF_CLOCK + rng.integers(-1, 2, count),
        "master_count": np.full(count, MASTER),
        "fg_count": MASTER + rng.integers(-1, 2, count),
        "status": np.zeros(count, np.int64),
    }
    return Stream(counter, columns, frame("ngu_a").encode(columns, count))


def constant_stream(npp: NDArray[np.int64], ppp: NDArray[np.int64], first_counter: int = 0) -> Stream:
    """Frames with the given pulse counts (n, 10)."""
    count = len(npp)
    made = stream(count, first_counter=first_counter)
    made.columns |= {"npp": npp, "ppp": ppp, "af_clock": np.full(count, AF_CLOCK), "fg_count": np.full(count, MASTER)}
    made.frames = frame("ngu_a").encode(made.columns, count)
    return made


def chunks_of(raw: bytes, rng: np.random.Generator, low: int = 1, high: int = 700) -> list[bytes]:
    """The bytes cut at random places."""
    cut, at = [], 0
    while at < len(raw):
        size = int(rng.integers(low, high + 1))
        cut.append(raw[at : at + size])
        at += size
    return cut


def housekeeping(count: int, first: int = 0, temperature_degC: float = 20.0) -> bytes:
    """``count`` housekeeping frames of port B; the four sensors read the temperature, +0.01 per frame and sensor."""
    raw = np.round(temperature_degC * 100).astype(int) + np.arange(count)[:, None] + np.arange(4)[None, :]
    columns = {
        "counter": (first + np.arange(count)) % 65536, "unit_temperature": raw, "supply_voltage": 28000,
        "supply_current": 1800, "rails": np.tile([5000, 15000, 15000], (count, 1)), "status": 1,
    }  # fmt: skip
    return frame("ngu_b").encode(columns, count, "housekeeping").tobytes()
