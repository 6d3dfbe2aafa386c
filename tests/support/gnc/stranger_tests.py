"""Unit tests of a GNC module as a stranger records them: commands and answers of frames/gnc_422.yaml by ``struct``."""

from __future__ import annotations

import struct

from gnc_exchanges import sound_items
from stranger_page import Session, documented_campaign, shipped

SUPPLY_V, SUPPLY_A, WIDTH_m = 5.05, 0.48, 0.0258


def module_session(dead_line: bool = False) -> Session:
    """Every item of a sound module; ``dead_line``: IO 1 does not reach IO 2 at level 1."""
    campaign = documented_campaign("imu_calibration") | {"analysis": "gnc_unit_test"}
    session = Session(campaign, {"rs422": shipped("gnc_422")})
    session.event(
        "prompt", 1.0, step=1, text="Width?", confirm="measured", by="me", value=WIDTH_m, unit="m", low=None,
        high=0.026, quantity="width", conditions={},
    )  # fmt: skip
    session.reading(2.0, "supply", "measure_voltage", SUPPLY_V)
    session.reading(3.0, "supply", "measure_current", SUPPLY_A)
    identity = struct.pack("<B12s12sH", 1, b"BOARD".ljust(12), b"7".ljust(12), 3)
    for number, (item, sent, received) in enumerate([("identify", b"", identity), *sound_items()], 101):
        answer = b"\0\0" if dead_line and (item, sent) == ("io", b"\1\2\1") else received
        at_s = 10.0 + 0.5 * (number - 100)
        session.event(
            "exchange", at_s, step=number, item=item, name=item, role="rs422", sequence=number % 256, attempts=1,
            begin_ns=round(1e9 * at_s), end_ns=round(1e9 * (at_s + 0.1)), status=0, refused=False, sent=sent.hex(),
            received=answer.hex(), ignored=0, conditions={},
        )  # fmt: skip
    return session
