"""Commands with sequence numbers: against a board made for the test, and over a damaged line with the simulated one.

The simulated board counts the erases of its FLASH itself: one that is done twice shows in every later answer.
"""

import struct
from itertools import pairwise

import numpy as np
import pytest
from exchange_rig import (
    ANSWER,
    BUSY,
    IDENTIFY,
    MEMORY,
    REFUSAL,
    SCI,
    UNKNOWN,
    WHO,
    Board,
    VirtualLine,
    context_of,
    events,
    unit_step,
    wire,
)
from gnc_rig import open_host

from bench.model.clock import NS, VirtualClock
from bench.model.errors import BenchError, LinkError, OperatorStop
from bench.plan import Step
from bench.run.context import RunContext
from bench.run.links.unit import Unit
from bench.run.steps.dispatch import execute
from bench.run.stop import Interruption
from sim_instruments.worlds.gnc.world import GncBoard


def echo(number: int, payload: bytes = b"hello", item: str = "sci") -> Step:
    return unit_step(number, "sci", SCI, payload, item)


class Bench:
    """A board on a line under the virtual clock, and the run that talks to it."""

    def __init__(self, *steps: Step) -> None:
        self.clock, self.board = VirtualClock(), Board()
        self.line = VirtualLine(self.clock, self.board)
        self.context: RunContext = context_of(self.clock, self.line, steps)

    def do(self, step: Step) -> None:
        execute(self.context, step)

    @property
    def told(self) -> list[dict[str, object]]:
        return events(self.context, "exchange")


def test_a_test_is_noted_with_everything_that_was_sent_and_received() -> None:
    bench = Bench()
    bench.do(unit_step(4, "sci", SCI, b"\x01\x02", "sci", unit="GNC-1"))
    (told,) = bench.told
    span_ns = int(str(told.pop("end_ns"))) - int(str(told.pop("begin_ns")))
    assert told == {
        "step": 4, "item": "sci", "name": "sci", "role": "rs422", "sequence": 1, "attempts": 1, "status": 0,
        "refused": False, "sent": "0102", "received": "0102", "ignored": 0, "conditions": {"unit": "GNC-1"},
    }  # fmt: skip
    assert 1_000_000 <= span_ns < 50_000_000
    assert events(bench.context, "answer") == []


def test_a_command_that_is_no_test_writes_its_answer_too() -> None:
    bench = Bench()
    bench.do(unit_step(0, "identify", IDENTIFY))
    (answer,) = events(bench.context, "answer")
    assert answer == {"step": 0, "role": "rs422", "name": "identify", "status": 0, "payload": WHO.hex()}
    assert len(bench.told) == 1


def test_the_first_command_of_a_run_cannot_be_taken_for_one_of_the_run_before() -> None:
    """The board still remembers a number; whichever it is, no old answer is given to a new command."""
    for remembered in (0, 1, 2, 255):
        bench = Bench()
        bench.board.take(wire(0x01, remembered, SCI, b"of another run"), 0)
        bench.do(echo(0))
        assert bench.told[0]["received"] == b"hello".hex(), remembered
        assert bench.board.done[SCI, b"hello"] == 1


def test_numbers_go_round_and_each_command_is_done_once() -> None:
    bench = Bench()
    for number in range(600):
        bench.do(echo(number, number.to_bytes(2, "little")))
    assert [one["sequence"] for one in bench.told] == [(1 + number) % 256 for number in range(600)]
    assert set(bench.board.done.values()) == {1}
    assert len(bench.board.done) == 601  # and the one that opens the run


@pytest.mark.parametrize("way", ["passes", "returns"])
def test_a_lost_command_or_answer_is_sent_again_with_its_number_and_nothing_is_done_twice(way: str) -> None:
    bench = Bench()
    lost = (2, 3)  # 1 opens the run
    bench.line.passes = lambda number, frame: b"" if way == "passes" and number in lost else frame
    bench.line.returns = lambda number, frame: [] if way == "returns" and number in lost else [(0.001, frame)]
    bench.do(unit_step(0, "memory", MEMORY, b"erase", "memory"))
    assert len(set(bench.line.written[1:])) == 1
    assert (bench.told[0]["attempts"], bench.told[0]["status"]) == (3, 0)
    assert bench.board.done[MEMORY, b"erase"] == 1
    assert bench.board.repeated == (2 if way == "returns" else 0)


