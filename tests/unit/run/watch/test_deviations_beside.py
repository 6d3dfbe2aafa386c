"""The watch of deviations beside a run: what it hears, what it reads, and that it is quiet where nothing deviates."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from hold_rig import HoldRig, Passive
from unruly_chamber import SECOND_AIR

from bench.model.errors import InstrumentError
from bench.model.events import event_of
from bench.model.ports import action
from bench.plan import SetPoint
from bench.run.context import RunContext
from bench.run.observers import Following
from bench.run.watch.deviations import DeviationWatch


class Supply(Passive):
    """Reads back ``volts``."""

    volts = 18.0

    @action()
    def configure(self, voltage: float) -> None:
        self._call("configure", voltage)

    @action()
    def output_on(self) -> None:
        self._call("output_on")

    @action(returns="V")
    def measure_voltage(self) -> float:
        self._call("measure_voltage")
        return self.volts


class Table(Passive):
    """Turns at ``rate``, whatever is asked."""

    rate = 10.0

    @action()
    def spin(self, axis: int, rate: float) -> None:
        self._call("spin", axis, rate)

    @action(returns="deg/s")
    def measure_rate(self, axis: int) -> float:
        self._call("measure_rate", axis)
        return self.rate


class Bench:
    """A campaign of ``points`` of 15 s, watched each second as on the wall clock."""

    def __init__(self, folder: Path, points: int, *rules: Any) -> None:
        self.rig, self.rules = HoldRig(folder, points), rules
        self.rig.instruments["chamber"] = Passive("chamber", self.rig)
        self.rig.air_degC = lambda t_s: 20.0

    def run(self) -> list[dict[str, Any]]:
        """Return the deviations that were told."""
        outcome = self.rig.run_beside(self.beside)
        assert outcome.error is None
        return [fields for fields in self.rig.events("alarm") if fields["what"] == "deviation"]

    def beside(self, context: RunContext) -> AbstractContextManager[object]:
        context.plan.station.guard_limits_degC = {"chamber_air_degC": 65.0}  # type: ignore[misc]
        self.watch = DeviationWatch(context, Following(context.observers), self.rules, asks=True)
        context.observers.add(self.watch)
        self.rig.clock.every(1.0, self.watch.look)
        self.rig.at(1.0, lambda: context.observers.set_point(SetPoint(20.0, 1.0)))
        return nullcontext()


def test_a_runaway_is_told_within_20_s_at_terminal_page_and_in_the_session(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 12)
    bench.rig.air_degC = lambda t_s: 20.0 + max(0.0, t_s - 60.0) * 6.0 / 60.0
    told = bench.run()
    assert [fields["name"] for fields in told] == ["runaway", "air"]
    at_s = [t_ns / 1e9 for kind, t_ns, _ in bench.rig.sink.events if kind == "alarm"]
    assert at_s[0] - 60.0 <= 20.0
    assert any("moves away from its set-point of 20 degC" in text for text in bench.rig.listener.messages)
    assert event_of("alarm", told[0]).severity == "alarm"


def test_a_chamber_that_falls_silent_is_no_deviation(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 12)
    chamber = bench.rig.instruments["chamber"]
    bench.rig.at(30.0, lambda: chamber.fail.update(measure_air=InstrumentError("B-INST-001", "mute", where="chamber")))
    assert bench.run() == []
    assert bench.rig.events("error")


def test_a_chamber_that_a_step_talks_to_is_not_asked(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 8)
    taken: list[AbstractContextManager[None]] = []

    def take() -> None:
        taken.append(bench.rig.ran.in_use.take("chamber"))
        taken[0].__enter__()

    bench.rig.at(30.0, take)
    assert bench.run() == []
    assert [t_s for t_s in bench.rig.called("chamber.measure_air") if t_s > 30.0] == []


def test_a_logger_that_is_silent_or_tells_no_number_is_no_deviation(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 12, SECOND_AIR)
    logger = bench.rig.instruments["logger"] = Passive("logger", bench.rig)
    logger.options = {"channels": [101, 102]}  # type: ignore[attr-defined]
    logger.scan = lambda: [23.0, float("nan")]  # type: ignore[attr-defined]
    assert bench.run() == []
    assert len(bench.rig.events("surroundings")) <= 180 / 60 + 1


def test_a_supply_that_is_off_its_setting_is_told_and_is_over_when_it_is_back(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 0)
    supply = bench.rig.instruments["supply"] = Supply("supply", bench.rig)
    bench.rig.step("call", "supply", "configure", voltage=18.0)
    bench.rig.step("call", "supply", "output_on")
    bench.rig.step("settle", duration_s=600.0, bus_s=0.0)
    bench.rig.at(60.0, lambda: setattr(supply, "volts", 12.0))
    bench.rig.at(300.0, lambda: setattr(supply, "volts", 18.2))
    told = bench.run()
    assert [(fields["name"], fields["of"], fields["state"]) for fields in told] == [
        ("voltage", "supply", "begun"), ("voltage", "supply", "over"),
    ]  # fmt: skip
    assert (told[0]["value"], told[0]["set_point"]) == (12.0, 18.0)
    begun_s, _ = (t_ns / 1e9 for kind, t_ns, _ in bench.rig.sink.events if kind == "alarm")
    assert 60.0 + 60.0 <= begun_s <= 60.0 + 60.0 + 2 * 31.0


def test_an_axis_that_turns_slower_than_it_was_told_is_said(tmp_path: Path) -> None:
    bench = Bench(tmp_path, 0)
    table = bench.rig.instruments["table"] = Table("table", bench.rig)
    table.rate = 9.8
    bench.rig.step("call", "table", "spin", axis=1, rate=10.0)
    bench.rig.step("settle", duration_s=300.0, bus_s=0.0)
    (told,) = bench.run()
    assert (told["name"], told["of"], told["set_point"], told["unit"]) == ("rate", "table axis 1", 10.0, "deg/s")
