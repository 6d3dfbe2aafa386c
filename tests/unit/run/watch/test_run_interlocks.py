"""Interlocks beside the sequencer on a fake bench: what each action does, and how readings are taken."""

from __future__ import annotations

import math
import threading
from contextlib import AbstractContextManager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hold_rig import HoldRig, Passive, sound
from run_rig import instrument_error
from test_interlock_state import rule

from bench.model.errors import ExitStatus
from bench.plan.language.interlocks import InterlockRule
from bench.run.context import RunContext
from bench.run.observers import Following
from bench.run.watch.interlocks import InterlockWatch, interlocks
from bench.run.watch.signals import FRESH_VIRTUAL_S

HOT = rule(
    name="hot", signal="chamber_air", of="", channel=None, high=50.0, low=None, release_high=45.0, release_low=None,
    dwell_s=0.0, release_after_s=0.0,
)  # fmt: skip


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    """As often as under the wall clock, nearly: these runs are short."""
    monkeypatch.setattr("bench.run.watch.interlocks.LOOK_VIRTUAL_S", 10.0)
    monkeypatch.setattr("bench.run.watch.interlocks.ASK_VIRTUAL_S", 60.0)


def changed(base: InterlockRule, **changes: Any) -> InterlockRule:
    return InterlockRule(**({name: getattr(base, name) for name in base.__dataclass_fields__} | changes))


def watching(*rules: InterlockRule) -> Any:
    def beside(context: RunContext) -> AbstractContextManager[InterlockWatch]:
        return interlocks(context, rules, Following(context.observers))

    return beside


def watch_of(context: RunContext, rules: list[InterlockRule]) -> InterlockWatch:
    return InterlockWatch(rules, context, Following(context.observers))


def chamber_rig(folder: Path, points: int = 12) -> HoldRig:
    """Air at 20 degC, 60 degC from 65 s to 200 s; it is read each minute."""
    rig = HoldRig(folder, points)
    rig.instruments["chamber"] = Passive("chamber", rig)
    rig.air_degC = lambda t_s: 60.0 if 65.0 < t_s < 200.0 else 20.0
    return rig


def told(rig: HoldRig) -> list[tuple[str, str]]:
    return [(event["state"], event["action"]) for event in rig.events("interlock")]


def test_hold_stands_still_until_the_value_is_back(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path)
    outcome = rig.run_beside(watching(HOT))
    assert outcome.error is None
    sound(rig, 12)
    assert told(rig) == [("tripped", "hold"), ("released", "hold")]
    (event, back) = rig.events("interlock")
    assert (event["value"], event["limit"], event["unit"], event["name"]) == (60.0, 50.0, "degC", "hot")
    assert back["value"] == 20.0
    (hold,) = rig.events("hold")
    assert hold["by"] == "interlock hot"
    tripped_ns, back_ns = (t_ns for kind, t_ns, _ in rig.sink.events if kind == "interlock")
    assert 65e9 < tripped_ns < 145e9
    assert 200e9 < back_ns < 280e9
    for row in outcome.rows:
        assert row.window.t_end_ns <= tripped_ns or row.window.t_start_ns >= back_ns


def test_abort_ends_the_run_safely(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path)
    outcome = rig.run_beside(watching(changed(HOT, action="abort")))
    assert outcome.error.code == "B-RUN-071"
    assert outcome.error.exit_status is ExitStatus.SAFE_AFTER_FAULT
    assert "chamber_air is 60 degC" in str(outcome.error)
    assert 65.0 < rig.called("source.make_safe")[0] <= 145.0


def test_warn_only_says_so(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 20)
    outcome = rig.run_beside(watching(changed(HOT, action="warn")))
    assert outcome.error is None
    assert outcome.slip_s == 0.0
    assert told(rig) == [("tripped", "warn"), ("released", "warn")]
    assert any("interlock hot: chamber_air is 60 degC" in text for text in rig.listener.messages)
    assert rig.events("hold") == []


@pytest.mark.parametrize("action", ["retake", "skip"])
def test_a_lasting_trip_of_retake_or_skip_becomes_a_hold(tmp_path: Path, action: str) -> None:
    rig = chamber_rig(tmp_path)
    rig.air_degC = lambda t_s: 60.0 if 65.0 < t_s < 400.0 else 20.0  # several readings: it is no glitch
    outcome = rig.run_beside(watching(changed(HOT, action=action)))
    assert outcome.error is None
    assert told(rig) == [("tripped", action), ("lasting", "hold"), ("released", action)]
    assert len(rig.events("hold")) == 1
    if action == "retake":
        sound(rig, 12)
    else:
        (skip,) = rig.events("skip")
        assert len(outcome.rows) == 11
        assert skip["by"] == "interlock hot"