def test_nobody_answers() -> None:
    bench = Bench()
    bench.line.passes = lambda number, frame: b""
    bench.do(echo(0))
    (told,) = bench.told
    assert (told["status"], told["attempts"], told["received"], told["refused"]) == (None, 3, "", False)
    assert bench.clock.now_ns() == pytest.approx(2 * 3 * 0.2 * NS, rel=0.02)  # what opens the run waits as long
    with pytest.raises(LinkError, match=r"B-RUN-022: .*within 3 times 0\.2 s"):
        bench.do(unit_step(1, "identify", IDENTIFY))


@pytest.mark.parametrize(
    ("delay_s", "command"),
    [(0.02, MEMORY), (0.0, SCI)],  # another code with this number; what came before, as of 256 commands ago
)
def test_an_answer_to_another_command_or_from_before_is_not_this_ones(delay_s: float, command: int) -> None:
    bench = Bench()
    bench.do(echo(0))
    bench.line.say(delay_s, wire(ANSWER, 2, command, b"\x00other"))  # the number of the next command
    bench.line.returns = lambda number, frame: [(0.1, frame)]
    bench.do(echo(1, b"mine"))
    assert (bench.told[1]["received"], bench.told[1]["ignored"]) == (b"mine".hex(), 1)


def test_a_beginning_that_nobody_answered_is_made_again() -> None:
    bench = Bench()
    bench.line.passes = lambda number, frame: b"" if number <= 6 else frame  # identify and command, three times each
    bench.do(echo(0))
    bench.do(echo(1))
    assert [frame[7] for frame in bench.line.written] == [IDENTIFY] * 3 + [SCI] * 3 + [IDENTIFY, SCI]
    assert [one["status"] for one in bench.told] == [None, 0]


def test_an_answer_that_arrives_twice_counts_once() -> None:
    """The answer comes after its time-out, so the retry is answered as well, during the next command."""
    bench = Bench()
    bench.line.returns = lambda number, frame: [(0.25 if number == 2 else 0.1, frame)]
    for number, payload in enumerate((b"first", b"second", b"third")):
        bench.do(echo(number, payload))
    assert [one["received"] for one in bench.told] == [text.hex() for text in (b"first", b"second", b"third")]
    assert [one["attempts"] for one in bench.told] == [2, 1, 1]
    assert sum(int(str(one["ignored"])) for one in bench.told) == 1
    assert max(bench.board.done.values()) == 1


def test_a_false_length_stalls_nothing_for_longer_than_a_retry() -> None:
    """The answer seems to be 1,000 bytes longer than it is: it is given up after the silence, the retry is found."""
    bench = Bench()
    bench.line.returns = lambda number, frame: [(0.001, frame if number != 2 else frame[:8] + b"\xf0\x03" + frame[10:])]
    for number in range(4):
        bench.do(echo(number, bytes([number]) * 20))
    assert [one["attempts"] for one in bench.told] == [2, 1, 1, 1]
    assert [one["received"] for one in bench.told] == [(bytes([number]) * 20).hex() for number in range(4)]
    assert bench.board.done[SCI, bytes(20)] == 1


def test_a_refusal_is_an_answer_and_not_sent_again() -> None:
    bench = Bench()
    bench.do(unit_step(0, "unheard_of", 0x66, b"", "anything"))
    (told,) = bench.told
    assert (told["status"], told["refused"], told["attempts"]) == (UNKNOWN, True, 1)
    with pytest.raises(LinkError, match=f"B-RUN-023: .*status {UNKNOWN}"):
        bench.do(unit_step(1, "unheard_of", 0x66))


