"""The recovery of the bus on the simulated bench: no reply out of step, no long silence, nothing set in vain."""

import importlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import pyvisa
from pyvisa.resources import MessageBasedResource
from scripted import refused

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InstrumentError
from bench.model.ports import actions_of
from instruments.wire import LONGEST_CALL_S
from sim_instruments.worlds.simulation import open_world

SEED = 41
DRIVERS = (
    "agilent_33250a", "agilent_34401a", "agilent_34970a", "agilent_53230a", "agilent_e3631a",
    "fluke_5720a", "hp_3458a", "hp_6632b", "keithley_7002", "thermotron_3800",
)  # fmt: skip
ADDRESS = {name: f"GPIB0::{number}::INSTR" for number, name in enumerate(DRIVERS, 1)}


class Bench:
    """A simulated bench with every model once; ``lines`` is the transcript."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.lines: list[tuple[str, str, str, int]] = []
        entries = {name: {"driver": name, "resource": at, "options": {}} for name, at in ADDRESS.items()}
        station = {"instruments": entries, "links": {}}
        self.world = open_world(
            "af_converter", clock=self.clock, seed=SEED, station=station, unit_factory=lambda *_: MagicMock()
        )
        self.visa = pyvisa.ResourceManager(self.world.visa_library)

    def open(self, name: str) -> MessageBasedResource:
        return self.visa.open_resource(ADDRESS[name], resource_pyclass=MessageBasedResource)  # type: ignore[return-value]

    def driver(self, name: str, resource: Any = None, rungs: dict[str, Any] | None = None, **options: Any) -> Any:
        return importlib.import_module(f"instruments.{name}").DRIVER(
            resource or self.open(name), role=name, clock=self.clock, options=options,
            transcript=lambda *line: self.lines.append(line), **(rungs or {}),
        )  # fmt: skip

    def sent(self) -> list[str]:
        return [text for _, direction, text, _ in self.lines if direction == "tx" and not text.startswith("<")]

    def close(self) -> None:
        self.visa.close()
        self.world.close()


WHO_IS_THERE = {"*IDN?", "IDEN?", "END ALWAYS", "ID?"}


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


class WithoutClear:
    """A resource on a transport that knows neither device clear nor serial poll, as a raw socket does."""

    def __init__(self, resource: MessageBasedResource) -> None:
        vars(self)["_inner"] = resource

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._inner, name, value)

    def clear(self) -> None:
        raise NotImplementedError

    def read_stb(self) -> int:
        raise NotImplementedError


# without a clear some seconds pass after a time-out until it is sure what is answered: then there are fewer of them
TRANSPORTS = [pytest.param(lambda resource: resource, 0.1, id="cleared"), pytest.param(WithoutClear, 0.01, id="echoed")]


def ask_with_late_replies(bench: Bench, supply: Any, queries: int, share: float) -> tuple[int, int]:
    """Ask that often while this share of the replies is late by up to 4 s, up to three in a row.

    Returns how many were wrong, and how many questions had no answer.

    Each question has a setting of its own that changes before it is asked, so another answer cannot be right.
    """
    rng = np.random.default_rng(SEED)
    device = bench.world.instruments["hp_6632b"]
    faults = bench.world.faults.instrument("hp_6632b")
    settings = {"VOLT?": "voltage_V", "CURR?": "current_A", "VOLT:PROT?": "trip_V"}
    wrong = unanswered = 0
    late = rng.random(queries) < share
    delays_s, in_a_row = rng.uniform(0.5, 4.0, queries), rng.integers(1, 4, queries)
    for number, question in enumerate(rng.choice(list(settings), queries)):
        wanted = 1.0 + number  # six digits are told
        setattr(device, settings[question], wanted)
        if late[number]:
            faults.late_s, faults.late_replies = delays_s[number], int(in_a_row[number])
        try:
            wrong += supply.ask(question, float) != wanted
        except InstrumentError:
            unanswered += 1
    return wrong, unanswered


@pytest.mark.parametrize("queries", [2_000, pytest.param(100_000, marks=pytest.mark.sweep)])
@pytest.mark.parametrize(("transport", "share"), TRANSPORTS)
def test_no_reply_is_taken_for_another_answer(
    bench: Bench, transport: Callable[[Any], Any], share: float, queries: int
) -> None:
    supply = bench.driver("hp_6632b", transport(bench.open("hp_6632b")))
    supply.identify()
    bench.lines = MagicMock()
    wrong, unanswered = ask_with_late_replies(bench, supply, queries, share)
    print(f"seed {SEED}: {wrong} wrong, {unanswered} unanswered")
    assert wrong == 0
    assert 0 < unanswered < queries // 4


@pytest.mark.parametrize("name", DRIVERS)
def test_a_mute_instrument_leaves_no_long_silence_in_the_transcript(bench: Bench, name: str) -> None:
    """The sign of life of the run: on the whole ladder no more than 1.5 s pass between two lines."""
    rungs = {"reopen": lambda: bench.open(name), "interface_clear": lambda: None}
    driver = bench.driver(name, rungs=rungs)
    driver.identify()
    bench.world.faults.instrument(name).mute = True
    bench.lines.clear()
    began_ns = bench.clock.now_ns()
    with pytest.raises(InstrumentError):
        driver.make_safe()
    times = np.array([began_ns, *(line[3] for line in bench.lines), bench.clock.now_ns()])
    assert np.diff(times).max() <= LONGEST_CALL_S * NS
    assert times[-1] - times[0] < 20 * NS


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("name", DRIVERS)
def test_a_mute_instrument_costs_half_a_second_in_a_hurry(bench: Bench, name: str, known: bool) -> None:
    driver = bench.driver(name, rungs={"reopen": lambda: pytest.fail("no time for that")})
    if known:
        driver.identify()
    bench.world.faults.instrument(name).mute = True
    began_ns = bench.clock.now_ns()
    with driver.quick(0.45), refused("B-INST-001"):
        driver.make_safe()
    assert bench.clock.now_ns() - began_ns <= 0.5 * NS


@pytest.mark.parametrize("name", DRIVERS)
def test_a_session_that_is_gone_is_opened_again_on_the_way_to_the_safe_state(bench: Bench, name: str) -> None:
    driver = bench.driver(name, rungs={"reopen": lambda: bench.open(name)})
    driver.identify()
    driver.bus.release()
    driver.make_safe()
    assert sum(line[2] == "<open>" for line in bench.lines) == 1


def test_calibrator_and_switch_are_safe_within_a_second_of_opening_them(bench: Bench) -> None:
    before = bench.driver("fluke_5720a"), bench.driver("keithley_7002")
    before[1].route(3, 1)
    before[0].output(0.01)
    before[0].operate()
    assert bench.world.wiring.loop_current_A > 0.0
    began_ns = bench.clock.now_ns()
    for name in ("fluke_5720a", "keithley_7002"):
        driver = bench.driver(name)
        with driver.quick(0.45):
            driver.make_safe()
        print(f"{name}: {(bench.clock.now_ns() - began_ns) / NS:.3f} s after the start")
    assert bench.clock.now_ns() - began_ns < NS
    assert bench.world.wiring.loop_current_A == 0.0
    assert bench.world.wiring.closed == frozenset()


def good_arguments(driver: Any, action: str) -> dict[str, Any]:
    return {
        parameter.name: parameter.choices[0] if parameter.choices else parameter.high
        for parameter in actions_of(type(driver))[action].parameters
    }


@pytest.mark.parametrize("reopened", [False, True])
@pytest.mark.parametrize("name", DRIVERS)
def test_a_wrong_instrument_gets_no_command_whatever_is_asked_of_it(bench: Bench, name: str, reopened: bool) -> None:
    """At its address from the start, or found there when the session was opened again."""
    calls: list[tuple[str, dict[str, Any]]] = [("make_safe", {}), ("identify", {}), ("raw", {"command": "OUTP ON"})]
    calls += [(action, good_arguments(bench.driver(name), action)) for action in actions_of(type(bench.driver(name)))]
    for method, arguments in calls:
        driver = bench.driver(name, rungs={"reopen": lambda: bench.open(name)})
        bench.world.faults.instrument(name).identity = ""
        if reopened:
            driver.identify()
            driver.bus.release()
        bench.world.faults.instrument(name).identity = "ACME,9999,0,1"
        bench.lines.clear()
        if reopened and method in ("identify", "raw"):
            continue
        with pytest.raises(InstrumentError) as caught:
            getattr(driver, method)(**arguments)
        refused_before = caught.value.code in ("B-INST-008", "B-INST-010") and not bench.lines
        assert refused_before or caught.value.code in ("B-INST-002", "B-INST-003", "B-INST-016"), (method, caught.value)
        opened = max((i for i, line in enumerate(bench.lines) if line[2] == "<open>"), default=-1)
        heard = [text for _, direction, text, _ in bench.lines[opened + 1 :] if direction == "tx"]
        if reopened and opened < 0:
            continue  # it went into a session that was closed: nobody heard it
        assert {text for text in heard if not text.startswith("<")} <= WHO_IS_THERE, method


NO_NUMBERS = [
    "nan",
    "NAN",
    "+INF",
    "-INF",
    "9.9E37",
    "-9.90E+37",
    "9.91E37",
    "-1e38",
    "1E400",
    "OVLD",
    "",
    "1.0 V",
    "1_0",
]
READINGS = [
    ("agilent_34401a", "measure_resistance", {"range": 100.0, "cycles": 1}),
    ("agilent_34401a", "measure_voltage", {}),
    ("agilent_34970a", "measure_resistance", {"channel": 103, "range": 100.0, "cycles": 1}),
    ("agilent_34970a", "scan", {}),
    ("agilent_53230a", "measure_frequency", {"gate": 0.1}),
    ("agilent_e3631a", "measure_voltage", {"rail": 1}),
    ("hp_3458a", "measure_current", {}),
    ("hp_6632b", "measure_voltage", {}),
    ("hp_6632b", "measure_current", {}),
    ("thermotron_3800", "measure_air", {}),
]
ASKED = ("READ?", "MEAS:VOLT?", "MEAS:CURR?", "TRIG SGL", "PVAR1?")


def test_every_reading_is_in_the_list() -> None:
    declared = {
        (name, action.name)
        for name in DRIVERS
        for action in actions_of(importlib.import_module(f"instruments.{name}").DRIVER).values()
        if action.returns
    }
    assert declared == {reading[:2] for reading in READINGS}


@pytest.mark.parametrize(("name", "reading", "arguments"), READINGS)
def test_what_is_no_reading_is_never_a_number(bench: Bench, name: str, reading: str, arguments: dict[str, Any]) -> None:
    driver = bench.driver(name)
    driver.identify()
    device = bench.world.instruments[name]
    plain, execute = device.reply, device.execute
    state = {"text": "", "asked": False}

    def heard(message: str) -> None:
        state["asked"] = message in ASKED
        execute(message)

    device.execute = heard
    device.reply = lambda text, **how: plain(state["text"] if state["asked"] else text, **how)
    for text in NO_NUMBERS:
        state["text"] = f"{text},{text}" if reading == "scan" else text
        with pytest.raises(InstrumentError) as caught:
            getattr(driver, reading)(**arguments)
        assert caught.value.code in ("B-INST-007", "B-INST-004"), text


@pytest.mark.parametrize("dialect", ["3800", "8800"])
def test_a_running_chamber_is_held_and_a_stopped_one_left_stopped(bench: Bench, dialect: str) -> None:
    device = bench.world.instruments["thermotron_3800"]
    device.dialect, device.identity = dialect, f"{dialect} CONTROLLER"
    chamber = bench.driver("thermotron_3800", dialect=dialect)
    chamber.make_safe()
    assert device.mode == 2
    chamber.set_temperature(50.0, 1.0)
    chamber.run()
    bench.clock.sleep(600.0)
    chamber.make_safe()
    held_degC = float(bench.world.thermal.setpoint_degC(bench.clock.now_ns()))
    assert held_degC == pytest.approx(33.0, abs=0.2)
    sent = len(bench.sent())
    chamber.make_safe()
    assert bench.sent()[sent:] == ["MODE?"]
    bench.clock.sleep(3600.0)
    assert chamber.measure_air() == pytest.approx(held_degC, abs=0.5)
    chamber.run()
    bench.clock.sleep(3600.0)
    assert chamber.measure_air() == pytest.approx(50.0, abs=0.5)
    chamber.stop()
    assert device.mode == 2


def test_a_chamber_that_does_not_hold_or_shall_not_is_stopped(bench: Bench) -> None:
    chamber = bench.driver("thermotron_3800")
    chamber.set_temperature(50.0, 1.0)
    chamber.run()
    device = bench.world.instruments["thermotron_3800"]
    execute = device.execute
    device.execute = lambda message: None if message == "HOLD" else execute(message)
    chamber.make_safe()
    assert device.mode == 2
    chamber = bench.driver("thermotron_3800", safe_state="stop")
    chamber.set_temperature(50.0, 1.0)
    chamber.run()
    chamber.make_safe()
    assert bench.world.instruments["thermotron_3800"].mode == 2


@pytest.mark.parametrize("name", ["hp_6632b", "agilent_e3631a"])
@pytest.mark.parametrize(("safe_state", "on"), [("off", False), ("keep", True)])
def test_a_supply_goes_off_or_stays_as_it_is(bench: Bench, name: str, safe_state: str, on: bool) -> None:
    supply = bench.driver(name, safe_state=safe_state)
    if name == "hp_6632b":
        supply.configure(15.0, 1.5, 18.0)
    else:
        supply.configure(2, 15.0, 0.5)
    supply.output_on()
    supply.make_safe()
    assert bench.world.instruments[name].on is on


def prepared(bench: Bench, name: str) -> tuple[Any, Callable[[], None]]:
    """A driver that is ready to switch on, and how to switch on."""
    driver = bench.driver(name)
    if name == "fluke_5720a":
        bench.driver("keithley_7002").route(1, 1)
        driver.output(0.001)
        return driver, driver.operate
    if name == "agilent_33250a":
        driver.square(1e7, 2.5)
    elif name == "hp_6632b":
        driver.configure(15.0, 1.5, 18.0)
    else:
        driver.configure(2, 15.0, 0.5)
        driver.configure(3, -15.0, 0.5)
    return driver, driver.output_on


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("fluke_5720a", "OUT 2.0E-01 A, 0 HZ"),
        ("agilent_33250a", "FREQ 1.1E7"),
        ("agilent_33250a", "VOLT 5"),
        ("hp_6632b", "VOLT 17"),
        ("hp_6632b", "VOLT:PROT 22"),
        ("hp_6632b", "CURR 5"),
        ("agilent_e3631a", "INST:NSEL 2;:VOLT 25"),
        ("agilent_e3631a", "INST:NSEL 3;:CURR 1"),
    ],
)
def test_nothing_is_switched_on_that_somebody_else_has_changed(bench: Bench, name: str, changed: str) -> None:
    _, switch_on = prepared(bench, name)
    other = bench.open(name)
    other.write_termination = "\n"
    other.write(changed)
    bench.lines.clear()
    with refused("B-INST-011", "reads back"):
        switch_on()
    assert not {"OPER", "OUTP ON"} & set(bench.sent())


def test_a_relay_closed_by_somebody_else_is_found_when_the_session_is_opened_again(bench: Bench) -> None:
    switch = bench.driver("keithley_7002", rungs={"reopen": lambda: bench.open("keithley_7002")})
    switch.route(3, 1)
    other = bench.open("keithley_7002")
    other.write_termination = "\n"
    other.write(":CLOS (@1!2!4)")
    switch.bus.release()
    with refused("B-INST-015", "1!2!4"):
        switch.closed()


def test_a_meter_that_was_switched_off_meanwhile_does_not_go_on_measuring(bench: Bench) -> None:
    """Its reading would be of another function: volts for amperes."""
    meter = bench.driver("hp_3458a", rungs={"reopen": lambda: bench.open("hp_3458a")})
    meter.configure_current(0.1)
    bench.world.instruments["hp_3458a"]._power_on()
    meter.bus.release()
    with refused("B-INST-011", "RANGE"):
        meter.ask("RANGE?", float)


REMARK = """
import warnings, instruments.wire
for module in ("instruments.wire", "instruments.bus", "somewhere.else"):
    text = "read string doesn't end with termination characters"
    warnings.warn_explicit(text, UserWarning, module + ".py", 1, module=module)
"""


def test_a_reply_without_a_line_feed_is_no_warning_of_the_program() -> None:
    done = subprocess.run([sys.executable, "-c", REMARK], capture_output=True, text=True, check=True)
    assert done.stderr.count("UserWarning") == 1
    assert "somewhere.else" in done.stderr
