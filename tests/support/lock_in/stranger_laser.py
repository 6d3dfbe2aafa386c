"""Edges of a ring laser of ``laser_physics`` in frames of docs/session-format.md, as a stranger records them."""

import struct
import zlib

import numpy as np
from laser_physics import World, blocks, crossings, half_cycles
from stranger_page import Session, documented_campaign, shipped

LOCK_IN_deg_s, BACKSCATTER_deg = 0.05, 70.0
WORLD = World(path_m=0.28, clock_Hz=100_000_000, seconds=3.0, lock_in_deg_s=LOCK_IN_deg_s, beta_deg=BACKSCATTER_deg,
              quantum_deg_rth=1.15e-4)  # fmt: skip


def random_walk_deg_rth() -> float:
    """What the jumps of lock-in make of the angle, W_L / sqrt(K W_D) of docs/ring-laser.md, and the quantum noise."""
    lock_in, dither = np.radians(LOCK_IN_deg_s), np.radians(100.0)
    jumps = 60.0 * np.degrees(lock_in / np.sqrt(WORLD.gain * dither))
    return float(np.hypot(jumps, WORLD.quantum_deg_rth))


def laser_session(seed: int = 5) -> Session:
    """One record of blocks of 10 ms; ``seed``: of the scatter of the dither."""
    session, rng = (
        Session(documented_campaign("rlg_lock_in"), {"edges": shipped("time_tags")}),
        np.random.default_rng(seed),
    )
    cycles = half_cycles(WORLD, rng)
    found = blocks(WORLD, crossings(WORLD, cycles), cycles.turn_rad.size, rng, WORLD.clock_Hz)
    for number, (tick, channel, level, cosine) in enumerate(found):
        events = (level | cosine << 1 | channel << 2 | tick << 3).astype("<u4").tobytes()
        begin_tick = (123 + number) * WORLD.clock_Hz // 100
        head = struct.pack("<HIQIIH", 32 + len(events), 7 + number, begin_tick, WORLD.clock_Hz, 0, len(events) // 4)
        frame = b"\xa5\x5a\xc3\x3c" + head + events + zlib.crc32(head + events).to_bytes(4, "little")
        session.frames("edges", 1.0 + (number + 1) * 0.01, frame)
    end_s, path_m, clock_Hz = 1.0 + 0.01 * len(found), WORLD.path_m, float(WORLD.clock_Hz)
    session.record(7, len(found), 1.0, end_s, path_length_m=path_m, clock_Hz=clock_Hz, item="lock_in")
    return session
