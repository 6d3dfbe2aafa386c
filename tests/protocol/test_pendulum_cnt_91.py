"""Exact exchanges of the time tagger, its blocks written down byte by byte."""

import threading
import zlib
from typing import Any

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after
from scripted import BUS_ERROR, CLEAR, TIMEOUT, ScriptedResource, make, refused, scripted

from bench.model.errors import InputError

NAME = "pendulum_cnt_91"
START = IDENTIFY[NAME]
IDLE = (b"STAT:OPER:COND?\n", b"0\n")
RUNNING = (b"STAT:OPER:COND?\n", b"16\n")
STOP = [*after(b"ABOR\n"), IDLE]
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


def read_back(clock: bytes, level: bytes = b"+0.00000000E+00") -> list[tuple[bytes, bytes]]:
    """Clock, then coupling and level of both inputs."""
    inputs = [
        pair
        for name in (b"INP", b"INP2")
        for pair in ((name + b":COUP?\n", b"DC\n"), (name + b":LEV?\n", level + b"\n"))
    ]
    return [(b"STR:CLOC?\n", clock + b"\n"), *inputs]


def configuring(level: bytes = b"0.0E+00", clock: bytes = b"1.0E+08") -> list[tuple[bytes, bytes | None]]:
    """Configure, up to the read-back."""
    inputs = [
        pair
        for name in (b"INP", b"INP2")
        for setting in (b"COUP DC", b"SLOP POS", b"IMP 1E6", b"ATT 1", b"FILT OFF", b"LEV:AUTO OFF", b"LEV " + level)
        for pair in after(name + b":" + setting + b"\n")
    ]
    return [*START, *STOP, *after(b"INIT:CONT OFF\n"), *inputs, *after(b"STR:CLOC " + clock + b"\n")]


CONFIGURED = [*configuring(), *read_back(b"100000000")]
STARTED = [
    *CONFIGURED, *STOP, *read_back(b"100000000"), *after(b"STR:CLE\n"), *after(b"INIT\n"), RUNNING,
]  # fmt: skip


def started(pairs: Any, **options: Any) -> Any:
    driver = make(NAME, [*STARTED, *pairs], **options)
    driver.configure(100e6)
    driver.start()
    return driver


def block(content: bytes) -> bytes:
    length = str(len(content)).encode()
    return b"#%d%s%s\n" % (len(length), length, content)


def test_a_stream_from_configuration_to_its_end() -> None:
    driver = started([(ASK, block(2 * BLOCK)), (b"STR:LOST?\n", b"7\n"), *STOP, (ASK, block(BLOCK)), (ASK, b"#10\n")])
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


def test_threshold_goes_to_both_inputs() -> None:
    script = [*configuring(b"-1.25E-01", b"2.0E+07"), *read_back(b"20000000", b"-1.25000000E-01")]
    with scripted(NAME, script) as driver:
        driver.configure(20e6, -0.125)
        assert driver.configured == (20e6, -0.125)


def test_nothing_is_asked_before_the_start_and_no_other_clock_is_sent() -> None:
    with scripted(NAME, []) as driver:
        assert driver.read_stream(1_000_000) == b""
    with scripted(NAME, []) as driver, refused("B-INST-008", "10, 20, 50, 100 MHz"):
        driver.configure(30e6)


def test_a_counter_that_knows_no_stream_is_refused() -> None:
    errors = [(b"SYST:ERR?\n", b'-113,"Undefined header"\n'), NO_ERROR]
    script = [*configuring()[:-1], *errors]
    with scripted(NAME, script) as driver:
        with refused("B-INST-005", "-113 Undefined header"):
            driver.configure(100e6)
        with refused("B-INST-010", "configure it first"):
            driver.start()


@pytest.mark.parametrize("wrong", range(5))
def test_a_setting_that_reads_back_different(wrong: int) -> None:
    replies = [b"50000000\n", b"AC\n", b"+1.0E-02\n", b"AC\n", b"-1.0E-02\n"]
    found = read_back(b"100000000")[: wrong + 1]
    found[-1] = (found[-1][0], replies[wrong])
    with scripted(NAME, [*configuring(), *found]) as driver, refused("B-INST-011"):
        driver.configure(100e6)


def test_a_start_or_a_stop_without_effect_is_told() -> None:
    script = [*STARTED[:-1], IDLE]
    with scripted(NAME, script) as driver:
        driver.configure(100e6)
        with refused("B-INST-011", "does not measure"):
            driver.start()
    with scripted(NAME, [*START, *after(b"ABOR\n"), RUNNING, *after(b"ABOR\n"), RUNNING]) as driver:
        with refused("B-INST-011", "still measures"):
            driver.stop()
        with refused("B-INST-009", "still measures"):
            driver.make_safe()


