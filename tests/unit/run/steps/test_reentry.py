"""The way back into a plan: what is done again, in which order, and when the unit is soaked again."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from run_rig import Rig, instrument_error

from bench.model.clock import NS
from bench.model.drivers import driver_class
from bench.model.errors import LinkError, RunError
from bench.model.ports import Action, actions_of, drivers_of
from bench.run.context import RunContext
from bench.run.control.channel import Control
from bench.run.links.keeper import keep_links
from bench.run.setpoints import differences, expected_of, read_back, steps_again, stimulus_again
from bench.run.steps.reentry import come_back, enter
from bench.run.stop import Interruption, Wish

SOAK = {"temperature": 20.0, "ramp": 0.5, "slot": 600.0, "within": 1.0, "for": 120.0, "sensor": "unit", "late": "abort"}


def soaked_rig(folder: Path) -> Rig:
    rig = Rig(folder, "calibrator", "chamber")
    rig.step("soak", "chamber", "soak", **SOAK)
    rig.step("call", "calibrator", "output", current=1.0)
    return rig


def chamber_calls(rig: Rig) -> list[tuple[str, tuple[object, ...]]]:
    return [(name, words) for _, name, words in rig.calls if name in ("chamber.set_temperature", "chamber.run")]


SET_AND_RUN = [("chamber.set_temperature", (20.0, 0.5)), ("chamber.run", ())]


@pytest.mark.parametrize(
    ("way", "unit_degC", "calls", "soaked"),
    [
        (enter, 20.9, SET_AND_RUN, False),  # a run that is gone on with tells the chamber in any case
        (enter, 18.5, SET_AND_RUN, True),
        (come_back, 19.5, [], False),  # behind a hold nothing is sent while the unit is in its band
        (come_back, 15.0, SET_AND_RUN, True),
    ],
)
def test_outside_its_band_the_unit_is_soaked_again_for_the_whole_slot_and_inside_it_is_not(
    tmp_path: Path, way: Callable[[RunContext, int], None], unit_degC: float, calls: list[Any], soaked: bool
) -> None:
    rig = soaked_rig(tmp_path)
    rig.unit_degC = lambda t_s: unit_degC if not soaked or t_s < 200.0 else 20.0
    context = rig.context()
    rig.clock.sleep(1.0)
    before = context.timeline
    way(context, 1)
    assert chamber_calls(rig) == calls
    (event,) = rig.events("reentry")
    assert (event["soaked"], event["target_degC"], event["unit_degC"]) == (soaked, 20.0, pytest.approx(unit_degC))
    assert rig.clock.now_ns() >= 600e9 if soaked else rig.clock.now_ns() < 20e9
    assert (context.timeline is before, context.settled) == (True, True)


def test_a_unit_that_says_nothing_is_soaked_again_and_judged(tmp_path: Path) -> None:
    rig = soaked_rig(tmp_path)
    rig.port_b.silent = True
    context = rig.context()
    with pytest.raises(RunError, match="B-RUN-031"):
        enter(context, 1)


def test_before_any_soak_and_at_the_end_no_temperature_is_due(tmp_path: Path) -> None:
    rig = soaked_rig(tmp_path)
    rig.step("call", "calibrator", "output", current=0.0, phase="finally")
    context = rig.context()
    enter(context, 0)
    enter(context, 2)
    assert chamber_calls(rig) == []
    assert rig.events("reentry") == []


def test_a_stop_still_ends_a_soak_that_is_done_again(tmp_path: Path) -> None:
    rig = soaked_rig(tmp_path)
    rig.unit_degC = lambda t_s: 10.0
    context = rig.context()
    rig.stop.holds.wish(Wish("retake", "test", "has to wait"))
    rig.clock.every(100.0, lambda: rig.stop.request("SIGTERM"), observer=False)
    with pytest.raises(Exception, match="B-RUN-010"):
        enter(context, 1)
    assert not context.stop.deferred


DRIVERS = {
    "calibrator": "fluke_5720a",
    "switch": "keithley_7002",
    "chamber": "thermotron_3800",
    "supply": "hp_6632b",
    "aux_supply": "agilent_e3631a",
    "function_generator": "agilent_33250a",
    "dmm": "hp_3458a",
}


def declared() -> dict[str, dict[str, Action]]:
    return {role: actions_of(driver_class(name)) for role, name in DRIVERS.items()}


def again(rig: Rig) -> list[str]:
    plan: Any = SimpleNamespace(steps=tuple(rig.steps))
    found = steps_again(plan, len(rig.steps), declared())

    return [f"{one.role}.{one.name}{one.told().get('rail', '')}" if one.kind != "settle" else "settle" for one in found]


def test_the_last_call_of_each_action_and_rail_settings_first(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.step("prompt", text="no")
    rig.step("call", "calibrator", "output", current=1.0)
    rig.step("call", "switch", "route", channel=1, polarity=1)
    rig.step("call", "chamber", "set_temperature", temperature=1.0, ramp=1.0)
    rig.step("call", "supply", "configure", voltage=18.0)
    rig.step("call", "supply", "output_on")
    rig.step("call", "aux_supply", "configure", rail=1, voltage=5.0)
    rig.step("call", "aux_supply", "configure", rail=2, voltage=15.0)
    rig.step("call", "aux_supply", "output_on")
    rig.step("call", "supply", "configure", voltage=24.0)
    rig.step("call", "supply", "measure_current")
    rig.step("call", "function_generator", "square", frequency=1e7, amplitude=1.0)
    rig.step("call", "function_generator", "output_on")
    rig.step("settle", duration_s=10.0)
    rig.step("unit", "port_b", "stop_stream", command=1)
    rig.step("unit", "port_b", "start_stream", command=2)
    rig.step("settle", duration_s=5.0)
    rig.step("send", "function_generator", "", text="DISP OFF")
    rig.step("send", "function_generator", "", text="DISP ON")
    rig.step("send", "function_generator", "", text="DISP?")
    rig.step("send", "calibrator", "", text="OPER")
    assert again(rig) == [
        "aux_supply.configure1", "aux_supply.configure2", "supply.configure", "function_generator.square",
        "supply.output_on", "aux_supply.output_on", "function_generator.output_on", "settle",
        "function_generator.", "port_b.stop_stream", "port_b.start_stream", "settle",
    ]  # fmt: skip
    plan: Any = SimpleNamespace(steps=tuple(rig.steps))
    done = steps_again(plan, len(rig.steps), declared())
    assert [one.arguments["voltage"] for one in done if one.role == "supply" and one.name == "configure"] == [24.0]
    assert [one.text for one in done if one.kind == "send"] == ["DISP ON"]


def test_what_was_switched_off_stays_off(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.step("call", "supply", "configure", voltage=18.0)
    rig.step("call", "supply", "output_on")
    rig.step("call", "supply", "output_off")
    assert again(rig) == ["supply.configure", "supply.output_off"], "not on for a moment: somebody may be at the board"


LEVEL = "calibrator.output"
ON, OFF, RECORD = "calibrator.operate", "calibrator.standby", "port_a.record"


@pytest.mark.parametrize(
    ("plan", "at", "back"),
    [
        ((LEVEL, ON, "settle", RECORD), 3, (LEVEL, ON, "settle")),
        ((ON, LEVEL, "switch.route", RECORD), 3, (LEVEL, ON, "switch.route")),
        ((LEVEL, ON, LEVEL, RECORD, "dmm.measure_voltage"), 4, (LEVEL, ON)),  # of a level the last one
        ((LEVEL, ON, RECORD, OFF, LEVEL, ON, RECORD), 3, ()),  # the plan does so before it records
        ((LEVEL, ON, RECORD, LEVEL, RECORD), 3, (LEVEL, ON)),  # it was on
        ((LEVEL, RECORD, ON, RECORD), 1, (LEVEL,)),  # what will be switched on with it
        ((LEVEL, ON, "switch.route", OFF, "switch.open_all", RECORD), 5, ()),
        (("calibrator A 1", "calibrator B 1", "settle", RECORD), 3, ("calibrator A 1", "calibrator B 1", "settle")),
        (("calibrator A", "calibrator B 1", RECORD, "calibrator A 2"), 3, ("calibrator A", "calibrator B 1")),
        (("calibrator OUT 1 mA", OFF, RECORD), 2, ()),
        ((LEVEL, ON, RECORD, "finally"), 3, ()),
    ],
)  # fmt: skip
def test_a_stimulus_that_was_on_is_on_again_unless_the_plan_switches_it_anew(
    tmp_path: Path, plan: tuple[str, ...], at: int, back: tuple[str, ...]
) -> None:
    rig = Rig(tmp_path)
    for number, text in enumerate(plan):
        role, _, name = text.partition(".")
        if name:
            rig.step(
                "record" if name == "record" else "call", role, name, **({"current": number} if text == LEVEL else {})
            )
        elif " " in text:
            rig.step("send", text.split()[0], "", text=text.partition(" ")[2])
        else:
            rig.step("settle", duration_s=1.0, phase="finally" if text == "finally" else "main")
    found = stimulus_again(tuple(rig.steps), at, declared())
    said = {"call": "{0.role}.{0.name}", "send": "{0.role} {0.text}", "settle": "settle"}
    assert tuple(said[step.kind].format(step).strip() for step in found) == back
    levels = [number for number, text in enumerate(plan[:at]) if text == LEVEL]
    assert [step.number for step in found if step.name == "output"] == levels[-1:] * (LEVEL in back)


def warmed(folder: Path, *, behind_s: float) -> Rig:
    rig = Rig(folder, "supply")
    rig.step("settle", duration_s=900.0, bus_s=0.0, phase="prepare")
    rig.step("call", "supply", "output_on", phase="prepare")
    rig.step("settle", duration_s=6.0, bus_s=0.0, phase="prepare")
    rig.step("settle", duration_s=behind_s, bus_s=0.0, phase="prepare")
    rig.step("settle", duration_s=1000.0, bus_s=0.0)
    rig.step("settle", duration_s=1.0, bus_s=0.0)
    rig.step("settle", duration_s=1.0, bus_s=0.0, phase="finally")
    return rig


@pytest.mark.parametrize(
    ("start", "due_s"),
    [(5, 300.0), (4, 300.0), (3, 6.0), (1, 0.0), (6, 0.0)],
)
def test_what_was_off_warms_up_again(tmp_path: Path, start: int, due_s: float) -> None:
    """As long as the longest settle time of the preparation, from when it was switched on; not for the end."""
    rig = warmed(tmp_path, behind_s=300.0)
    context = rig.context()
    began_ns = rig.clock.now_ns()
    enter(context, start)
    assert (rig.clock.now_ns() - began_ns) / NS == pytest.approx(due_s)
    assert any("warming up again" in text for text in rig.listener.messages) == (due_s > 0.0)


def entry(number: int, **setpoint: Any) -> Any:
    return SimpleNamespace(number=number, setpoint={name.replace("__", "."): value for name, value in setpoint.items()})


def test_a_step_says_what_it_set(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "calibrator", "chamber")
    actions = drivers_of(rig.instruments)
    output = rig.step("call", "calibrator", "output", current=1.0)
    assert output.confirmed(actions["calibrator"]) == {"calibrator.output": {"current": 1.0}}
    assert rig.step("call", "calibrator", "measure").confirmed(actions.get("calibrator", {})) == {}
    assert rig.step("verify", "calibrator", "operating").confirmed(actions.get("calibrator", {})) == {}
    assert rig.step("record", "port_a", seconds=1.0).confirmed(actions.get("port_a", {})) == {}
    soak = rig.step("soak", "chamber", "soak", **SOAK)
    assert soak.confirmed(actions["chamber"]) == {"chamber.set_temperature": {"temperature": 20.0, "ramp": 0.5}}


def test_the_newest_state_counts() -> None:
    state = expected_of(
        [
            entry(1, calibrator__output={"current": 1.0}),
            entry(2, calibrator__operate={}),
            entry(3, switch__route={"channel": 1}),
            entry(4, calibrator__standby={}),
            entry(5, switch__open_all={}),
            entry(6, switch__route={"channel": 2}),
        ]
    )
    assert state == {"calibrator": {"output": {"current": 1.0}, "standby": {}}, "switch": {"route": {"channel": 2}}}


def test_differences_are_named_and_what_is_as_it_was_is_not() -> None:
    expected = {
        "calibrator": {"output": {"current": 1.0}, "operate": {}},
        "switch": {"route": {"channel": 1, "polarity": 1}},
        "supply": {"configure": {"voltage": 18.0}, "output_on": {}},
        "chamber": {"set_temperature": {"temperature": 50.0, "ramp": 0.5}},
    }
    found = {
        "calibrator": {"operating": False}, "switch": {"closed": ()}, "supply": {"measure_voltage": 0.01},
        "chamber": {"measure_air": 23.0}, "dmm": {"operating": True},
    }  # fmt: skip
    assert len(differences(expected, found)) == 4
    as_it_was = {
        "calibrator": {"operating": True}, "switch": {"closed": ("1!1!1",)}, "supply": {"measure_voltage": 17.9},
        "chamber": {"measure_air": 49.0},
    }  # fmt: skip
    assert differences(expected, as_it_was) == []
    off = {**expected, "supply": {"configure": {"voltage": 18.0}, "output_off": {}}}
    assert differences(off, {"supply": {"measure_voltage": 0.01}}) == []


def test_looking_takes_a_few_seconds_at_most_and_no_answer_is_left_out(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "calibrator", "switch", "chamber")
    rig.instruments["calibrator"].fail["operating"] = instrument_error()
    rig.instruments["calibrator"].slow_s["operating"] = 1.0
    rig.instruments["switch"].slow_s["operating"] = 10.0
    instruments: Any = rig.instruments
    found = read_back(instruments, rig.clock)
    assert found == {"switch": {"operating": True}}
    assert rig.called("chamber.operating") == []


def test_a_port_that_is_pulled_out_on_the_way_back_is_opened_again(tmp_path: Path) -> None:
    """Without its temperature the soak that is done again could only fail."""
    rig = soaked_rig(tmp_path)
    rig.unit_degC = lambda t_s: 15.0 if t_s < 100.0 else 20.0
    context = rig.context()
    port: Any = rig.port_b
    plain, pulled = port.read, [False]

    def read(size: int = 1) -> bytes:
        pulled[0] = pulled[0] or 200e9 < rig.clock.now_ns() < 300e9
        if pulled[0]:
            raise OSError("gone")
        return plain(size)

    def reopen() -> None:
        if rig.clock.now_ns() < 300e9:
            raise LinkError("B-RUN-003", "no such port")
        pulled[0] = False

    port.read, port.reopen = read, reopen
    rig.clock.sleep(1.0)
    with keep_links(context):
        come_back(context, 1)
        assert context.stop.holds.reasons == {}
    assert [event["state"] for event in rig.events("link")] == ["lost", "back"]
    assert [one["soaked"] for one in rig.events("reentry")] == [True]


def test_a_pause_on_the_way_back_counts_from_its_end_on(tmp_path: Path) -> None:
    rig = soaked_rig(tmp_path)
    rig.unit_degC = lambda t_s: 15.0 if t_s < 100.0 else 20.0
    context = rig.context()
    answers: list[dict[str, Any]] = []
    answering = Control(context)
    rig.clock.every(300.0, lambda: answers.append(answering.answer({"command": "pause", "reason": "door"}, "me")))
    rig.clock.sleep(1.0)
    come_back(context, 1)
    assert [answer["ok"] for answer in answers] == [True, True]
    with pytest.raises(Interruption, match="hold: door"):
        context.stop.check()


def test_what_persons_changed_on_the_bench_is_as_before(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.step("prompt", text="put in SIM-1", sets={"unit": "SIM-1", "mounting": "x"})
    rig.step("prompt", text="put in SIM-2", sets={"unit": "SIM-2"})
    rig.step("settle", duration_s=1.0, bus_s=0.0)
    rig.step("prompt", text="put in SIM-3", sets={"unit": "SIM-3"})
    context, done = rig.context(), []
    context.operate = lambda name, value: done.append((name, value))
    enter(context, 3)
    assert done == [("unit", "SIM-2"), ("mounting", "x")]
    assert any("SIM-2" in text for text in rig.listener.messages)


def test_a_test_of_the_unit_is_not_done_again(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.step("unit", "rs422", "stream_start", command=0x20, payload=())
    rig.step("unit", "rs422", "memory", command=0x12, payload=(), item="memory")
    rig.step("unit", "rs422", "memory", command=0x12, payload=())
    rig.step("unit", "rs422", "memory", command=0x12, payload=(1,), item="memory")
    plan: Any = SimpleNamespace(steps=tuple(rig.steps))
    assert [step.number for step in steps_again(plan, 4, {})] == [0, 2]
