"""Exact exchanges of the time tagger, its blocks written down byte by byte."""

import threading
import zlib
from typing import Any

import pytest
from exchanges import Row, does, exchange, gives, refuses, row
from scripted import BUS_ERROR, CLEAR, TIMEOUT, ScriptedResource, make, refused, scripted

NAME = "pendulum_cnt_91"
IDLE, RUNNING = "STAT:OPER:COND? -> 0", "STAT:OPER:COND? -> 16"
STOP = f"ABOR! | {IDLE}"
LOST = exchange(NAME, "STR:LOST? -> <bus error>")
ASK = b"STR:DATA? 240320\n"

# one block, with line feeds (0a) inside, as they may be in any
BLOCK = bytes.fromhex(
    "a55ac33c"  # sync
    "2c00"  # 44 bytes
    "04000000"  # block 4
    "0a093d0000000000"  # begins at tick 4000010
    "00e1f505"  # 100 MHz
    "07000000"  # 7 events lost
    "0300"  # 3 events
    "93260000"  # tick 1234: beat rises, cosine high
    "70b10000"  # tick 5678: beat falls, cosine low
    "fd0a7a00"  # tick 999775: pick-off rises, cosine low
)
BLOCK += zlib.crc32(BLOCK[4:]).to_bytes(4, "little")


INPUT = ("COUP? -> DC", "SLOP? -> POS", "IMP? -> 1.0E+06", "ATT? -> 1", "FILT? -> 0", "LEV:AUTO? -> 0")
INPUTS = " | ".join(f"{name}:{setting}" for name in ("INP", "INP2") for setting in INPUT)
SEEN = f"ARM:SOUR? -> IMM | {INPUTS}"


def read_back(clock: str, level: str = "+0.00000000E+00") -> str:
    """Level of both inputs, then the clock."""
    return f"INP:LEV? -> {level} | INP2:LEV? -> {level} | STR:CLOC? -> {clock}"


def configuring(level: str = "0.0E+00", clock: str = "1.0E+08") -> str:
    """Configure, up to the read-back."""
    return f"<start> | {STOP} | {SEEN} | INP:LEV {level}! | INP2:LEV {level}! | STR:CLOC {clock}!"


BACK = read_back("100000000")
CONFIGURED = f"{configuring()} | {BACK}"
STARTED = f"{CONFIGURED} | {STOP} | {SEEN} | {BACK} | STR:CLE! | INIT! | {RUNNING}"
CONFIGURE = does("configure", 100e6)
OTHERS = [("INP:LEV?", "+1.0E-02"), ("INP2:LEV?", "-1.0E-02"), ("STR:CLOC?", "50000000")]
ROWS = [
    row(NAME, "the threshold goes to both inputs",
        f"{configuring('-1.25E-01', '2.0E+07')} | {read_back('20000000', '-1.25000000E-01')}",
        does("configure", 20e6, -0.125)),
    row(NAME, "what somebody left is set",
        CONFIGURED.replace("INP2:COUP? ->", "INP2:COUP? -> AC | INP2:COUP DC! | INP2:COUP? ->"), CONFIGURE),
    row(NAME, "nothing is asked before the start", "", gives(b"", "read_stream", 1_000_000)),
    row(NAME, "no other clock is sent", "", refuses("B-INST-008", "10, 20, 50, 100 MHz", "configure", 30e6)),
    row(NAME, "a counter that knows no stream is refused",
        f'{configuring().removesuffix("!")} | SYST:ERR? -> -113,"Undefined header" | <ok>',
        refuses("B-INST-005", "-113 Undefined header", "configure", 100e6),
        refuses("B-INST-010", "configure it first", "start")),
    *[row(NAME, f"{query} reads back different", f"{configuring()} | {BACK.partition(query)[0]}{query} -> {other}",
          refuses("B-INST-011", "", "configure", 100e6)) for query, other in OTHERS],
    row(NAME, "a start without effect is told", f"{STARTED.removesuffix(RUNNING)}{IDLE}", CONFIGURE,
        refuses("B-INST-011", "does not measure", "start")),
    row(NAME, "a stop without effect is told", f"<start> | ABOR! | {RUNNING} | ABOR! | {RUNNING}",
        refuses("B-INST-011", "still measures", "stop"), refuses("B-INST-009", "still measures", "make_safe")),
    row(NAME, "a second start keeps what was not read", f"{STARTED} | {STOP} | {SEEN} | {BACK} | INIT! | {RUNNING}",
        CONFIGURE, does("start"), does("start")),
]  # fmt: skip