def test_a_second_start_keeps_what_was_not_read() -> None:
    again = [*STOP, *read_back(b"100000000"), *after(b"INIT\n"), RUNNING]
    driver = started(again)
    driver.start()
    assert driver.test_resource.events == []


def test_a_full_memory_is_read_in_batches_each_in_parts() -> None:
    full = 5461 * BLOCK  # 240,284 bytes: no other block fits into what was asked
    driver = started([(ASK, block(full)), (b"STR:DATA? 159716\n", block(BLOCK))])
    assert driver.read_stream(400_000) == full + BLOCK
    whole = block(BLOCK)
    driver = started([(ASK, [whole[:1], whole[1:30], whole[30:]])])
    assert driver.read_stream(1_000_000) == BLOCK
    full = 5461 * BLOCK
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


@pytest.mark.parametrize("came", [4, 5, 20, 47])
def test_what_came_before_a_time_out_is_handed_on(came: int) -> None:
    """The header has 4 bytes."""
    driver = started([(ASK, [block(BLOCK)[:came], TIMEOUT]), (CLEAR, None), (ASK, block(BLOCK))])
    if came == 4:
        with refused("B-INST-001", "no answer to 'STR:DATA"):
            driver.read_stream(1_000_000)
    else:
        assert driver.read_stream(1_000_000) == BLOCK[: came - 4]
        assert driver.test_log.lines[-1][2] == f"<{came - 4} of 44 bytes>"
    assert driver.read_stream(1_000_000) == b""  # meanwhile the instrument is cleared
    assert driver.read_stream(1_000_000) == BLOCK
    assert driver.test_resource.events == []


def test_a_block_that_ends_early_is_handed_on() -> None:
    driver = started([(ASK, block(BLOCK)[:30]), (CLEAR, None), (ASK, block(BLOCK))])
    assert driver.read_stream(1_000_000) == BLOCK[:26]
    assert driver.read_stream(1_000_000) == b""
    assert driver.read_stream(1_000_000) == BLOCK


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


def test_after_a_reopening_the_stream_must_still_run_on_this_tagger() -> None:
    """The instrument was off for a moment: it answers, set as after power-on."""
    new = ScriptedResource([(CLEAR, None), *START, *read_back(b"10000000")[:1]])
    question = (b"STR:LOST?\n", BUS_ERROR)
    driver = started([question], rungs={"reopen": lambda: new})
    with refused("B-INST-011", r"STR:CLOC\?' reads back"):
        driver.events_lost()
    assert new.events == []
    new = ScriptedResource([(CLEAR, None), *START, *read_back(b"100000000"), IDLE])
    driver = started([(b"STR:LOST?\n", BUS_ERROR)], rungs={"reopen": lambda: new})
    with refused("B-INST-011", "does not measure"):
        driver.events_lost()
    new = ScriptedResource([(CLEAR, None), (b"*IDN?\n", b"PENDULUM, CNT-91, 7654321, V1.01 28 Jun 2004\n")])
    driver = started([(b"STR:LOST?\n", BUS_ERROR)], rungs={"reopen": lambda: new})
    with refused("B-INST-016"):
        driver.events_lost()
    assert driver.read_stream(1_000_000) == b""
    assert driver.configured is None


def test_a_mute_tagger_is_told_to_stop_all_the_same() -> None:
    script = [*START, (b"ABOR\n", None), (b"SYST:ERR?\n", TIMEOUT), (b"ABOR\n", None)]
    with scripted(NAME, script) as driver:
        driver.identify()
        with driver.quick(0.5), refused("B-INST-001"):
            driver.make_safe()


@pytest.mark.parametrize("value", [1001.0, "1", True, float("nan")])
def test_an_impossible_clock_error_is_refused(value: object) -> None:
    with pytest.raises(InputError, match="clock_error_ppm") as caught:
        make(NAME, [], clock_error_ppm=value)
    assert caught.value.code == "B-INST-020"


@pytest.mark.parametrize("address", ["TCPIP0::10.0.0.1::5025::SOCKET", "ASRL1::INSTR"])
def test_a_bus_without_end_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ScriptedResource, "resource_name", address)
    with pytest.raises(InputError, match="raw socket") as caught:
        make(NAME, [])
    assert caught.value.code == "B-INST-020"
