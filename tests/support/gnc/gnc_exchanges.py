"""Exchanges of a sound GNC module, by hand: what the board would answer, as bytes packed here and nowhere else."""

from __future__ import annotations

import struct
from itertools import permutations, product
from pathlib import Path
from typing import Any

from bench.analysis import Exchange, Material, Reading
from bench.frame import load_frame

FRAME = Path(__file__).parents[3] / "frames" / "gnc_422.yaml"
SITE = {"latitude_deg": 37.5, "longitude_deg": 127.0, "height_m": 85.0, "gravity_m_s2": 9.798, "azimuth_deg": 90.0}
CAMPAIGN = {"analysis": "gnc_unit_test", "uut": {"model": "GNC", "serial": "GNC-01"}, "site": SITE}
PATTERN = bytes(range(16))


def sound_items() -> list[tuple[str, bytes, bytes]]:
    """(command, request, answer behind the status) of one whole unit test."""
    found = [("cpu", struct.pack("<I", 7), struct.pack("<4H4HHII", 50, 50, 50, 50, 0, 0, 0, 0, 0, 0, 0))]
    settings = (500, 1000, 2000, 5000)
    found += [("timer", struct.pack("<IB", us, 20), struct.pack("<20IB", *[us + 1] * 20, 20)) for us in settings]
    found += [("memory", _memory(*which, 0), _words(1024, 0)) for which in product((0, 1), (0, 1, 2))]
    for region in (2, 3):
        erases = 5
        for operation in (1, 2, 3, 4):
            erases += operation == 1
            found.append(("memory", _memory(region, 2, operation), _words(1024, erases)))
    found.append(("imu", bytes([50]), imu()))
    found.append(("gps", b"", struct.pack("<BBiiiH", 3, 9, 375_000_100, 1_270_000_000, 80_000, 900)))
    found += [("ad", bytes([dip]), ad(dip)) for dip in range(1, 6)]
    for output, source in permutations((1, 2, 3, 4), 2):
        found += [("io", bytes([output, source, level]), bytes([level, 0])) for level in (0, 1)]
    found.append(("spi", struct.pack("<H", 0xA55A), struct.pack("<HH", 0xA55A, 0xA55A)))
    found.append(("sci", PATTERN, PATTERN))
    return [*found, ("can", struct.pack("<I", 0x123) + PATTERN, struct.pack("<I", 0x123) + PATTERN)]


def imu(rate: int = 100, force_z: int = 100_000, **changes: Any) -> bytes:
    """Means and extremes; LSB of the wire."""
    low = {"gyro": (-20, -20, -20), "accel": (-2, -2, 998)} | changes.get("low", {})
    high = {"gyro": (20, 20, 20), "accel": (2, 2, 1002)} | changes.get("high", {})
    means = struct.pack("<3i3ihh", rate, -rate, 0, 0, 0, force_z, 2512, 2498)
    extremes = struct.pack("<12i", *low["gyro"], *high["gyro"], *low["accel"], *high["accel"])
    return means + extremes + bytes([changes.get("samples", 50)])


def ad(dip: int, **changes: int) -> bytes:
    """Millivolt of the 8 channels with one DIP switch on."""
    volts = {"m1": 2560, "m2": 2470, "m3": 2450, "c1": 0, "c2": 0, "c3": 0, "c4": 0, "c5": 0}
    volts |= {f"c{number}": level for number, level in enumerate((5000, 3300, 1200, 0, 1730), 1) if number == dip}
    return struct.pack("<8h", *(volts | changes).values())


def _memory(region: int, pattern: int, operation: int) -> bytes:
    return struct.pack("<BBBII", region, pattern, operation, 0, 4096)


def _words(checked: int, erases: int) -> bytes:
    return struct.pack("<6I", checked, 0, 0, 0, 0, erases)


def exchange(name: str, sent: bytes, received: bytes, number: int = 0, **changes: Any) -> Exchange:
    """One exchange that takes 10 ms, one every 100 ms."""
    fields: dict[str, Any] = {
        "step": number, "item": name, "name": name, "sequence": number % 256, "attempts": 1,
        "begin_s": 100.0 + 0.1 * number, "end_s": 100.01 + 0.1 * number, "status": 0, "refused": False,
        "sent": sent, "received": received, "conditions": {"unit": "GNC-01"},
    }  # fmt: skip
    return Exchange(**(fields | changes))


def exchanges(unit: str = "GNC-01", first: int = 0) -> list[Exchange]:
    """All exchanges of a sound unit."""
    return [
        exchange(name, sent, received, first + number, conditions={"unit": unit})
        for number, (name, sent, received) in enumerate(sound_items())
    ]


def supply(volts: float | None = 5.01, amperes: float | None = 0.488, unit: str = "GNC-01") -> list[Reading]:
    """Readings of the supply before the tests."""
    about = {"unit": unit}
    return [
        Reading(90.0, 1, "rail_dmm", "measure_voltage", volts, about),
        Reading(91.0, 2, "supply", "measure_current", amperes, about),
    ]


def material(found: list[Exchange], readings: list[Reading] | None = None, **campaign: Any) -> Material:
    """What an analysis sees of these exchanges."""
    layouts = load_frame(FRAME).commands
    return Material(
        rows=(), campaign=CAMPAIGN | campaign, standards={}, exchanges=found, layouts=layouts,
        readings=supply() if readings is None else readings, utc_offset_s=946_684_800.0,
    )  # fmt: skip
