"""Unit tests of a GNC module as a stranger records them: commands and answers of frames/gnc_422.yaml by ``struct``."""

from __future__ import annotations

import struct
from itertools import permutations

from stranger_page import Session, documented_campaign, shipped

SUPPLY_V, SUPPLY_A, WIDTH_m = 5.05, 0.48, 0.0258
SERIAL = b"7".ljust(12)
_RESIST = struct.pack("<3i3i2h3i3i3i3iB", *(20, -40, 60, 100, -200, 100_100), 2510, 2520, *(-9,) * 3, *(9,) * 3,
                      *(-3, -3, 995), *(3, 3, 1006), 50)  # fmt: skip


class _Board:
    def __init__(self, session: Session) -> None:
        self.session, self.t_s, self.step = session, 10.0, 100

    def test(self, item: str, sent: bytes, received: bytes) -> None:
        """One command of a test item and its answer."""
        self.step, self.t_s = self.step + 1, self.t_s + 0.5
        self.session.event(
            "exchange", self.t_s, step=self.step, item=item, name=item, role="rs422", sequence=self.step % 256,
            attempts=1, begin_ns=round(1e9 * self.t_s), end_ns=round(1e9 * (self.t_s + 0.1)), status=0, refused=False,
            sent=sent.hex(), received=received.hex(), ignored=0, conditions={},
        )  # fmt: skip


def module_session(dead_line: bool = False) -> Session:
    """Every item of a sound module; ``dead_line``: IO 1 does not reach IO 2 at level 1."""
    session = Session(
        documented_campaign("imu_calibration") | {"analysis": "gnc_unit_test"}, {"rs422": shipped("gnc_422")}
    )
    session.event(
        "prompt", 1.0, step=1, text="Width?", confirm="measured", by="me", value=WIDTH_m, unit="m", low=None,
        high=0.026, quantity="width", conditions={},
    )  # fmt: skip
    session.reading(2.0, "supply", "measure_voltage", SUPPLY_V)
    session.reading(3.0, "supply", "measure_current", SUPPLY_A)
    board = _Board(session)
    board.test("identify", b"", struct.pack("<B12s12sH", 1, b"BOARD".ljust(12), SERIAL, 3))
    board.test("cpu", struct.pack("<I", 1), struct.pack("<4H4HHII", *(100,) * 4, *(0,) * 4, 0, 0, 0))
    for setting_us in (500, 1000, 2000, 5000):
        board.test("timer", struct.pack("<IB", setting_us, 20), struct.pack("<20IB", *(setting_us,) * 20, 20))
    _memory(board)
    board.test("imu", b"\x32", _RESIST)
    board.test("gps", b"", struct.pack("<BBiiiH", 3, 7, 375_000_000, 1_270_000_000, 100_000, 900))
    for dip in (1, 2, 3, 4):
        volts = [2540, 2500, 2440, *(mV * (dip == k + 1) for k, mV in enumerate((5000, 3300, 1200, 0))), 700]
        board.test("ad", bytes([dip]), struct.pack("<8h", *volts))
    for output, source in permutations((1, 2, 3, 4), 2):
        for level in (0, 1):
            read = 0 if dead_line and (output, source) == (1, 2) else level
            board.test("io", bytes([output, source, level]), bytes([read, 0]))
    board.test("spi", b"\x5a\xa5", b"\x5a\xa5\x5a\xa5")
    board.test("sci", b"stranger", b"stranger")
    board.test("can", struct.pack("<I", 291) + b"stranger", struct.pack("<I", 291) + b"stranger")
    return session


def _memory(board: _Board) -> None:
    """Three patterns in RAM and SDRAM; each FLASH erased, blank, programmed, verified."""
    for region, patterns, operations in (
        (0, (0, 1, 2), (0,)),
        (1, (0, 1, 2), (0,)),
        (2, (1,), (1, 2, 3, 4)),
        (3, (1,), (1, 2, 3, 4)),
    ):
        for pattern in patterns:
            for operation in operations:
                sent = struct.pack("<BBBII", region, pattern, operation, 0, 4096)
                board.test("memory", sent, struct.pack("<6I", 1024, 0, 0, 0, 0, int(region > 1)))
