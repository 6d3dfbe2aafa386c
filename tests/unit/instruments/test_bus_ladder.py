"""The recovery of the bus on the simulated bench: no reply out of step, no long silence, nothing set in vain."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from pyvisa.resources import MessageBasedResource
from scripted import refused
from sim_bench import DRIVERS, Bench, open_bench

from bench.model.clock import NS
from bench.model.errors import InstrumentError

SEED = 41


@pytest.fixture
def bench() -> Iterator[Bench]:
    with open_bench(seed=SEED) as opened:
        yield opened


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
    device = bench.world.instruments["supply"]
    faults = bench.world.faults.instrument("supply")
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
    supply = bench.driver("supply", transport(bench.open("supply")))
    supply.identify()
    bench.log.lines = MagicMock()
    wrong, unanswered = ask_with_late_replies(bench, supply, queries, share)
    print(f"seed {SEED}: {wrong} wrong, {unanswered} unanswered")
    assert wrong == 0
    assert 0 < unanswered < queries // 4


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("name", DRIVERS)
def test_a_mute_instrument_costs_half_a_second_in_a_hurry(bench: Bench, name: str, known: bool) -> None:
    driver = bench.driver(name, reopen=lambda: pytest.fail("no time for that"))
    if known:
        driver.identify()
    bench.world.faults.instrument(name).mute = True
    began_ns = bench.clock.now_ns()
    with driver.quick(0.45), refused("B-INST-001"):
        driver.make_safe()
    assert bench.clock.now_ns() - began_ns <= 0.5 * NS


@pytest.mark.parametrize("name", DRIVERS)
def test_a_session_that_is_gone_is_opened_again_on_the_way_to_the_safe_state(bench: Bench, name: str) -> None:
    driver = bench.driver(name, reopen=lambda: bench.open(name))
    driver.identify()
    driver.bus.release()
    driver.make_safe()
    assert sum(line[2] == "<open>" for line in bench.log.lines) == 1


def test_calibrator_and_switch_are_safe_within_a_second_of_opening_them(bench: Bench) -> None:
    before = bench.driver("calibrator"), bench.driver("switch")
    before[1].route(3, 1)
    before[0].output(0.01)
    before[0].operate()
    assert bench.world.wiring.loop_current_A > 0.0
    began_ns = bench.clock.now_ns()
    for name in ("calibrator", "switch"):
        driver = bench.driver(name)
        with driver.quick(0.45):
            driver.make_safe()
        print(f"{name}: {(bench.clock.now_ns() - began_ns) / NS:.3f} s after the start")
    assert bench.clock.now_ns() - began_ns < NS
    assert bench.world.wiring.loop_current_A == 0.0
    assert bench.world.wiring.closed == frozenset()


@pytest.mark.parametrize("dialect", ["3800", "8800"])
def test_a_running_chamber_is_held_and_a_stopped_one_left_stopped(bench: Bench, dialect: str) -> None:
    device = bench.world.instruments["chamber"]
    device.dialect, device.identity = dialect, f"{dialect} CONTROLLER"
    chamber = bench.driver("chamber", options={"dialect": dialect})
    chamber.make_safe()
    assert device.mode == 2
    chamber.set_temperature(50.0, 1.0)
    chamber.run()
    bench.clock.sleep(600.0)
    chamber.make_safe()
    held_degC = float(bench.world.thermal.setpoint_degC(bench.clock.now_ns()))
    assert held_degC == pytest.approx(33.0, abs=0.2)
    heard = len(bench.log.lines)
    chamber.make_safe()
    asked = ["MODE?", "STAT?"] if dialect == "8800" else ["MODE?"]
    assert [text for _, way, text, _ in bench.log.lines[heard:] if way == "tx"] == asked
    bench.clock.sleep(3600.0)
    assert chamber.measure_air() == pytest.approx(held_degC, abs=0.5)
    chamber.run()
    bench.clock.sleep(3600.0)
    assert chamber.measure_air() == pytest.approx(50.0, abs=0.5)
    chamber.stop()
    assert device.mode == 2


def test_a_chamber_that_does_not_hold_or_shall_not_is_stopped(bench: Bench) -> None:
    chamber = bench.driver("chamber")
    chamber.set_temperature(50.0, 1.0)
    chamber.run()
    device = bench.world.instruments["chamber"]
    execute = device.execute
    device.execute = lambda message: None if message == "HOLD" else execute(message)
    chamber.make_safe()
    assert device.mode == 2
    chamber = bench.driver("chamber", options={"safe_state": "stop"})
    chamber.set_temperature(50.0, 1.0)
    chamber.run()
    chamber.make_safe()
    assert bench.world.instruments["chamber"].mode == 2


@pytest.mark.parametrize("name", ["supply", "aux_supply"])
@pytest.mark.parametrize(("safe_state", "on"), [("off", False), ("keep", True)])
def test_a_supply_goes_off_or_stays_as_it_is(bench: Bench, name: str, safe_state: str, on: bool) -> None:
    supply = bench.driver(name, options={"safe_state": safe_state})
    if name == "supply":
        supply.configure(15.0, 1.5, 18.0)
    else:
        supply.configure(2, 15.0, 0.5)
    supply.output_on()
    supply.make_safe()
    assert bench.world.instruments[name].on is on


def test_a_relay_closed_by_somebody_else_is_found_when_the_session_is_opened_again(bench: Bench) -> None:
    switch = bench.driver("switch", reopen=lambda: bench.open("switch"))
    switch.route(3, 1)
    other = bench.open("switch")
    other.write_termination = "\n"
    other.write(":CLOS (@1!2!4)")
    switch.bus.release()
    with refused("B-INST-015", "1!2!4"):
        switch.closed()


def test_a_meter_that_was_switched_off_meanwhile_does_not_go_on_measuring(bench: Bench) -> None:
    """Its reading would be of another function: volts for amperes."""
    meter = bench.driver("dmm", reopen=lambda: bench.open("dmm"))
    meter.configure_current(0.1)
    bench.world.instruments["dmm"]._power_on()
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
