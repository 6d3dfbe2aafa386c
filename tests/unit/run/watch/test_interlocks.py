"""Interlocks: one at the edges of its levels, its dwell and its time-out; and beside the sequencer of a fake bench."""

import math
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from run_rig import HoldRig, Passive, instrument_error, sound

from bench.model.clock import NS
from bench.model.errors import ExitStatus
from bench.plan.language.interlocks import InterlockRule
from bench.run.context import RunContext
from bench.run.watch.interlocks import InterlockState, InterlockWatch
from bench.run.watch.signals import FRESH_VIRTUAL_S


def rule(**changes: Any) -> InterlockRule:
    values: dict[str, Any] = {
        "name": "air", "signal": "lab_air", "of": "logger", "channel": 101, "unit": "degC", "high": 24.0, "low": 22.0,
        "release_high": 23.8, "release_low": 22.2, "dwell_s": 10.0, "release_after_s": 20.0, "stale_s": None,
        "action": "hold", "where": "station.yaml:1:1",
    }  # fmt: skip
    return InterlockRule(**(values | changes))


AT_ONCE = {"dwell_s": 0.0}
BEGIN_S = 5.0  # of the watch; readings below count from it
STALE = {"stale_s": 60.0}
RELEASED_41 = {0: "tripped", 20: "lasting", 41: "released"}
RELEASED_81 = {0: "tripped", 3: "lasting", 81: "released"}
EDGES: dict[str, tuple[dict[str, Any], dict[float, float | None], dict[float, str]]] = {
    "on a level": (AT_ONCE, {1: 24.0, 2: 22.0}, {}),
    "the next float above": (AT_ONCE, {1: math.nextafter(24.0, 99)}, {1: "tripped"}),
    "the next float below": (AT_ONCE, {1: math.nextafter(22.0, 0)}, {1: "tripped"}),
    "a good value begins the dwell again": ({}, {0: 25, 9: 23, 10: 25, 19: 25, 20: 25}, {20: "tripped"}),
    "it releases on its level, in time": (AT_ONCE, {0: 25, 3: 23.9, 61: 23.8, 80.9: 23.8, 81: 23.8}, RELEASED_81),
    "beyond it the release begins again": (AT_ONCE, {0: 25, 1: 23, 20: 23.81, 21: 23, 40: 23, 41: 23}, RELEASED_41),
    "a gap hides nothing": ({}, {0: 25, 5: None, 10: 25}, {10: "tripped"}),
    "stale, and back": (
        STALE,
        {1: 23, 61: None, 61.1: None, 62: None, 63: 23, 83: 23},
        {61.1: "stale", 83: "released"},
    ),
    "a reading that never came": (STALE, {60: None, 60.001: None}, {60.001: "stale"}),
    "it lasts after two seconds at least": (AT_ONCE, {0: 25, 1.9: 25, 2: 25, 9: 25}, {0: "tripped", 2: "lasting"}),
    "or another dwell": ({}, {0: 25, 10: 25, 19: 25, 20: 25}, {10: "tripped", 20: "lasting"}),
}


def feed(state: InterlockState, *readings: tuple[float, float | None]) -> list[str | None]:
    return [state.take(round((BEGIN_S + t_s) * NS), value) for t_s, value in readings]


def state_of(**changes: Any) -> InterlockState:
    return InterlockState(rule(**changes), round(BEGIN_S * NS))


@pytest.mark.parametrize(("changes", "readings", "told"), EDGES.values(), ids=EDGES)
def test_at_the_edges_of_its_levels_and_times(changes: Any, readings: Any, told: dict[float, str]) -> None:
    assert feed(state_of(**changes), *readings.items()) == [told.get(t_s) for t_s in readings]


@pytest.mark.parametrize("missing", [None, math.nan, math.inf, -math.inf])
def test_no_reading_neither_trips_nor_releases_by_itself(missing: float | None) -> None:
    assert feed(state_of(), (1, missing), (1e6, missing)) == [None, None]
    found = feed(
        state_of(**AT_ONCE, release_after_s=10.0), (0, 25), (1, 23), (8, missing), (11, 23), (20, 23), (21, 23)
    )
    assert [one for one in found if one != "lasting"] == ["tripped", None, None, None, "released"]


def test_it_trips_when_the_dwell_is_over_and_not_before() -> None:
    assert feed(state_of(), (5, 25), (14.999999999, 25), (15, 25)) == [None, None, "tripped"]


