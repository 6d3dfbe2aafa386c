"""Deviations that nobody declared, told in time and once; the trend beside a run, which changes nothing."""

import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_sample import FaultyFiles, no_space
from rehearsal import Watched as Heard
from rehearsal import contents
from run_rig import HoldRig, Passive
from trend_sample import run_short
from unruly_chamber import SECOND_AIR, Watched, campaign

from bench.model.errors import InputError, InstrumentError
from bench.model.events import event_of
from bench.model.ports import action
from bench.plan import SetPoint
from bench.record import SessionReader
from bench.record.trend import FOLDER
from bench.record.trend_reader import TrendReader
from bench.replay.build_trend import build_trend, main
from bench.replay.history import history, needs_build, raw_window, trend_place
from bench.run.context import RunContext
from bench.run.watch.deviations import DeviationWatch
from bench.run.watch.trend import trend_recorder

HOUR_S = 3600.0
DOOR_S = 1800.0  # what a chamber does so long after its door was closed is the door's doing
IN_TIME_S = 20.0


def soaking(seed: int, degC: float = 50.0, ramp_degC_min: float = 1.0, **more: bool) -> Watched:
    """A chamber that has come to its set-point and stood there for an hour."""
    watched = Watched(seed, **more)
    watched.set_point(degC, ramp_degC_min)
    watched.run(abs(degC - 23.0) / ramp_degC_min * 60.0 + HOUR_S)
    return watched


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("degC", "rate_degC_min"), [(50.0, 6.0), (50.0, -6.0), (-30.0, 6.0), (-30.0, -6.0)])
def test_a_runaway_is_told_within_20_s(seed: int, degC: float, rate_degC_min: float) -> None:
    watched = soaking(seed, degC)
    since_s = watched.now_s
    watched.chamber.runaway_degC_min = rate_degC_min
    watched.run(IN_TIME_S)
    ((told_s, name),) = watched.begun(since_s)
    print(f"seed {seed}: told after {told_s - since_s:g} s")
    assert name == "runaway"
    (said,) = [event for _, event in watched.told if event.state == "begun"]
    assert said.severity == "alarm"
    assert said.set_point == degC
    assert "the guard switches its heat off at 65 degC" in said.sentence


@pytest.mark.parametrize("seed", range(4))
def test_with_a_stuck_control_sensor_the_other_one_tells(seed: int) -> None:
    """The loop heats on, because what it hears never rises."""
    watched = soaking(seed)
    since_s = watched.now_s
    watched.chamber.own_stuck_degC, watched.chamber.runaway_degC_min = 49.9, 6.0
    watched.run(180.0)
    told = {name: t_s for t_s, name in reversed(watched.begun(since_s))}
    print(f"seed {seed}: told after", {name: t_s - since_s for name, t_s in told.items()})
    assert set(told) == {"runaway", "sensors"}
    assert told["runaway"] - since_s <= IN_TIME_S
    assert next(said.by for _, said in watched.told if said.name == "runaway") == "the other sensor"


@pytest.mark.parametrize("seed", range(4))
def test_a_stuck_second_sensor_is_a_disagreement_and_no_runaway(seed: int) -> None:
    watched = soaking(seed, 20.0)
    since_s = watched.now_s
    watched.chamber.second_stuck_degC = watched.chamber.air_degC
    watched.set_point(50.0, 1.0)
    watched.run(20 * 60.0)
    assert [name for _, name in watched.begun(since_s)] == ["sensors"]
    told_s = watched.begun(since_s)[0][0]
    lag_s = 200.0  # of the air behind the programme
    print(f"seed {seed}: told after {told_s - since_s:g} s")
    assert told_s - since_s <= (5.0 + abs(watched.chamber.character.offset_K)) * 60.0 + 60.0 + lag_s


@pytest.mark.parametrize("signal", [False, True])
def test_a_door_left_open_is_told_and_its_signal_explains(signal: bool) -> None:
    watched = soaking(1, door_signal=signal)
    since_s = watched.now_s
    watched.chamber.door = True
    watched.run(90.0)
    told = [said for t_s, said in watched.told if t_s >= since_s]
    assert [said.name for said in told] == ["runaway", "air"]
    assert watched.begun(since_s)[0][0] - since_s <= IN_TIME_S
    assert watched.begun(since_s)[1][0] - since_s <= 60.0 + IN_TIME_S
    assert [said.severity for said in told] == (["warning"] * 2 if signal else ["alarm", "warning"])
    assert [said.door for said in told] == ([True] * 2 if signal else [None] * 2)
    assert ("its door is or was open" in told[0].sentence) == signal
    watched.chamber.door = False
    watched.run(HOUR_S)
    assert [said.name for _, said in watched.told if said.state == "over"] == ["runaway", "air"]


