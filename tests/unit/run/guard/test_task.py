"""The guard's decision under the virtual clock: a chamber that runs away, and a campaign that is left alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InputError
from bench.model.shipped import find_shipped
from bench.plan import Step, compile_sequence
from bench.plan.station import load_station
from bench.run.control.operator import SimulatedOperator
from bench.run.guard.guarding import guard_beside
from bench.run.session import Conducted, conduct
from bench.run.watch.temperatures import LONGEST_S, WALL_S, patience_s
from sim_instruments.worlds import simulation
from sim_instruments.worlds.common.world import World

LIMIT_DEGC = 65.0
HEAT_OFF_S = 2.0
SEQUENCE = """\
sequence: hot
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
timeline:
  - {at: 0 s, call: {chamber.set_temperature: {temperature: 55 degC, ramp: 1 degC/min}}}
  - {at: 10 s, call: chamber.run}
  - {at: 20 s, call: {switch.route: {channel: 3, polarity: +}}}
  - {at: 30 s, call: {calibrator.output: {current: 1 mA, range: lowest_that_holds}}}
  - {at: 40 s, call: calibrator.operate}
  - {at: 7200 s, call: calibrator.operating}
  - {at: 14400 s, call: calibrator.standby}
"""


class Bench:
    """A run of SEQUENCE whose world is watched each ``look_s`` of virtual time."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, look_s: float) -> None:
        self.folder, self.clock = folder, VirtualClock()
        self.world: World | None = None
        self.reached_s = self.stopped_s = self.off_s = 0.0
        plain = simulation.open_world

        def open_world(*words: Any, **options: Any) -> World:
            self.world = plain(*words, **options)
            self.clock.every(look_s, self.look)
            return self.world

        monkeypatch.setattr(simulation, "open_world", open_world)

    def look(self) -> None:
        """Note when the chamber's own sensor shows the limit, and when heat and stimulus are off after that."""
        chamber, now_s = self.world.instruments["chamber"], self.clock.now_ns() / NS
        if not self.reached_s and round(chamber._air_degC(), 1) >= LIMIT_DEGC:
            self.reached_s = now_s
        if self.reached_s and not self.stopped_s and not chamber.mode & 16:
            self.stopped_s = now_s
        if self.reached_s and not self.off_s and not self.world.instruments["calibrator"].operating:
            self.off_s = now_s

    def step(self, step: Step, at_s: float) -> None:
        if step.number == self.fault_at:
            self.world.switches.switch("chamber_runaway", "", 2.0)

    def record(self, row: object) -> None:
        return None

    def message(self, text: str) -> None:
        return None

    def run(self, fault_at: int = -1) -> Conducted:
        self.fault_at = fault_at
        path = self.folder / "hot.yaml"
        path.write_text(SEQUENCE)
        plan = compile_sequence(path, None, {})
        return conduct(
            plan, clock=self.clock, seed=3, out=self.folder / "out", operator=SimulatedOperator(), listener=self,
            keep_events=("guard",), beside=[guard_beside(plan.station)],
        )  # fmt: skip


def test_a_chamber_that_runs_away_loses_its_heat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path, monkeypatch, look_s=0.05)
    run = bench.run(fault_at=4)
    error = run.outcome.error
    assert error.code == "B-RUN-094"
    assert "chamber_air_degC is 65" in error.message
    heat_off_s, stimulus_off_s = bench.stopped_s - bench.reached_s, bench.off_s - bench.reached_s
    print(f"heat off {heat_off_s:.2f} s after, stimulus {stimulus_off_s:.2f} s after")
    assert 0.0 <= heat_off_s <= HEAT_OFF_S
    assert 0.0 <= stimulus_off_s <= 5.0
    assert run.outcome.unsafe == ()
    assert [fields["state"] for _, _, fields in run.events] == ["acted"]


def test_a_hot_campaign_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path, monkeypatch, look_s=1.0)
    run = bench.run()
    assert run.outcome.error is None
    assert run.events == []
    assert bench.reached_s == 0.0


def test_patience_ends_before_the_limit_can_be_reached() -> None:
    limits = {"chamber_air_degC": 65.0, "unit_degC": 70.0}
    assert patience_s({"chamber_air_degC": 60.0}, limits) == pytest.approx(60.0)  # 5 degC at 5 degC/min
    assert patience_s({"chamber_air_degC": 60.0, "unit_degC": 69.0}, limits) == pytest.approx(12.0)
    assert patience_s({"chamber_air_degC": -40.0}, limits) == LONGEST_S
    assert patience_s({"chamber_air_degC": 65.0}, limits) == WALL_S
    assert patience_s({}, limits) == WALL_S


def test_hard_limits_come_from_the_chamber_unless_they_are_written(tmp_path: Path) -> None:
    shipped = find_shipped("stations", "af_bench_sim")
    assert load_station(shipped).guard_limits_degC == {"chamber_air_degC": 65.0, "unit_degC": 70.0}
    text = Path(shipped).read_text()
    own = tmp_path / "own.yaml"
    own.write_text(text + "\nguard: {limits: {chamber_air: 62 degC}, silence: 1.5 s}\n")
    station = load_station(own)
    assert station.guard_limits_degC == {"chamber_air_degC": 62.0, "unit_degC": 70.0}
    assert station.file.guard.silence == 1.5


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("guard: {limits: {chamber_air: 60 degC}}", "not above the chamber's own limit of 60 degC"),
        ("guard: {limits: {chamber_air: 65}}", "chamber_air"),
        ("guard: {silence: 10 s}", "silence"),
        ("guard: {silent: 2 s}", "silent"),
    ],
)
def test_a_guard_that_makes_no_sense_is_refused(tmp_path: Path, section: str, said: str) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(Path(find_shipped("stations", "af_bench_sim")).read_text() + f"\n{section}\n")
    with pytest.raises(InputError, match=said):
        load_station(own)
