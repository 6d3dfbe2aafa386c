"""The way to the safe state: in order, again and again, and sure of who was away only by a second answer."""

from __future__ import annotations

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InstrumentError
from bench.run.bench.safety import LATE_S, PAUSE_S, QUICK_S, WayToSafe, make_safe, states_of


class Instrument:
    """Fails with each error of a list in turn (None: it answers), then answers for good."""

    def __init__(self, clock: VirtualClock, *errors: str) -> None:
        self._clock, self._errors = clock, list(errors)
        self.calls_s: list[float] = []

    def make_safe(self) -> None:
        self.calls_s.append(self._clock.now_ns() / NS)
        if self._errors and (code := self._errors.pop(0)):
            raise InstrumentError(code, "nobody there")


def test_everybody_is_told_in_order_and_who_answers_at_once_is_done() -> None:
    clock = VirtualClock()
    bench = {role: Instrument(clock) for role in ("supply", "switch", "calibrator")}
    assert make_safe(bench, ("calibrator", "switch"), clock) == []  # type: ignore[arg-type]
    assert [len(one.calls_s) for one in bench.values()] == [1, 1, 1]
    assert list(WayToSafe(bench, ("calibrator", "switch"), clock).left) == ["calibrator", "switch", "supply"]


def test_who_was_away_is_confirmed_by_a_second_answer() -> None:
    """What it was told before it was away may come late: between the answers it has time to take effect."""
    clock = VirtualClock()
    calibrator = Instrument(clock, "B-INST-003", "")
    way = WayToSafe({"calibrator": calibrator}, (), clock)
    way.attempt()
    assert way.left == {"calibrator": "unreachable"}
    clock.sleep(1.0)
    way.attempt()
    assert (way.left, way.failures) == ({"calibrator": "commanded"}, {})
    way.attempt()  # too soon: it is not even asked
    assert calibrator.calls_s == [0.0, 1.0]
    clock.sleep(LATE_S)
    way.attempt()
    assert way.left == {}


def test_what_fails_to_the_end_is_told_with_what_is_known_of_it() -> None:
    clock, live = VirtualClock(), []
    gone, mute = Instrument(clock, *["B-RUN-002"] * 9), Instrument(clock, *["B-INST-001"] * 9)
    failures = make_safe({"gone": gone, "mute": mute}, (), clock, live=live.append)  # type: ignore[arg-type]
    assert states_of(failures) == {"gone": "unreachable", "mute": "commanded"}
    assert {failure.code for failure in failures} == {"B-RUN-060"}
    assert len(live) >= 4  # a guard takes a silence of 1.5 s for a run that hangs
    assert PAUSE_S / 4 < 1.5 > QUICK_S