def test_a_chamber_that_loses_its_set_point_slowly_is_told_and_it_is_over_when_it_is_back() -> None:
    watched = soaking(2)
    since_s = watched.now_s
    watched.chamber.runaway_degC_min = -1.0
    watched.run(5 * 60.0)
    ((told_s, name),) = watched.begun(since_s)
    assert name == "air"
    assert told_s - since_s <= 2 * 60.0 + 60.0 + 45.0  # 2 K at 1 degC/min, the dwell, the cycle on top
    watched.chamber.runaway_degC_min = None
    watched.run(HOUR_S)
    assert [said.state for _, said in watched.told] == ["begun", "over"]


def test_without_a_second_sensor_and_without_a_set_point_nothing_is_told() -> None:
    watched = Watched(3, second=False)
    watched.chamber.runaway_degC_min = 6.0
    watched.run(300.0)
    assert watched.told == []


def false_warnings(seed: int, hours: float, *, door_signal: bool) -> tuple[float, int, int, int]:
    """Return hours, doors opened, deviations told of them, and deviations told of nothing."""
    watched = Watched(seed, door_signal=door_signal)
    doors = list(campaign(watched, hours))
    told_s = [t_s for t_s, _ in watched.begun()]
    of_doors = sum(any(opened <= t_s <= closed + DOOR_S for opened, closed in doors) for t_s in told_s)
    return watched.now_s / HOUR_S, len(doors), of_doors, len(told_s) - of_doors


def test_a_day_without_a_fault_has_no_warning_but_of_the_door() -> None:
    hours, doors, of_doors, false = false_warnings(5, 24.0, door_signal=False)
    print(f"seed 5: {hours:.0f} h, {doors} doors, {of_doors} told of them, {false} false")
    assert doors > 0
    assert false == 0


@pytest.mark.sweep
def test_500_hours_have_one_false_warning_at_most() -> None:
    """Ten chambers, 50 hours each; every other one tells whether its door is open."""
    runs = {seed: false_warnings(seed, 50.0, door_signal=bool(seed % 2)) for seed in range(10)}
    for seed, (hours, doors, of_doors, false) in runs.items():
        print(f"seed {seed}: {hours:.0f} h, {doors} doors, {of_doors} told of them, {false} false")
    assert sum(hours for hours, _, _, _ in runs.values()) >= 500.0
    assert sum(false for _, _, _, false in runs.values()) <= 1


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

    def beside(self, context: RunContext) -> AbstractContextManager[None]:
        context.plan.station.guard_limits_degC = {"chamber_air_degC": 65.0}  # type: ignore[misc]
        self.watch = DeviationWatch(context, self.rules, asks=True)
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
    with ExitStack() as stack:
        bench.rig.at(30.0, lambda: stack.enter_context(bench.rig.ran.in_use.take("chamber")))
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


GYROS = [f"port_a.npp-ppp[{channel}]" for channel in range(1, 7)]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Heard]:
    done, heard = run_short(tmp_path_factory.mktemp("trend"))
    return done.folder, heard


def segments(folder: Path) -> dict[str, bytes]:
    return {name: content for name, content in contents(folder).items() if name.endswith(".mcap")}


def test_no_byte_of_the_recording_changes_and_the_same_seed_gives_the_same_trend(
    recorded: tuple[Path, Heard], tmp_path: Path
) -> None:
    plain, _ = run_short(tmp_path / "plain", beside=[])
    again, _ = run_short(tmp_path / "again")
    assert not (plain.folder / FOLDER).exists()
    assert segments(plain.folder) == segments(again.folder) == segments(recorded[0])
    assert contents(again.folder / FOLDER) == contents(recorded[0] / FOLDER)
    assert len(contents(again.folder / FOLDER)) == 10


def test_the_trend_made_again_from_the_recording_is_the_same(recorded: tuple[Path, Heard], tmp_path: Path) -> None:
    assert main([str(recorded[0]), str(tmp_path)]) == 0
    made, written = TrendReader(tmp_path), TrendReader(recorded[0])
    assert made.head == written.head
    for name in ("port_a.001s", "port_b.001s", "port_a.010s"):
        assert (tmp_path / FOLDER / name).read_bytes() == (recorded[0] / FOLDER / name).read_bytes()
    span = written.span_s()
    assert span is not None
    air, setpoint = (made.window([name], *span, 1000) for name in ("bench.air", "bench.setpoint"))
    assert np.nanmax(setpoint.high) == np.float32(23.3)
    assert len(air.t_utc_s) > 10