def test_a_glitch_takes_the_point_again_at_once(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 5)
    watch: list[InterlockWatch] = []

    def beside(context: RunContext) -> _Kept:
        return _Kept(interlocks(context, [changed(HOT, action="retake")], Following(context.observers)), watch)

    rig.at(25.0, lambda: watch[0].signals.put("chamber_air", 60.0))
    rig.at(31.0, lambda: watch[0].signals.put("chamber_air", 20.0))
    outcome = rig.run_beside(beside)
    assert outcome.error is None
    sound(rig, 5)
    assert told(rig) == [("tripped", "retake"), ("released", "retake")]
    assert outcome.slip_s > 0.0
    assert rig.events("hold") == []


class _Kept:
    """Keeps what a context manager gives, for a test that reaches into it."""

    def __init__(self, inner: AbstractContextManager[InterlockWatch], kept: list[InterlockWatch]) -> None:
        self._inner, self._kept = inner, kept

    def __enter__(self) -> InterlockWatch:
        self._kept.append(self._inner.__enter__())
        return self._kept[-1]

    def __exit__(self, *error: Any) -> None:
        self._inner.__exit__(*error)


def test_an_instrument_that_gives_no_reading_trips_what_must_not_go_stale(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 40)
    rig.air_degC = lambda t_s: 20.0
    rig.at(100.0, lambda: rig.instruments["chamber"].fail.update(measure_air=instrument_error()))
    rig.at(400.0, rig.instruments["chamber"].fail.clear)
    outcome = rig.run_beside(watching(changed(HOT, stale_s=130.0)))
    assert outcome.error is None
    sound(rig, 40)
    assert told(rig) == [("stale", "hold"), ("released", "hold")]
    assert rig.events("interlock")[0]["value"] is None
    assert "no reading of chamber_air for more than 130 s" in rig.events("hold")[0]["reason"]
    assert {event["code"] for event in rig.events("error")} == {"B-INST-001"}


def test_an_instrument_in_use_is_not_asked(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 8)
    taken: list[AbstractContextManager[None]] = []

    def beside(context: RunContext) -> AbstractContextManager[InterlockWatch]:
        taken.append(context.in_use.take("chamber"))
        rig.at(50.0, taken[0].__enter__)
        return interlocks(context, [HOT], Following(context.observers))

    rig.run_beside(beside)
    assert [t_s for t_s in rig.called("chamber.measure_air") if t_s > 50.0] == []


def test_a_step_that_begins_while_an_instrument_is_read_waits_for_its_bus(tmp_path: Path) -> None:
    """The reading holds the lock of the bus; whoever marks the instrument before is left alone."""
    rig = chamber_rig(tmp_path, 1)
    chamber, lock = rig.instruments["chamber"], threading.RLock()
    chamber.bus = SimpleNamespace(lock=lock)  # type: ignore[attr-defined]
    held: list[bool] = []

    def measure() -> float:
        taken = threading.Thread(target=lambda: held.append(not lock.acquire(blocking=False)))
        taken.start()
        taken.join()
        return 20.0

    chamber.measure_air = measure  # type: ignore[method-assign]
    context = rig.context()
    watch = watch_of(context, [HOT])
    watch.signals.ask()
    assert held == [True]
    assert lock.acquire(blocking=False)


def test_laboratory_air_comes_from_its_channel_of_the_logger(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 60)
    logger = rig.instruments["logger"] = Passive("logger", rig)
    logger.options = {"channels": [103, 101]}  # type: ignore[attr-defined]
    scans = iter([[30.0, 23.0], [30.0, 23.1], *[[30.0, 24.5]] * 99])
    logger.scan = lambda: next(scans)  # type: ignore[attr-defined]
    outcome = rig.run_beside(watching(rule(action="warn", dwell_s=100.0)))
    assert outcome.error is None
    assert told(rig) == []  # one scan in five minutes: 900 s hold readings at 60, 360 and 660 s
    assert [event["degC"]["101"] for event in rig.events("surroundings")] == [23.0, 23.1, 24.5]
    rig.sink.events.clear()
    rig = HoldRig(tmp_path, 80)
    logger = rig.instruments["logger"] = Passive("logger", rig)
    logger.options = {"channels": [103, 101]}  # type: ignore[attr-defined]
    logger.scan = lambda: [30.0, 24.5]  # type: ignore[attr-defined]
    rig.run_beside(watching(rule(action="warn", dwell_s=100.0)))
    assert told(rig) == [("tripped", "warn")]


