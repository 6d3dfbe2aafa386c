"""A north finder by trigonometry, edges of ``laser_physics``, a flight of ``sync_physics`` as strangers record them."""

import struct
import zlib
from typing import Any

import numpy as np
from laser_physics import World, blocks, crossings, half_cycles
from stranger_page import Session, documented_campaign, packed, shipped
from sync_physics import EGI_s, IMU_s, OFFSET_s, Recording

RATE_Hz, SECONDS = 1000, 2
AXIS_deg, SOUGHT_deg = 20.0, 213.4  # of the sensing axis at zero: on the mark, and at the place to be found
HEADS_deg = (0.0, 60.0, 150.0, 270.0)
_LATE_deg, _GAINS = (7.0, -4.0), (1.01, 0.985)  # of the index pulses and lock-ins: found by the calibration
_FRAME = np.dtype(
    [("counter", "<u4"), ("output", "<i4"), ("encoder", "<u4"), ("temperature", "<i2"), ("status", "<u2")]
)


class _Bench:
    def __init__(self) -> None:
        self.session = Session(documented_campaign("fog_north"), {"fog": shipped("fog_1k")})
        self.rng, self.t_s, self.counter = np.random.default_rng(11), 1.0, 0

    def set_of_four(self, heading_deg: float, **conditions: Any) -> None:
        """The Earth's rate along the axis, 1 V at most, at four phases of both lock-ins."""
        for index in (1, 2, 3, 4):
            n = RATE_Hz * SECONDS
            theta_deg = 360.0 * (np.arange(n) + 0.5) / RATE_Hz
            output_V = 0.3 + np.cos(np.radians(heading_deg - theta_deg)) + self.rng.normal(0.0, 0.02, n)
            self._stream(output_V, theta_deg)
            begin_s = self.t_s - SECONDS
            said = {**conditions, "index": index}
            self.session.record(self.counter - n, n, begin_s, self.t_s, rate_deg_s=360.0, **said)
            for role, pulse_deg, late_deg, gain in zip(
                ("lock_in_1", "lock_in_2"), (270.0, 0.0), _LATE_deg, _GAINS, strict=True
            ):
                turned = np.radians(theta_deg - pulse_deg - late_deg - 90.0 * (index - 1))
                x_V = gain * np.sqrt(2.0) * float(np.mean(output_V * np.sin(turned)))
                value = {"x_V": x_V, "frequency_Hz": 1.0, "overload": False, "unlocked": False}
                self.session.reading(self.t_s + 0.5, role, "measure", value, **said)
            self.t_s += 1.0

    def _stream(self, output_V: Any, theta_deg: Any) -> None:
        body = np.zeros(len(output_V), _FRAME)
        body["counter"] = self.counter + np.arange(len(body))
        body["output"] = np.rint(output_V / 1e-6)
        body["encoder"] = np.rint(theta_deg % 360.0 / 360.0 * 2**24).astype(np.int64) % 2**24
        body["temperature"] = 2500
        frames = packed(b"\xf0\x6e", body, "crc-16/ibm-3740")
        for at in range(0, len(frames), 100):
            self.t_s += 100 / RATE_Hz
            self.session.frames("fog", self.t_s, b"".join(frames[at : at + 100]))
        self.counter += len(body)


def north_session() -> Session:
    """Calibration on the mark, four heads, and a place whose azimuth nobody told."""
    bench = _Bench()
    level = {"x_mrad": 0.0, "y_mrad": 0.0}
    bench.session.reading(0.5, "level", "measure", level)
    for repeat in (1, 2):
        bench.set_of_four(AXIS_deg, item="calibration", head_deg=0.0, repeat=repeat, place="mark")
    for head_deg in HEADS_deg:
        for repeat in (1, 2):
            bench.set_of_four(AXIS_deg + head_deg, item="test", head_deg=head_deg, repeat=repeat, place="mark")
    for repeat in (1, 2):
        bench.set_of_four(SOUGHT_deg, item="search", head_deg=0.0, repeat=repeat, place="field")
    return bench.session


LOCK_IN_deg_s, BACKSCATTER_deg = 0.05, 70.0
WORLD = World(path_m=0.28, clock_Hz=100_000_000, seconds=3.0, lock_in_deg_s=LOCK_IN_deg_s, beta_deg=BACKSCATTER_deg,
              quantum_deg_rth=1.15e-4)  # fmt: skip


def random_walk_deg_rth() -> float:
    """Jumps of lock-in, W_L / sqrt(K W_D) of docs/method-ring-laser.md, and the quantum noise."""
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


__all__ = ["OFFSET_s", "sync_session"]
IMU = np.dtype(
    [
        ("counter", "<u4"), ("tick", "<u8"), ("delta_angle", "<i4", 3), ("delta_velocity", "<i4", 3),
        ("temperature", "<i2"), ("status", "<u2"),
    ]
)  # fmt: skip
EGI = np.dtype(
    [
        ("counter", "<u4"), ("tick", "<u8"), ("latitude", "<f8"), ("longitude", "<f8"), ("height", "<f8"),
        ("velocity", "<f8", 3), ("attitude", "<f8", 3), ("position_sigma", "<f4"), ("mode", "<u2"), ("status", "<u2"),
    ]
)  # fmt: skip


def sync_session() -> Session:
    """Straight on, a turn of 90 deg, straight on: one record, each frame a message of its own."""
    (row,) = Recording(4).material().rows
    links = {"imu": (b"IM", IMU, IMU_s, row.samples), "egi": (b"EG", EGI, EGI_s, row.beside["egi"])}
    texts = {}
    for link, name, rate_Hz in (("imu", "imu_200", 200), ("egi", "egi_50", 50)):
        texts[link] = shipped(name).replace(f"rate: {rate_Hz} Hz", f"rate: {1.0 / links[link][2]:g} Hz")
    session = Session(documented_campaign("time_sync"), texts)
    for link, (sync, layout, _, samples) in links.items():
        assert samples is not None
        body = np.zeros(len(samples), layout)
        body["counter"] = samples.counter
        for column, values in samples.columns.items():
            body[column] = values
        for frame, t_ns in zip(packed(sync, body, "crc-32/iso-hdlc"), samples.t_ns.tolist(), strict=True):
            session.frames(link, 1e-9 * t_ns, frame)
    window = row.window
    begin_s, end_s = 1e-9 * window.t_start_ns - 0.1, 1e-9 * window.t_end_ns + 0.5
    session.record(window.first_counter, window.frames, begin_s, end_s, **window.conditions)
    return session