@pytest.mark.parametrize("seed", range(20))
def test_every_trip_and_release_is_what_the_readings_of_its_time_say(seed: int) -> None:
    """Against the definition, evaluated anew at every moment from the whole history."""
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    one = rule(dwell_s=float(rng.integers(0, 5)), release_after_s=float(rng.integers(0, 5)))
    values = np.round(23.0 + np.cumsum(rng.normal(0, 0.25, 400)) * 0.3, 2)
    state, tripped = InterlockState(one, 0), False
    since = 0  # the readings before the last change count no more
    for t_s, value in enumerate(values):
        found = state.take(t_s * NS, float(value))
        history = values[since : t_s + 1]
        wanted = [one.back(x) if tripped else one.beyond(x) for x in history]
        length = next((n for n, ok in enumerate(reversed(wanted)) if not ok), len(wanted))
        due = one.release_after_s if tripped else one.dwell_s
        changes = length > 0 and length - 1 >= due
        assert (found in ("tripped", "released")) == changes, t_s
        if changes:
            tripped, since = not tripped, t_s + 1
        assert state.tripped == tripped


def above(signal: str, high: float, release_high: float, **changes: Any) -> InterlockRule:
    """A rule of a signal without a channel that trips and releases at once."""
    at_once = {"dwell_s": 0.0, "release_after_s": 0.0, "low": None, "release_low": None, "of": "", "channel": None}
    return rule(signal=signal, high=high, release_high=release_high, **(at_once | changes))


HOT = above("chamber_air", 50.0, 45.0, name="hot")


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    """As often as under the wall clock, nearly: these runs are short."""
    monkeypatch.setattr("bench.run.watch.interlocks.LOOK_VIRTUAL_S", 10.0)
    monkeypatch.setattr("bench.run.watch.interlocks.ASK_VIRTUAL_S", 60.0)


def watching(*rules: InterlockRule, kept: list[InterlockWatch] | None = None) -> Any:
    """Watch beside a run; ``kept`` gets the watch, for a test that reaches into it."""

    @contextmanager
    def beside(context: RunContext) -> Iterator[None]:
        context.interlocks = watch = InterlockWatch(rules, context)
        if kept is not None:
            kept.append(watch)
        with watch.watching():
            yield

    return beside


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
    error = rig.run_beside(watching(replace(HOT, action="abort"))).error
    assert (error.code, error.exit_status) == ("B-RUN-071", ExitStatus.SAFE_AFTER_FAULT)
    assert "chamber_air is 60 degC" in str(error)
    assert 65.0 < rig.called("source.make_safe")[0] <= 145.0


def test_warn_only_says_so(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 20)
    outcome = rig.run_beside(watching(replace(HOT, action="warn")))
    assert outcome.error is None
    assert outcome.slip_s == 0.0
    assert told(rig) == [("tripped", "warn"), ("released", "warn")]
    assert any("interlock hot: chamber_air is 60 degC" in text for text in rig.listener.messages)
    assert rig.events("hold") == []


@pytest.mark.parametrize("action", ["retake", "skip"])
def test_a_lasting_trip_of_retake_or_skip_becomes_a_hold(tmp_path: Path, action: str) -> None:
    rig = chamber_rig(tmp_path)
    rig.air_degC = lambda t_s: 60.0 if 65.0 < t_s < 400.0 else 20.0  # several readings: it is no glitch
    outcome = rig.run_beside(watching(replace(HOT, action=action)))
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
    rig.at(25.0, lambda: watch[0].signals.put("chamber_air", 60.0))
    rig.at(31.0, lambda: watch[0].signals.put("chamber_air", 20.0))
    outcome = rig.run_beside(watching(replace(HOT, action="retake"), kept=watch))
    assert outcome.error is None
    sound(rig, 5)
    assert told(rig) == [("tripped", "retake"), ("released", "retake")]
    assert outcome.slip_s > 0.0
    assert rig.events("hold") == []


def test_an_instrument_that_gives_no_reading_trips_what_must_not_go_stale(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 40)
    rig.air_degC = lambda t_s: 20.0
    rig.at(100.0, lambda: rig.instruments["chamber"].fail.update(measure_air=instrument_error()))
    rig.at(400.0, rig.instruments["chamber"].fail.clear)
    outcome = rig.run_beside(watching(replace(HOT, stale_s=130.0)))
    assert outcome.error is None
    sound(rig, 40)
    assert told(rig) == [("stale", "hold"), ("released", "hold")]
    assert rig.events("interlock")[0]["value"] is None
    assert "no reading of chamber_air for more than 130 s" in rig.events("hold")[0]["reason"]
    assert {event["code"] for event in rig.events("error")} == {"B-INST-001"}


def test_an_instrument_in_use_is_not_asked(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 8)
    with ExitStack() as stack:
        rig.at(50.0, lambda: stack.enter_context(rig.ran.in_use.take("chamber")))
        rig.run_beside(watching(HOT))
    assert [t_s for t_s in rig.called("chamber.measure_air") if t_s > 50.0] == []


