"""After a hold nothing is energised before somebody at the bench arms it, or the station says why nobody does."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from run_rig import HoldRig, Passive, sound

from bench.model.ports import Effect, action
from bench.plan import InterlockRule, compile_sequence
from bench.run.context import RunContext
from bench.run.control.asking import AT_BENCH, WaitingOperator
from bench.run.control.channel import Control
from bench.run.hold import LIMIT_S, energised_again
from bench.run.sequencer import Outcome
from bench.run.watch.interlocks import InterlockWatch

ROOT = Path(__file__).resolve().parents[4]
HOT = InterlockRule(
    name="hot", signal="chamber_air", of="", channel=None, unit="degC", high=50.0, low=None, release_high=45.0,
    release_low=None, dwell_s=600.0, release_after_s=0.0, stale_s=None, action="hold", where="",
)  # fmt: skip


class Supply(Passive):
    """A supply of the unit, which a hold leaves on."""

    @action(effect=Effect.POWER)
    def output_on(self) -> None:
        self._call("output_on")


class Bench(HoldRig):
    """A bench with two points that holds at 8 s; people reach it through its control socket."""

    def __init__(self, folder: Path, points: int = 2) -> None:
        super().__init__(folder, points)
        self.replies: list[dict[str, Any]] = []
        self.waiting = self.operator = WaitingOperator(None)  # type: ignore[assignment]
        self.waiting.reachable = True
        self.at(8.0, lambda: self.say("pause", "bench", reason="door"))

    def say(self, command: str, place: str, **words: Any) -> dict[str, Any]:
        reply = self.control.answer({"command": command, "place": place, "by": "kim", **words}, "root (process 1)")
        self.replies.append(reply)
        return reply

    def asked(self) -> dict[str, Any] | None:
        return self.waiting.document(lambda t_ns: t_ns / 1e9)

    def carried_out(self, *besides: Callable[[RunContext], AbstractContextManager[object]]) -> Outcome:
        @contextmanager
        def people(context: RunContext) -> Iterator[None]:
            self.waiting.attach(context)
            self.control = Control(context, None, self.waiting)
            yield

        return self.run_beside(people, *besides)

    def energised_s(self) -> list[float]:
        """When the source was switched on after it had been made safe."""
        return [at_s for at_s in self.called("source.operate") if at_s > self.called("source.make_safe")[0]]


def test_a_hold_that_ends_by_itself_waits_to_be_armed_at_the_bench(tmp_path: Path) -> None:
    rig = Bench(tmp_path)
    rig.at(40.0, lambda: rig.say("resume", "afar"))
    asked: list[Any] = []
    rig.at(100.0, lambda: asked.append(rig.asked()))
    rig.at(100.0, lambda: rig.say("answer", "afar", value=True))
    rig.at(100.0, lambda: rig.say("answer", "nowhere", value=True))  # what is not the bench is afar
    rig.at(300.0, lambda: rig.say("answer", "bench", value=True))
    assert rig.carried_out().error is None
    sound(rig, 2)
    assert rig.energised_s()[0] == pytest.approx(300.0, abs=1.0)
    (question,) = asked
    assert (question["presence"], question["arms"]) == ("bench", True)
    assert question["text"] == "Waits to be armed at the bench; energised or moved again: source"
    assert [reply["ok"] for reply in rig.replies] == [True, True, False, False, True]
    assert {reply["error"] for reply in rig.replies if not reply["ok"]} == {AT_BENCH}
    told = [(event["what"], event["place"], event["ok"]) for event in rig.events("control")]
    assert told == [
        ("pause", "bench", True), ("resume", "afar", True), ("answer", "afar", False), ("answer", "afar", False),
        ("answer", "bench", True),
    ]  # fmt: skip
    (armed,) = rig.events("armed")
    assert armed["by"] == "kim via root (process 1)"
    assert [event["what"] for event in rig.events("alarm")] == ["prompt"]  # so that people are notified
    (release,) = rig.events("release")
    assert release["seconds"] == pytest.approx(300.0 - 8.0, abs=8.0)


def test_a_resume_at_the_bench_does_not_arm_what_holds_for_another_reason(tmp_path: Path) -> None:
    rig = Bench(tmp_path)
    rig.at(20.0, lambda: rig.stop.holds.hold("link", "port_a is gone"))
    rig.at(40.0, lambda: rig.say("resume", "bench"))
    rig.at(100.0, lambda: rig.stop.holds.release("link"))
    rig.at(300.0, lambda: rig.say("answer", "bench", value=True))
    assert rig.carried_out().error is None
    assert rig.energised_s()[0] == pytest.approx(300.0, abs=1.0)


def test_the_station_may_say_why_nobody_arms(tmp_path: Path) -> None:
    rig = Bench(tmp_path)
    rig.never_armed = "locked enclosure"
    rig.at(40.0, lambda: rig.say("resume", "afar"))
    assert rig.carried_out().error is None
    sound(rig, 2)
    assert rig.energised_s()[0] == pytest.approx(40.0, abs=1.0)
    assert [event["reason"] for event in rig.events("armed")] == ["locked enclosure"]
    assert any("locked enclosure" in text for text in rig.listener.messages)


def test_what_stays_on_in_a_hold_needs_nobody(tmp_path: Path) -> None:
    rig = Bench(tmp_path, 0)
    rig.instruments = {"supply": Supply("supply", rig), "meter": Passive("meter", rig)}
    rig.step("call", "supply", "output_on")
    rig.step("settle", duration_s=30.0, bus_s=0.0)
    rig.step("call", "supply", "output_on")
    rig.at(40.0, lambda: rig.say("resume", "afar"))
    assert rig.carried_out().error is None
    assert rig.events("hold")
    assert rig.events("armed") == []
    assert len(rig.called("supply.output_on")) == 2
    rig = Bench(tmp_path, 0)
    rig.instruments = {"supply": Supply("supply", rig)}
    rig.step("settle", duration_s=30.0, bus_s=0.0)
    rig.step("call", "supply", "output_on")  # off until here: somebody may have his hands at it
    rig.at(40.0, lambda: rig.say("resume", "bench"))
    assert rig.carried_out().error is None
    assert len(rig.events("armed")) == 1


def test_a_new_reason_to_hold_keeps_it_from_being_armed(tmp_path: Path) -> None:
    rig = Bench(tmp_path)
    rig.at(40.0, lambda: rig.say("resume", "afar"))
    rig.at(50.0, lambda: rig.stop.holds.hold("interlock door", "the door is open"))
    rig.at(60.0, lambda: rig.say("answer", "bench", value=True))
    rig.at(70.0, lambda: rig.stop.holds.release("interlock door"))
    rig.at(80.0, lambda: rig.say("answer", "bench", value=True))
    assert rig.carried_out().error is None
    assert rig.replies[2] == {"ok": False, "error": "the bench is not armed: the door is open"}
    assert rig.energised_s()[0] == pytest.approx(80.0, abs=1.0)


@pytest.mark.parametrize("place", ["afar", "bench"])
def test_interlocks_are_read_again_before_it_goes_on(tmp_path: Path, place: str) -> None:
    """Their dwell is not over, so that nothing has tripped: the value is beyond its limit all the same."""
    rig = Bench(tmp_path)
    rig.instruments["chamber"] = Passive("chamber", rig)
    rig.air_degC = lambda t_s: 60.0 if 35.0 < t_s < 500.0 else 20.0
    rig.at(40.0, lambda: rig.say("resume", place))
    rig.at(100.0, lambda: rig.say("answer", "bench", value=True))
    rig.at(900.0, lambda: rig.say("answer", "bench", value=True))
    rig.watched = lambda context: InterlockWatch([HOT], context)
    assert rig.carried_out(lambda context: context.interlocks.watching()).error is None
    sound(rig, 2)
    tripped = [event for event in rig.events("interlock") if event["state"] == "tripped"]
    assert [(event["name"], event["value"], event["action"]) for event in tripped] == [("hot", 60.0, "hold")]
    assert rig.energised_s()[0] == pytest.approx(900.0, abs=1.0)  # armed again, behind the interlock
    assert not rig.replies[2]["ok"]


def test_a_resume_from_afar_is_refused_while_an_interlock_is_beyond_its_limit(tmp_path: Path) -> None:
    rig = Bench(tmp_path)

    def trouble() -> None:
        rig.ran.interlocks.in_the_way = lambda: {"hot": "chamber_air is 60 degC"}  # type: ignore[method-assign]

    rig.at(20.0, trouble)
    rig.at(40.0, lambda: rig.say("resume", "afar"))
    rig.at(50.0, lambda: setattr(rig.ran.interlocks, "in_the_way", dict))
    rig.at(60.0, lambda: rig.say("resume", "bench"))
    assert rig.carried_out().error is None
    assert "chamber_air is 60 degC" in rig.replies[1]["error"]
    assert rig.energised_s()[0] == pytest.approx(60.0, abs=1.0)  # the pause was not taken back before


def test_nobody_comes_for_a_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert LIMIT_S == 86_400.0
    monkeypatch.setattr("bench.run.hold.LIMIT_S", 600.0)
    rig = Bench(tmp_path)
    rig.at(40.0, lambda: rig.say("resume", "afar"))
    outcome = rig.carried_out()
    assert outcome.error.code == "B-RUN-070"
    assert "armed at the bench" in outcome.error.message
    assert rig.energised_s() == []
    assert rig.clock.now_ns() / 1e9 == pytest.approx(640.0, abs=2.0)


def test_an_abort_from_afar_ends_a_run_that_waits_to_be_armed(tmp_path: Path) -> None:
    rig = Bench(tmp_path)
    rig.at(40.0, lambda: rig.say("resume", "afar"))
    rig.at(60.0, lambda: rig.say("abort", "afar", reason="enough"))
    assert rig.carried_out().error.code == "B-RUN-010"
    assert rig.energised_s() == []
    assert rig.called("supply.make_safe")


def test_what_a_shipped_campaign_switches_on_again() -> None:
    """At the last point the calibrator and the matrix; at its end nothing any more. Supply and chamber stay on."""
    from bench.model.drivers import driver_class

    plan = compile_sequence(ROOT / "sequences" / "scale_factor_short.yaml")
    entries = plan.station.instruments
    instruments = {role: object.__new__(driver_class(entry.driver)) for role, entry in entries.items()}
    context: Any = SimpleNamespace(plan=plan, instruments=instruments, decided=SimpleNamespace(left_out=()))
    records = [step.number for step in plan.steps if step.kind == "record" and step.phase == "campaign"]
    assert set(energised_again(context, records[-1] - 8)) == {"calibrator", "switch"}
    assert energised_again(context, plan.phase("finally")[0].number) == []
