"""Edges of a dithered ring laser as a stranger's time tagger records them.

The phase goes with the dither of each half cycle; lock-in is added to it in first order, by a sum over small steps.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from stranger_page import Session, documented_campaign, shipped

PATH_m, CLOCK_Hz, SECONDS = 0.28, 100_000_000, 3.0
LOCK_IN_deg_s, BACKSCATTER_deg, DITHER_deg_s, DITHER_Hz = 0.05, 70.0, 100.0, 400.0
_GAIN = np.pi * PATH_m / (2.0 * 632.8e-9)  # phase per angle, of a square ring
_HALF_s, _STEPS, _BLOCK_s = 0.5 / DITHER_Hz, 4000, 0.01


def random_walk_deg_rth() -> float:
    """What the jumps of lock-in make of the angle: W_L / sqrt(K W_D), docs/ring-laser.md."""
    lock_in, dither = np.radians(LOCK_IN_deg_s), np.radians(DITHER_deg_s)
    return float(60.0 * np.degrees(lock_in / np.sqrt(_GAIN * dither)))


def _half_cycle(psi_rad: float, dither_deg_s: float, sign: int) -> tuple[Any, Any, Any, float]:
    """Times (s), levels of sin and cos behind the edges, and the phase at the end, of one half cycle."""
    t_s = np.linspace(0.0, _HALF_s, _STEPS + 1)
    omega = 2.0 * np.pi * DITHER_Hz
    free = psi_rad + sign * _GAIN * np.radians(dither_deg_s) / omega * np.sin(omega * t_s)
    pull = _GAIN * np.radians(LOCK_IN_deg_s) * np.sin(free + np.radians(BACKSCATTER_deg))
    psi = free - np.concatenate(([0.0], np.cumsum(0.5 * (pull[1:] + pull[:-1])))) * (t_s[1] - t_s[0])
    top = int(np.argmax(sign * psi))
    times, counts, crossed = [], [], []
    for begin, end in ((0, top), (top, _STEPS)):
        low, high = sorted((psi[begin], psi[end]))
        level = np.arange(np.floor(low / np.pi) + 1, np.floor(high / np.pi) + 1).astype(np.int64)
        upward = bool(psi[end] > psi[begin])
        part = slice(begin, end + 1) if upward else slice(end, begin - 1 if begin else None, -1)
        at_s = np.interp(level * np.pi, psi[part], t_s[part])
        order = slice(None) if upward else slice(None, None, -1)
        times.append(at_s[order])
        crossed.append(level[order])
        counts.append((level if upward else level - 1)[order])
    return np.concatenate(times), np.concatenate(counts) % 2 == 0, np.concatenate(crossed) % 2 == 0, float(psi[-1])


def _edges(seed: int) -> tuple[Any, Any]:
    """Ticks of all edges in order of time, and the lowest three bits of each."""
    rng, psi_rad = np.random.default_rng(seed), 1.0
    ticks, bits = [], []
    for half in range(round(SECONDS / _HALF_s)):
        sign = 1 if half % 2 == 0 else -1
        ticks.append(np.array([half * _HALF_s]))
        bits.append(np.array([4 | 2 * (np.cos(psi_rad) > 0.0) | (sign > 0)]))
        dither_deg_s = DITHER_deg_s * (1.0 + 0.05 * rng.standard_normal())
        t_s, sine, cosine, psi_rad = _half_cycle(psi_rad, dither_deg_s, sign)
        ticks.append(half * _HALF_s + t_s)
        bits.append(sine + 2 * cosine)
    return np.floor(np.concatenate(ticks) * CLOCK_Hz + 1e-3).astype(np.int64), np.concatenate(bits).astype(np.int64)


def laser_session(seed: int = 6) -> Session:
    """One record of blocks of 10 ms; ``seed``: of the scatter of the dither."""
    session = Session(documented_campaign("rlg_lock_in"), {"edges": shipped("time_tags")})
    ticks, bits = _edges(seed)
    per_block, blocks = round(_BLOCK_s * CLOCK_Hz), round(SECONDS / _BLOCK_s)
    at = np.searchsorted(ticks, np.arange(blocks + 1) * per_block)
    for block in range(blocks):
        part = slice(at[block], at[block + 1])
        events = (bits[part] | (ticks[part] - block * per_block) << 3).astype("<u4").tobytes()
        tick = (123 + block) * per_block
        head = struct.pack("<HIQIIH", 32 + len(events), 7 + block, tick, CLOCK_Hz, 0, len(events) // 4)
        content = head + events
        frame = b"\xa5\x5a\xc3\x3c" + content + zlib.crc32(content).to_bytes(4, "little")
        session.frames("edges", 1.0 + (block + 1) * _BLOCK_s, frame)
    session.record(7, blocks, 1.0, 1.0 + SECONDS, path_length_m=PATH_m, clock_Hz=float(CLOCK_Hz), item="lock_in")
    return session