def test_single_readings_have_the_least_and_greatest_values_of_the_trend(recorded: tuple[Path, Heard]) -> None:
    folder = recorded[0]
    span = TrendReader(folder).span_s()
    raw = raw_window(folder, [*GYROS, "bench.setpoint"], span[0] + 5, span[0] + 15)
    seconds = history(folder, GYROS, span[0] + 5, span[0] + 15, 100)
    assert (raw.bucket_s, seconds.bucket_s) == (0.0, 1.0)
    widths_s = {20.0: 0.0, 22.0: 1.0}  # raw only where there is room for it
    assert {stop: history(folder, GYROS, span[0] + 1, span[0] + stop, 1000).bucket_s for stop in widths_s} == widths_s
    assert len(raw.t_utc_s) >= 1000
    for row, start in enumerate(seconds.t_utc_s[1:-1], 1):
        mine = (raw.t_utc_s > start + 1e-6) & (raw.t_utc_s <= start + 1 + 1e-6)
        assert np.nanmin(raw.low[mine][:, :6], axis=0).tolist() == seconds.low[row].tolist()
        assert np.nanmax(raw.high[mine][:, :6], axis=0).tolist() == seconds.high[row].tolist()


def test_a_segment_without_an_end_is_read_up_to_its_last_chunk(recorded: tuple[Path, Heard], tmp_path: Path) -> None:
    start = (TrendReader(recorded[0]).span_s() or (0.0, 0.0))[0]
    whole = raw_window(recorded[0], GYROS, start + 5, start + 9)
    cut = tmp_path / "cut"
    shutil.copytree(recorded[0], cut)
    content = (cut / "session.0001.mcap").read_bytes()
    (cut / "session.0001.mcap").write_bytes(content[: len(content) * 3 // 4])
    found = raw_window(cut, GYROS, start + 5, start + 9)
    assert found.to_bytes() == whole.to_bytes()
    count, width = np.frombuffer(found.to_bytes()[:8], "<u4")
    assert (count, width) == found.low.shape
    assert len(found.to_bytes()) == 16 + 8 * count + 8 * count * width


def test_a_session_without_a_trend_gets_one_in_the_cache(recorded: tuple[Path, Heard], tmp_path: Path) -> None:
    bare, cache = tmp_path / recorded[0].name, tmp_path / "cache"
    shutil.copytree(recorded[0], bare, ignore=shutil.ignore_patterns(FOLDER))
    start = (TrendReader(recorded[0]).span_s() or (0.0, 0.0))[0]
    near = raw_window(bare, GYROS, start + 5, start + 9)
    assert near.to_bytes() == raw_window(recorded[0], GYROS, start + 5, start + 9).to_bytes()
    with pytest.raises(InputError, match="B-REC-030"):
        history(bare, GYROS, start, start + 30, 100)
    window = history(bare, GYROS, start, start + 30, 100, cache)
    assert window.to_bytes() == history(recorded[0], GYROS, start, start + 30, 100).to_bytes()
    place = trend_place(bare, cache)
    assert place is not None
    assert not needs_build(bare, place)
    assert not (bare / FOLDER).exists()
    build_trend(bare, place)  # made again in its place
    assert [path.name for path in place.iterdir()] == [FOLDER]


@pytest.mark.parametrize("writes", [0, 3])
def test_a_disk_that_refuses_costs_the_trend_and_nothing_else(
    recorded: tuple[Path, Heard], tmp_path: Path, writes: int
) -> None:
    full = FaultyFiles(lambda kind, n: no_space() if kind == "write" and n > writes else None)
    done, heard = run_short(tmp_path, beside=[lambda context: trend_recorder(context, full)])
    assert segments(done.folder) == segments(recorded[0])
    said = [text for text in heard.messages if "no trend is written" in text]
    assert len(said) == 1
    assert "No space left" in said[0]
    assert not (done.folder / FOLDER / "trend.json").exists(), "half a trend must not pass for a whole one"


@pytest.mark.parametrize(("way", "words"), [("folder", "no trend is written"), ("error", "ZeroDivisionError")])
def test_whatever_keeps_a_trend_from_being_written_is_said_and_the_run_goes_on(
    tmp_path: Path, way: str, words: str
) -> None:
    @contextmanager
    def beside(context: RunContext) -> Iterator[None]:
        if way == "folder":
            (context.folder / FOLDER).write_text("in the way")
        with trend_recorder(context) as recorder:
            assert (recorder is None) == (way == "folder")
            if recorder is not None:
                recorder._bench.advance = lambda t_utc_ns: 1 / 0  # type: ignore[method-assign,assignment,return-value]
            yield

    done, heard = run_short(tmp_path, beside=[beside])
    assert len([text for text in heard.messages if words in text]) == 1
    assert SessionReader(done.folder).damage == []


def test_what_no_session_has_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path), str(tmp_path / "out")]) == 2
    assert "B-REC-010" in capsys.readouterr().err