@pytest.mark.parametrize("case", ROWS, ids=lambda case: case.claim)
def test_an_exchange(case: Row) -> None:
    case.play()


def started(pairs: Any, **options: Any) -> Any:
    driver = make(NAME, [*exchange(NAME, STARTED), *pairs], **options)
    driver.configure(100e6)
    driver.start()
    return driver


def block(content: bytes) -> bytes:
    length = str(len(content)).encode()
    return b"#%d%s%s\n" % (len(length), length, content)


def test_a_stream_from_configuration_to_its_end() -> None:
    lost = exchange(NAME, f"STR:LOST? -> 7 | {STOP}")
    driver = started([(ASK, block(2 * BLOCK)), *lost, (ASK, block(BLOCK)), (ASK, b"#10\n")])
    assert driver.read_stream(1_000_000) == 2 * BLOCK
    assert driver.events_lost() == 7
    driver.stop()
    assert driver.read_stream(1_000_000) == BLOCK  # what was in the memory when it was stopped
    assert driver.read_stream(1_000_000) == b""
    assert driver.read_stream(1_000_000) == b""  # and then it is asked no more
    assert driver.test_resource.events == []
    assert driver.test_resource.read_termination == "\n"


def test_a_reading_blocks_for_no_longer_and_its_bytes_are_not_in_the_transcript() -> None:
    driver = started([(ASK, block(BLOCK))])
    driver.read_stream(1_000_000)
    assert driver.test_resource.timeouts_ms[-2:] == [700, 700]
    driver = started([(ASK, block(BLOCK))])
    driver.read_stream(1_000_000)
    assert [line[1:3] for line in driver.test_log.lines[-2:]] == [("tx", "STR:DATA? 240320"), ("rx", "<44 bytes>")]


def test_a_full_memory_is_read_in_batches_each_in_parts() -> None:
    full = 5461 * BLOCK  # 240,284 bytes: no other block fits into what was asked
    driver = started([(ASK, block(full)), (b"STR:DATA? 159716\n", block(BLOCK))])
    assert driver.read_stream(400_000) == full + BLOCK
    whole = block(BLOCK)
    driver = started([(ASK, [whole[:1], whole[1:30], whole[30:]])])
    assert driver.read_stream(1_000_000) == BLOCK
    driver = started([(ASK, block(full)), (b"STR:DATA? 159716\n", TIMEOUT), (CLEAR, None), (ASK, TIMEOUT)])
    assert driver.read_stream(400_000) == full
    assert driver.read_stream(400_000) == b""
    with refused("B-INST-001"):
        driver.read_stream(1_000_000)


def test_a_reading_begins_no_other_batch_after_a_tenth_of_a_second() -> None:
    """A tagger that is never empty must not keep its reader: each call of the bus takes 60 ms here."""
    full = 5461 * BLOCK
    driver = started([(ASK, block(full)), (ASK, block(full)), (ASK, b"#10\n")])
    resource = driver.test_resource
    send = resource.write

    def slow(text: str) -> int:
        driver.test_clock.sleep(0.06)
        return int(send(text))

    resource.write = slow
    assert driver.read_stream(1_000_000) == 2 * full
    assert driver.read_stream(1_000_000) == b""


WHOLE = block(BLOCK)


