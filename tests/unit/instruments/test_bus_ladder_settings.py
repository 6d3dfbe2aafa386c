"""Safe states that are options, settings that somebody else has changed, remarks of PyVISA; on the simulated bench."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from bus_bench import Bench
from scripted import refused


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


# --- the safe state of a chamber and of a supply -----------------------------------------------------------------


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


def test_a_chamber_that_does_not_hold_is_stopped(bench: Bench) -> None:
    chamber = bench.driver("thermotron_3800")
    chamber.set_temperature(50.0, 1.0)
    chamber.run()
    device = bench.world.instruments["thermotron_3800"]
    execute = device.execute
    device.execute = lambda message: None if message == "HOLD" else execute(message)
    chamber.make_safe()
    assert device.mode == 2


def test_a_chamber_whose_safe_state_is_to_stop(bench: Bench) -> None:
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


# --- what somebody else has changed ------------------------------------------------------------------------------


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


@pytest.mark.parametrize("name", ["fluke_5720a", "agilent_33250a", "hp_6632b", "agilent_e3631a"])
def test_what_nobody_has_changed_is_switched_on(bench: Bench, name: str) -> None:
    prepared(bench, name)[1]()


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


# --- remarks of the VISA library ---------------------------------------------------------------------------------

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