def test_a_silent_link_holds_and_the_held_run_goes_on_when_it_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.run.watch.interlocks.LOOK_VIRTUAL_S", 0.5)
    rig = HoldRig(tmp_path, 20)
    rig.port_a.dropped = lambda counter: 10_000 <= counter < 14_000
    silent = rule(
        name="link", signal="link_age", of="port_a", channel=None, unit="s", high=3.0, low=None, release_high=1.0,
        release_low=None, dwell_s=0.0, release_after_s=0.0,
    )  # fmt: skip
    outcome = rig.run_beside(watching(silent))
    assert outcome.error is None
    sound(rig, 20)
    assert told(rig) == [("tripped", "hold"), ("released", "hold")]


def test_shares_of_lost_and_bad_frames_are_those_of_the_last_while(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 20)
    rig.port_a.dropped = lambda counter: 10_000 <= counter < 12_000 and counter % 10 == 0
    lossy = rule(
        name="loss", signal="link_loss", of="port_a", channel=None, unit="1", high=0.05, low=None, release_high=0.01,
        release_low=None, dwell_s=0.0, release_after_s=0.0, action="warn",
    )  # fmt: skip
    rig.run_beside(watching(lossy))
    assert told(rig) == [("tripped", "warn"), ("released", "warn")]
    first, _ = rig.events("interlock")
    assert 0.05 < first["value"] <= 0.1 + 1e-9


@pytest.mark.parametrize(("step_Hz", "trips"), [(0, []), (400, [("tripped", "warn")])])
def test_a_jump_of_the_rate_inside_a_record_is_seen(tmp_path: Path, step_Hz: int, trips: list[Any]) -> None:
    rig = HoldRig(tmp_path, 3)
    rig.port_a.npp[0] = 7
    jump = rule(
        name="jump", signal="rate_step", of="", channel=None, unit="Hz", high=50.0, low=None, release_high=50.0,
        release_low=None, dwell_s=0.0, release_after_s=0.0, action="warn",
    )  # fmt: skip
    rig.at(25.0, lambda: rig.port_a.npp.__setitem__(0, 7 + step_Hz // 100))  # half-way through the second record
    rig.run_beside(watching(jump))
    assert told(rig)[:1] == trips
    if trips:
        assert rig.events("interlock")[0]["value"] == pytest.approx(400.0, rel=0.3)


def test_temperature_slope_is_that_of_the_last_minutes(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 1)
    rig.air_degC = lambda t_s: 20.0 + 0.7 * t_s / 60.0
    slope = rule(name="slope", signal="chamber_slope", of="", channel=None, unit="degC/min", high=0.5, low=None)
    watch = watch_of(rig.context(), [slope])
    seen = []
    for _ in range(4):
        watch.signals.ask()
        seen.append(watch.signals.value(slope))
        rig.clock.sleep(60.0)
    assert seen[0] is not None
    assert math.isnan(seen[0])
    assert seen[1:] == pytest.approx([0.7, 0.7, 0.7])


def test_supply_and_unit_temperature_come_from_the_housekeeping(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 1)
    rules = [
        rule(name=name, signal=name, of="", channel=None, unit="") for name in
        ("supply_current", "supply_voltage", "unit_temperature")
    ]  # fmt: skip
    context = rig.context()
    watch = watch_of(context, rules)
    rig.clock.sleep(5.0)
    watch.signals.look()
    assert [watch.signals.value(one) for one in rules] == [None] * 3  # nothing is decoded yet
    context.acquisition.refresh()
    watch.signals.look()
    assert [watch.signals.value(one) for one in rules] == pytest.approx([1.8, 28.0, 20.0])
    assert [watch.signals.value(one) for one in rules] == [None] * 3  # each reading is given once
    rig.port_b.silent = True
    rig.clock.sleep(FRESH_VIRTUAL_S + 5.0)
    watch.signals.look()
    assert [watch.signals.value(one) for one in rules] == [None] * 3


def test_nothing_is_judged_once_the_bench_is_made_safe(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 1)
    watch = watch_of(rig.context(), [HOT])
    watch.signals.put("chamber_air", 60.0)
    rig.stop.shield()
    watch.take()
    assert rig.events("interlock") == []
    watch = watch_of(chamber_rig(tmp_path, 1).context(), [changed(HOT, action="abort")])
    watch.signals.put("chamber_air", 60.5)
    watch.take()
    assert list(watch.tripped) == ["hot"]