@pytest.mark.parametrize(
    ("part", "came"),
    [*[([WHOLE[:length], TIMEOUT], length - 4) for length in (4, 5, 20, 47)], (WHOLE[:30], 26)],  # 4 bytes of header
)
def test_what_came_before_the_end_of_a_block_is_handed_on(part: Any, came: int) -> None:
    """Whether the bus falls silent or says that it is the end; then the instrument is cleared."""
    driver = started([(ASK, part), (CLEAR, None), (ASK, WHOLE)])
    if came == 0:
        with refused("B-INST-001", "no answer to 'STR:DATA"):
            driver.read_stream(1_000_000)
    else:
        assert driver.read_stream(1_000_000) == BLOCK[:came]
        assert driver.test_log.lines[-1][2] == f"<{came} of 44 bytes>"
    assert driver.read_stream(1_000_000) == b""
    assert driver.read_stream(1_000_000) == BLOCK
    assert driver.test_resource.events == []


@pytest.mark.parametrize(
    ("reply", "why"),
    [
        (b"0,1,2\n", "a block is due"),
        (b"#0" + BLOCK + b"\n", "definite length"),
        (b"#2x4" + BLOCK + b"\n", "no number"),
        (b"#244" + 2 * BLOCK + b"\n", "more than one block"),
    ],
)
def test_what_is_no_block_is_not_understood(reply: bytes, why: str) -> None:
    driver = started([(ASK, reply)])
    with refused("B-INST-004", why):
        driver.read_stream(1_000_000)


def test_a_broken_bus_is_told_and_not_waited_for() -> None:
    driver = started([(ASK, BUS_ERROR)])
    with refused("B-INST-003"):
        driver.read_stream(1_000_000)
    assert driver.test_clock.now_ns() == 0


def test_a_reading_gives_nothing_inside_another_conversation_and_waits_for_no_thread() -> None:
    """Under the virtual clock the reader is called from within the calls of others, this instrument's too."""
    driver = started([(b"STR:LOST?\n", b"0\n")])
    inside: list[bytes] = []
    resource = driver.test_resource
    send = resource.write
    resource.write = lambda text: (inside.append(driver.read_stream(1_000_000)), send(text))[1]
    assert driver.events_lost() == 0
    assert inside == [b""]
    driver = started([])
    found: list[bytes] = []
    with driver.bus.lock:
        thread = threading.Thread(target=lambda: found.append(driver.read_stream(1_000_000)))
        thread.start()
        thread.join(10.0)
    assert found == [b""]


REOPENED = f"<clear> | <start> | {BACK} | {IDLE}"
ANOTHER = "<clear> | *IDN? -> PENDULUM, CNT-91, 7654321, V1.01 28 Jun 2004"


@pytest.mark.parametrize(
    ("answers", "code", "why"),
    [
        (f"<clear> | <start> | {read_back('10000000')}", "B-INST-011", r"STR:CLOC\?' reads back"),
        (REOPENED, "B-INST-011", "does not measure"),
        (ANOTHER, "B-INST-016", "1234567"),
    ],
)
def test_after_a_reopening_the_stream_must_still_run_on_this_tagger(answers: str, code: str, why: str) -> None:
    """The instrument was off for a moment: it answers, set as after power-on."""
    new = ScriptedResource(exchange(NAME, answers))
    driver = started(LOST, rungs={"reopen": lambda: new})
    with refused(code, why):
        driver.events_lost()
    assert new.events == []
    if code == "B-INST-016":
        assert (driver.read_stream(1_000_000), driver.kept) == (b"", ())


def test_a_mute_tagger_is_told_to_stop_all_the_same() -> None:
    with scripted(NAME, exchange(NAME, "<start> | ABOR | SYST:ERR? -> <timeout> | ABOR")) as driver:
        driver.identify()
        with driver.quick(0.5), refused("B-INST-001"):
            driver.make_safe()
