"""The unit tests of a GNC module as a person would judge them from the paper, for tests of the simulated module.

Written from Tables 1 and 3 of paper 001 and the commands' layouts, apart from the analysis of the product.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from gnc_rig import DMM, SUPPLY, Host

SIZES = (65_536, 1_048_576, 524_288, 262_144)  # RAM, SDRAM, SPI FLASH, internal FLASH
ITEMS = ("supply", "identify", "cpu", "timer", "memory", "imu", "gps", "ad", "io", "spi", "sci", "can")


def failed_items(host: Host) -> tuple[set[str], float]:
    """Supply the module and test everything: items that fail, seconds from the first command to the last answer."""
    supply, meter = host.instrument(SUPPLY), host.instrument(DMM)
    for message in ("VOLT 5", "CURR 0.6", "OUTP ON"):
        supply.write(message)
    began_ns = host.clock.now_ns()
    host.clock.sleep(0.5)
    board_V, current_A = float(meter.query("READ?")), float(supply.query("MEAS:CURR?"))
    good = {"supply": abs(board_V / 5.0 - 1) <= 0.05 and abs(current_A / 0.49 - 1) <= 0.05}
    host.clock.sleep_until_ns(max(host.clock.now_ns(), began_ns + 1_210_000_000))
    first_ns = host.clock.now_ns()
    for item, judge in JUDGES.items():
        good[item] = judge(host)
    assert tuple(good) == ITEMS
    return {item for item, passed in good.items() if not passed}, (host.clock.now_ns() - first_ns) / 1e9


def _identify(host: Host) -> bool:
    status, found = host.ask(0x01)
    return status == 0 and found[13:25].decode().strip() == host.board.module.serial


def _cpu(host: Host) -> bool:
    status, found = host.ask(0x10, "I", 305419896)
    return status == 0 and struct.unpack("<9H2I", found) == (256, 256, 256, 256, 0, 0, 0, 0, 0, 0, 0)


def _timer(host: Host) -> bool:
    good = True
    for setting_us in (500, 1000, 2000, 5000):
        status, found = host.ask(0x11, "IB", setting_us, 20)
        *intervals_us, interrupts = struct.unpack("<20IB", found) if status == 0 else (0,)
        good &= interrupts == 20 and all(abs(us / setting_us - 1) <= 0.01 for us in intervals_us)
    return good


def _memory(host: Host) -> bool:
    good = True
    steps = [(region, pattern, 0) for region in (0, 1) for pattern in (0, 1, 2)]
    steps += [(region, 2, operation) for region in (2, 3) for operation in (1, 2, 3, 4)]
    for region, pattern, operation in steps:
        status, found = host.ask(0x12, "3B2I", region, pattern, operation, 0, SIZES[region])
        numbers = struct.unpack("<6I", found) if status in (0, 1) else (0,)
        good &= status == 0 and numbers[0] == SIZES[region] // 4 and numbers[1] == 0 and numbers[5] == (region > 1)
    return good


def _imu(host: Host) -> bool:
    status, found = host.ask(0x13, "B", 50)
    if status != 0:
        return False
    n = struct.unpack("<6i2h12iB", found)
    rates, force = [v * 5e-5 for v in n[:3]], [v * 1e-5 for v in n[3:6]]
    alive = any(low != high for low, high in zip(n[8:11] + n[14:17], n[11:14] + n[17:20], strict=True))
    at_rest = all(abs(rate) < 1.0 for rate in rates) and abs(sum(g * g for g in force) ** 0.5 - 1.0) < 0.1
    return alive and at_rest and all(-40 <= t / 100 <= 85 for t in n[6:8]) and n[20] == 50


def _gps(host: Host) -> bool:
    status, found = host.ask(0x14)
    if status != 0:
        return False
    fix, satellites, latitude, longitude, height, _ = struct.unpack("<2B3iH", found)
    near = abs(latitude * 1e-7 - 34.2) < 1e-3 and abs(longitude * 1e-7 - 108.9) < 1e-3 and abs(height / 1e3 - 400) < 50
    return fix == 3 and satellites >= 4 and near


def _ad(host: Host) -> bool:
    good = True
    for switch, due_V in ((0, None), (1, 5.0), (2, 3.3), (3, 1.2), (4, 0.0), (5, None)):
        host.world.operate("dip_switch", switch)
        status, found = host.ask(0x15, "B", switch)
        volts = [mV / 1000 for mV in struct.unpack("<8h", found)] if status == 0 else [9.0] * 8
        off = [volts[2 + other] for other in range(1, 6) if other != switch]
        good &= all(abs(v) <= 0.1 for v in off) and all(abs(v - 2.5) <= 0.3 for v in volts[:3])
        good &= due_V is None or abs(volts[2 + switch] - due_V) <= max(0.02 * due_V, 0.1 if due_V == 0 else 0)
    host.world.operate("dip_switch", 0)
    return good


def _io(host: Host) -> bool:
    pairs = [(out, into) for out in (1, 2, 3, 4) for into in (1, 2, 3, 4) if out != into]
    answers = [(host.ask(0x16, "3B", *pair, level), level) for pair in pairs for level in (0, 1)]
    return all(answer == (0, bytes([level, 0])) for answer, level in answers)


def _spi(host: Host) -> bool:
    return all(host.ask(0x17, "H", w) == (0, struct.pack("<2H", w, w)) for w in (0x5555, 0xAAAA, 0x00FF, 0x1234))


def _sci(host: Host) -> bool:
    pattern = bytes.fromhex("55 aa 00 ff 01 02 04 08 10 20 40 80 eb 90 11 13")
    return host.ask(0x18, extra=pattern) == (0, pattern)


def _can(host: Host) -> bool:
    pattern = bytes.fromhex("55 aa 00 ff 12 34 56 78")
    sent = [struct.pack("<I", identifier) + pattern for identifier in (0x123, 0x1ABCDEF0)]
    return all(host.ask(0x19, extra=one) == (0, one) for one in sent)


JUDGES: dict[str, Callable[[Host], bool]] = {
    "identify": _identify, "cpu": _cpu, "timer": _timer, "memory": _memory, "imu": _imu, "gps": _gps, "ad": _ad,
    "io": _io, "spi": _spi, "sci": _sci, "can": _can,
}  # fmt: skip
