"""Exact exchanges of the calibrator; how a row is read stands in ``tests/support/simulated/exchanges.py``."""

from unittest.mock import ANY

import pytest
from exchanges import Row, does, exchange, gives, refuses, row
from scripted import scripted

NS = 1_000_000_000
NAME = "fluke_5720a"
BACK = "OUT? -> 1.000000E-02,A,0E+00"
UNLOCKED = "RANGELCK OFF!"
OUT = f"<start> | {UNLOCKED} | OUT 1.0E-02 A, 0 HZ!"
SET = f"{OUT} | {BACK}"
READY = f"{SET} | <ok> | {BACK} | ISR? -> 4096"
ON, SETTLED, STANDBY = "ISR? -> 1", "ISR? -> 4097", "ISR? -> 4096"
OUTPUT, OPERATE = does("output", 0.01), does("operate")
OTHER = "OUT? -> {0} | <clear>"
FAULTS = 'FAULT? -> 503 | FAULT? -> 301 | <ok> | EXPLAIN? 503 -> "Over current limit" | EXPLAIN? 301 -> "No such range"'
TRIPPED = f'{STANDBY} | FAULT? -> 505 | <ok> | EXPLAIN? 505 -> "Output tripped to standby"'
KEYS = [(256, "OFFSET active"), (512, "SCALE active"), (768, "OFFSET and SCALE active")]
CURRENTS = [
    (3e-5, "3.0E-05", "3.00000E-05,A,0.0"), (0.1234567, "1.234567E-01", "1.234567E-01,A,0"),
    (0.0, "0.0E+00", "0E+00,A,0E+00"), (2.2, "2.2E+00", "2.2E+00,A,0E+00"),
]  # fmt: skip
STEPS = [
    (3e-5, "3.0E-05", "3.000005E-05", "3.00002E-05"), (1e-3, "1.0E-03", "1.0000005E-03", "1.000002E-03"),
    (0.1, "1.0E-01", "1.0000005E-01", "1.000002E-01"), (1.0, "1.0E+00", "1.0000005E+00", "1.000002E+00"),
]  # fmt: skip

ROWS = [
    row(NAME, "a point from standby to standby",
        f"{READY} | OPER | {ON} | {ON} | {SETTLED} | <ok> | {SETTLED} | <safe>".replace("<start>", "<start> | <safe>"),
        does("standby"), OUTPUT, OPERATE, gives(True, "operating"), does("standby"),
        leaves={"test_clock.now_ns": NS // 2, "identity.model": "5720A", "identity.serial": "7005201"}),
    *[row(NAME, f"{current} A goes out in full and in ampere",
          f"<start> | RANGELCK ON! | OUT {sent} A, 0 HZ! | OUT? -> {reply}", does("output", current, "locked"))
      for current, sent, reply in CURRENTS],
    *[row(NAME, f"set-point {reply} is noticed", f"{OUT} | OUT? -> {reply}",
          refuses("B-INST-011", "reads back", "output", 0.01)) for reply in ("1.1E-02,A,0", "0,A,0", "-1.0E-02,A,0")],
    *[row(NAME, f"{current} A agrees within a step of its range",
          "<start> | " + " | ".join(f"{UNLOCKED} | OUT {sent} A, 0 HZ! | OUT? -> {back},A,0" for back in (near, far)),
          does("output", current), refuses("B-INST-011", "", "output", current), refuses("B-INST-010", "", "operate"))
      for current, sent, near, far in STEPS],
    *[row(NAME, f"{reply} is no direct current",
          f"{OUT} | {OTHER.format(reply)} | <ok> | {OTHER.format(reply)} | <ok> | {OTHER.format(reply)}",
          refuses("B-INST-004", "", "output", 0.01)) for reply in ("1.0E-02,V,0", "1.0E-02,A,50", "1.0E-02")],
    row(NAME, "faults are read to the end and explained", f"<start> | RANGELCK OFF | {FAULTS}",
        refuses("B-INST-005", "503 Over current limit; 301 No such range", "output", 0.01)),
    row(NAME, "nothing operates without an output", "", refuses("B-INST-010", "", "operate")),
    row(NAME, "nothing operates with a fault", f'{SET} | FAULT? -> 77 | <ok> | EXPLAIN? 77 -> "x"', OUTPUT,
        refuses("B-INST-005", "", "operate")),
    row(NAME, "nothing operates at another set-point", f"{SET} | <ok> | OUT? -> 2.0E-02,A,0", OUTPUT,
        refuses("B-INST-011", "", "operate")),
    *[row(NAME, f"one left with {keys} is refused", f"<start:2> | ISR? -> {4096 | bits}",
          refuses("B-INST-019", f"(?s){keys}.*press LOCAL, then {keys.removesuffix(' active')} at", "identify"))
      for bits, keys in KEYS],
    *[row(NAME, f"nothing operates with {keys}", f"{SET} | <ok> | {BACK} | ISR? -> {4096 | bits}", OUTPUT,
          refuses("B-INST-019", keys, "operate")) for bits, keys in KEYS],
    row(NAME, "an offset that comes while it settles", f"{READY} | OPER | {ON} | ISR? -> 257 | STBY", OUTPUT,
        refuses("B-INST-019", "OFFSET", "operate")),
    row(NAME, "a scale factor that comes later", "<start> | ISR? -> 4609", refuses("B-INST-019", "SCALE", "operating")),
    row(NAME, "one that is refused is made safe all the same and not taken for prepared",
        f"<start:2> | ISR? -> 4353 | STBY | <start:1> | STBY! | ISR? -> 4352 | <start> | {SETTLED}",
        does("make_safe"), gives(True, "operating")),
    row(NAME, "what trips ends in standby", f"{READY} | OPER | {ON} | {TRIPPED} | STBY", OUTPUT,
        refuses("B-INST-013", "Output tripped to standby", "operate")),
    row(NAME, "what never settles ends in standby", " | ".join([READY, "OPER", *[ON] * 61, "STBY"]), OUTPUT,
        refuses("B-INST-012", "", "operate"), leaves={"test_clock.now_ns": 15 * NS}),
    row(NAME, "OPER is never sent twice",
        f"{READY} | OPER | ISR? -> <timeout> | <silent> | <ok> | {SETTLED} | <ok>", OUTPUT, OPERATE),
    row(NAME, "still operating is not safe", f"<start> | STBY! | {SETTLED}", refuses("B-INST-009", "", "make_safe")),
    row(NAME, "its input buffer is not overrun", f"<start> | {'X' * 127}", does("raw", "X" * 127),
        refuses("B-INST-014", "", "raw", "X" * 128)),
    row(NAME, "how long it has been on and how old its zeros are", "<start> | ONTIME? -> 95 | CAL_DAYS? ZERO -> 12",
        gives(95 * 60, "time_on_s"), gives((12.0, 30.0, "days", ANY), "self_calibration")),
]  # fmt: skip


@pytest.mark.parametrize("case", ROWS, ids=lambda case: case.claim)
def test_an_exchange(case: Row) -> None:
    case.play()


def test_a_trip_during_the_dwell_is_seen_and_its_fault_kept() -> None:
    with scripted(
        NAME, exchange(NAME, f'<start> | {STANDBY} | FAULT? -> 505 | <ok> | EXPLAIN? 505 -> "Tripped"')
    ) as driver:
        assert driver.operating() is False
        assert ("rx", '"Tripped"') in [line[1:3] for line in driver.test_log.lines]