@pytest.mark.parametrize(("kind", "status"), [(ANSWER, 1), (ANSWER, BUSY), (ANSWER, 5), (REFUSAL, 0)])
def test_a_status_is_noted_for_a_test_and_ends_a_run_otherwise(kind: int, status: int) -> None:
    bench = Bench()
    why = b"" if kind == REFUSAL else b"why"
    bench.board.says = lambda command, payload: (kind, status, why)
    bench.do(echo(0))
    (told,) = bench.told
    assert (told["status"], told["attempts"], told["refused"]) == (status, 1, kind == REFUSAL)
    assert told["received"] == why.hex()
    with pytest.raises(LinkError, match="B-RUN-023"):
        bench.do(echo(1, item=""))


def test_a_stop_is_obeyed_while_an_answer_is_waited_for() -> None:
    bench = Bench()
    bench.line.returns = lambda number, frame: [(0.001 if number == 1 else 100.0, frame)]
    bench.clock.every(1.0, lambda: bench.context.stop.request("the test"))
    with pytest.raises(OperatorStop):
        bench.do(unit_step(0, "sci", SCI, b"", "sci", timeout=1000.0))
    assert bench.clock.now_ns() < 2 * NS


def test_a_hold_waits_for_the_answer() -> None:
    """An erase that was begun is not begun again because somebody wants the run to stand still."""
    bench = Bench()
    bench.line.returns = lambda number, frame: [(0.001 if number == 1 else 3.0, frame)]
    bench.clock.every(1.0, lambda: bench.context.stop.holds.hold("somebody", "coffee"))
    bench.do(unit_step(0, "memory", MEMORY, b"erase", "memory", timeout=10.0))
    assert bench.told[0]["status"] == 0
    with pytest.raises(Interruption):
        bench.context.stop.check()


def test_a_command_that_a_lost_link_broke_off_keeps_its_number() -> None:
    bench = Bench()
    bench.do(echo(0))
    step = unit_step(1, "memory", MEMORY, b"erase", "memory")
    broken_off(bench, step)
    bench.do(step)
    assert bench.board.done[MEMORY, b"erase"] == 1
    assert [one["sequence"] for one in bench.told] == [1, 2]


@pytest.mark.parametrize(("item", "times"), [("memory", 1), ("", 2)])
def test_a_test_that_another_command_has_overtaken_is_not_done_twice(item: str, times: int) -> None:
    """The board remembers the newest number only; behind an identify it would erase again."""
    bench = Bench()
    bench.do(echo(0))
    step = unit_step(1, "memory", MEMORY, b"erase", item)
    broken_off(bench, step)
    reader = bench.context.acquisition.readers["rs422"]
    reader.send(reader.command(IDENTIFY, (), reader.numbers.new()))
    bench.do(step)
    assert bench.board.done[MEMORY, b"erase"] == times
    assert [one["status"] for one in bench.told] == [0, None if item else 0]
    bench.do(echo(2))
    assert bench.told[-1]["status"] == 0
    bench.do(step)  # a point that is taken again, on purpose
    assert bench.board.done[MEMORY, b"erase"] == times + 1


def broken_off(bench: Bench, step: Step) -> None:
    """Lose the port while the answer is on its way, and bring it back; the run stands still meanwhile."""

    def lose(number: int, frame: bytes) -> list[tuple[float, bytes]]:
        bench.line.broken = OSError("the adapter was pulled")
        bench.context.stop.holds.hold("link rs422", "the port is gone")
        return []

    reader = bench.context.acquisition.readers["rs422"]
    reader.kept = True  # somebody brings the port back
    bench.line.returns = lose
    with pytest.raises(Interruption):
        bench.do(step)
    bench.line.broken = None
    reader.found()
    bench.context.stop.holds.release("link rs422")
    bench.line.returns = lambda number, frame: [(0.001, frame)]


def test_a_port_that_is_gone_for_good_ends_the_run() -> None:
    bench = Bench()
    bench.line.broken = OSError("gone")
    with pytest.raises(BenchError) as caught:
        bench.do(echo(0))
    assert caught.value.code in ("B-RUN-020", "B-RUN-024")