def test_what_comes_due_while_all_is_read_anew_waits_for_nobody(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 1)
    rig.instruments["chamber"].measure_air = lambda: rig.clock.sleep(70.0) or 20.0  # type: ignore[attr-defined]
    watch = InterlockWatch([HOT], rig.context())
    with watch.watching():
        reading = threading.Thread(target=watch.look_again, daemon=True)
        reading.start()
        reading.join(30.0)
        assert not reading.is_alive()


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
    watch = InterlockWatch([HOT], context)
    watch.signals.ask()
    assert held == [True]
    assert lock.acquire(blocking=False)


@pytest.mark.parametrize(
    ("points", "scans", "trips", "surroundings"),
    [(60, [23.0, 23.1, 24.5], [], [23.0, 23.1, 24.5]), (80, [24.5], [("tripped", "warn")], [24.5] * 4)],
)
def test_laboratory_air_comes_from_its_channel_of_the_logger(
    tmp_path: Path, points: int, scans: list[float], trips: list[Any], surroundings: list[float]
) -> None:
    """One scan in five minutes: 900 s hold readings at 60, 360 and 660 s."""
    rig = HoldRig(tmp_path, points)
    logger: Any = Passive("logger", rig)
    rig.instruments["logger"] = logger
    logger.options = {"channels": [103, 101]}
    logger.scan = lambda: [30.0, scans.pop(0) if len(scans) > 1 else scans[0]]
    assert rig.run_beside(watching(rule(action="warn", dwell_s=100.0))).error is None
    assert told(rig) == trips
    assert [event["degC"]["101"] for event in rig.events("surroundings")] == surroundings


def test_a_silent_link_holds_and_the_held_run_goes_on_when_it_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.run.watch.interlocks.LOOK_VIRTUAL_S", 0.5)
    rig = HoldRig(tmp_path, 20)
    rig.port_a.dropped = lambda counter: 10_000 <= counter < 14_000
    silent = above("link_age", 3.0, 1.0, name="link", of="port_a", unit="s")
    outcome = rig.run_beside(watching(silent))
    assert outcome.error is None
    sound(rig, 20)
    assert told(rig) == [("tripped", "hold"), ("released", "hold")]


def test_shares_of_lost_and_bad_frames_are_those_of_the_last_while(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 20)
    rig.port_a.dropped = lambda counter: 10_000 <= counter < 12_000 and counter % 10 == 0
    lossy = above("link_loss", 0.05, 0.01, name="loss", of="port_a", unit="1", action="warn")
    rig.run_beside(watching(lossy))
    assert told(rig) == [("tripped", "warn"), ("released", "warn")]
    first, _ = rig.events("interlock")
    assert 0.05 < first["value"] <= 0.1 + 1e-9


@pytest.mark.parametrize(("step_Hz", "trips"), [(0, []), (400, [("tripped", "warn")])])
def test_a_jump_of_the_rate_inside_a_record_is_seen(tmp_path: Path, step_Hz: int, trips: list[Any]) -> None:
    rig = HoldRig(tmp_path, 3)
    rig.port_a.npp[0] = 7
    jump = above("rate_step", 50.0, 50.0, name="jump", unit="Hz", action="warn")
    rig.at(25.0, lambda: rig.port_a.npp.__setitem__(0, 7 + step_Hz // 100))  # half-way through the second record
    rig.run_beside(watching(jump))
    assert told(rig)[:1] == trips
    if trips:
        assert rig.events("interlock")[0]["value"] == pytest.approx(400.0, rel=0.3)


def test_temperature_slope_is_that_of_the_last_minutes(tmp_path: Path) -> None:
    rig = chamber_rig(tmp_path, 1)
    rig.air_degC = lambda t_s: 20.0 + 0.7 * t_s / 60.0
    slope = above("chamber_slope", 0.5, 0.5, unit="degC/min")
    watch = InterlockWatch([slope], rig.context())
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
    rules = [above(name, 1e9, 1e9, name=name) for name in ("supply_current", "supply_voltage", "unit_temperature")]
    context = rig.context()
    watch = InterlockWatch(rules, context)
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
    watch = InterlockWatch([HOT], rig.context())
    watch.signals.put("chamber_air", 60.0)
    rig.stop.shield()
    watch.take()
    assert rig.events("interlock") == []
    watch = InterlockWatch([replace(HOT, action="abort")], chamber_rig(tmp_path, 1).context())
    watch.signals.put("chamber_air", 60.5)
    watch.take()
    assert list(watch.in_the_way()) == ["hot"]