def test_units_that_are_swapped_between_tests_are_no_other_unit() -> None:
    asked, tested = unit_step(0, "identify", IDENTIFY), unit_step(1, "identify", IDENTIFY, item="identify")
    bench = Bench(asked, tested)
    unit = Unit(bench.context)
    bench.do(asked)
    bench.board.says = lambda command, payload: (ANSWER, 0, WHO.replace(b"GNC-1", b"GNC-2"))
    bench.do(tested)
    bench.context.stop.check()
    unit.ask()
    bench.clock.sleep(0.1)
    bench.context.acquisition.catch_up()
    assert unit.verdict() == "other"


def test_a_test_is_not_sent_again_after_a_restart_of_the_unit_but_a_command_is() -> None:
    stream = unit_step(0, "stream_start", 0x20, b"\x07\xc8\x00\x00\x00\x00\x00")
    erase = unit_step(1, "memory", MEMORY, b"erase", "memory")
    bench = Bench(stream, erase)
    bench.do(erase)
    assert Unit(bench.context).again(2) == "stream_start"
    assert bench.board.done == {(IDENTIFY, b""): 1, (MEMORY, b"erase"): 1, (0x20, bytes(stream.payload)): 1}


SEED = 23
DAMAGED = 0.05
SPI_FLASH, ERASE, SECTOR = 2, 1, 4096


class DamagedLine:
    """The board's line; one bit of some frames is flipped, on the way there and back."""

    def __init__(self, board: GncBoard) -> None:
        self._board, self._rng, self.flipped = board, np.random.default_rng(SEED), 0

    def _damaged(self, chunk: bytes) -> bytes:
        if not chunk or self._rng.random() >= DAMAGED:
            return chunk
        at = int(self._rng.integers(len(chunk)))
        if len(chunk) > 10 and self._rng.random() < 0.2:
            at = int(self._rng.integers(8, 10))  # the length
        self.flipped += 1
        return chunk[:at] + bytes([chunk[at] ^ 1 << int(self._rng.integers(8))]) + chunk[at + 1 :]

    @property
    def in_waiting(self) -> int:
        return self._board.waiting("rs422")

    def read(self, size: int = 1) -> bytes:
        return self._damaged(self._board.read("rs422", size))

    def write(self, sent: bytes) -> int:
        self._board.write("rs422", self._damaged(sent))
        return len(sent)

    def close(self) -> None:
        return None


@pytest.mark.parametrize("total", [300, pytest.param(2000, marks=pytest.mark.sweep)])
def test_exchanges_with_the_simulated_board_over_a_damaged_line(total: int) -> None:
    with open_host(seed=SEED) as host:
        line = DamagedLine(host.board)
        context = context_of(host.clock, line)
        echoes = {}
        for number in range(total):
            if number % 5 == 0:
                payload = struct.pack("<BBBII", SPI_FLASH, 0, ERASE, 0, SECTOR)
                step = unit_step(number, "memory", MEMORY, payload, "memory", timeout=1.0)
            else:
                echoes[number] = number.to_bytes(3, "little") + bytes(number % 40)
                step = unit_step(number, "sci", SCI, echoes[number], "sci")
            execute(context, step)
    told = events(context, "exchange")
    reported = [one for one in told if one["status"] is None]
    erases = [
        struct.unpack("<6I", bytes.fromhex(one["received"]))[5]
        for one in told
        if one["name"] == "memory" and one["status"] == 0
    ]
    print(f"seed {SEED}: {total} exchanges, {line.flipped} damaged, {len(reported)} reported, {erases[-1]} erases")
    assert len(told) == total
    assert all(
        one["received"] == echoes[one["step"]].hex() for one in told if one["name"] == "sci" and one["status"] == 0
    )
    assert {one["status"] for one in told} <= {0, None}
    assert len(reported) <= 3 + total // 200
    assert sum(one["attempts"] > 1 for one in told) > total // 50
    unanswered = sum(one["name"] == "memory" for one in reported)
    assert total // 5 - unanswered <= erases[-1] <= total // 5, "an erase was done twice"
    assert all(later > before for before, later in pairwise(erases))
