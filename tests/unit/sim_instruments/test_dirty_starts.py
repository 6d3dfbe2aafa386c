"""Instruments as their last user left them: after the driver's preparation the stimulus or the reading is right.

Judged by the physics of the simulated bench and not by what reads back; a driver may also say what is wrong.
"""

import importlib
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import pyvisa
from fog_signal import NorthBench, Turning
from gnc_rig import open_table
from pyvisa.resources import MessageBasedResource
from scripted import Log, refused
from sim_bench import ADDRESSES, DRIVERS, Bench, open_bench

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InstrumentError
from sim_instruments.thermotron_3800 import PROGRAM_RUN
from sim_instruments.worlds.simulation import open_world

SEED = 1900
PHI_RAD = 0.576
FREQUENCY_Hz, AMPLITUDE_V, VOLTAGE_V, CURRENT_A = 1e7, 2.5, 15.0, 0.1


def left(bench: Bench, role: str, seed: int) -> Any:
    """Return the driver of an instrument that somebody used before, not yet identified."""
    bench.world.instruments[role].left_by_another(np.random.default_rng([SEED, seed]))
    resource = bench.manager.open_resource(ADDRESSES[role], resource_pyclass=MessageBasedResource)
    driver = importlib.import_module(f"instruments.{DRIVERS[role]}").DRIVER
    return driver(resource, role=role, clock=bench.clock, transcript=Log(), options={})


def soiled(bench: Bench, role: str, seed: int) -> Any:
    """Return the driver of an instrument that somebody used before, identified and prepared."""
    made = left(bench, role, seed)
    made.identify()
    return made


def generator(bench: Bench, seed: int) -> None:
    driver = soiled(bench, "function_generator", seed)
    driver.square(FREQUENCY_Hz, AMPLITUDE_V)
    driver.output_on()
    seen = bench.world.instruments["function_generator"]
    assert seen.function == "SQU"
    assert seen.true_frequency_Hz == pytest.approx(FREQUENCY_Hz, rel=5e-6)
    assert seen.open_amplitude_V == pytest.approx(AMPLITUDE_V, rel=1e-3)
    assert seen.offset_V == 0.0
    assert (seen.polarity, seen.duty_percent) == ("NORM", 50.0)


def counter(bench: Bench, seed: int) -> None:
    source = bench.world.instruments["function_generator"]
    bench.send("function_generator", "FUNC SQU", "FREQ 10 MHz", "OUTP ON")
    driver = soiled(bench, "counter", seed)
    assert driver.measure_frequency(0.1) == pytest.approx(source.true_frequency_Hz, rel=1e-8)


def supply(bench: Bench, seed: int) -> None:
    driver = soiled(bench, "supply", seed)
    driver.configure(VOLTAGE_V, 1.5, 18.0)
    seen = bench.world.instruments["supply"]
    if seen.tripped:
        with pytest.raises(InstrumentError, match=r"B-INST-018: .*latched"):
            driver.output_on()
        assert not seen.on
        seen.tripped = ""  # a person has looked and cleared it
    driver.output_on()
    assert seen.supplied_V == VOLTAGE_V


def meter(bench: Bench, seed: int) -> None:
    bench.send("switch", ":CLOS (@1!1!1)")
    bench.send("calibrator", f"OUT {CURRENT_A:E} A, 0 HZ", "OPER")
    bench.clock.sleep(30.0)
    driver = soiled(bench, "dmm", seed)
    driver.configure_current(CURRENT_A)
    assert driver.measure_current() == pytest.approx(bench.world.wiring.loop_current_A, rel=1e-4)
    assert abs(driver.measure_current()) == pytest.approx(CURRENT_A, rel=2e-4)


def calibrator(bench: Bench, seed: int) -> None:
    bench.send("switch", ":CLOS (@1!1!1)")
    driver = left(bench, "calibrator", seed)
    seen = bench.world.instruments["calibrator"]
    if (seen.offset_A, seen.scale) != (0.0, 1.0):
        with refused("B-INST-019", "active"):
            driver.output(CURRENT_A)
        driver.make_safe()
        assert not seen.operating
        seen.offset_A, seen.scale = 0.0, 1.0  # a person has pressed the keys
    if seen.limits["A"][1] < CURRENT_A:
        with refused("B-INST-005"):
            driver.output(CURRENT_A)
        return
    driver.output(CURRENT_A)
    driver.operate()
    bench.clock.sleep(10.0)
    assert bench.world.wiring.loop_current_A == pytest.approx(CURRENT_A, rel=2e-4)


def switch(bench: Bench, seed: int) -> None:
    driver = soiled(bench, "switch", seed)
    driver.route(3, -1)
    bench.clock.sleep(10.0)
    assert bench.world.instruments["switch"].outputs() == {"closed": ["1!2!3"]}


def chamber(bench: Bench, seed: int) -> None:
    driver = soiled(bench, "chamber", seed)
    seen = bench.world.instruments["chamber"]
    driver.set_temperature(40.0, 5.0)
    if seen.mode == PROGRAM_RUN:
        with pytest.raises(InstrumentError):  # it is somebody else's test
            driver.run()
        return
    driver.run()
    bench.clock.sleep(4 * 3600.0)
    assert float(bench.world.thermal.air_degC(bench.clock.now_ns())) == pytest.approx(40.0, abs=0.1)


def rails(bench: Bench, seed: int) -> None:
    driver = soiled(bench, "aux_supply", seed)
    driver.configure(2, VOLTAGE_V, 0.5)
    driver.configure(3, -VOLTAGE_V, 0.5)
    driver.output_on()
    seen = bench.world.instruments["aux_supply"]
    assert [seen.output(rail)[0] for rail in range(3)] == pytest.approx([0.0, VOLTAGE_V, -VOLTAGE_V], rel=1e-3)


def logger(bench: Bench, seed: int) -> None:
    driver = soiled(bench, "logger", seed)
    thermal, now_ns = bench.world.thermal, bench.clock.now_ns()
    true = [float(thermal.lab_degC(now_ns)), float(thermal.air_degC(now_ns))]
    assert driver.scan() == pytest.approx(true, abs=1.0)


def voltmeter(bench: Bench, seed: int) -> None:
    bench.send("aux_supply", "INST P6V", "VOLT 5", "OUTP ON")
    driver = soiled(bench, "rail_dmm", seed)
    true_V = bench.world.instruments["aux_supply"].output(0)[0]
    assert driver.measure_voltage() == pytest.approx(true_V, rel=1e-4)


ROLES: dict[str, Callable[[Bench, int], None]] = {
    "function_generator": generator, "counter": counter, "supply": supply, "dmm": meter, "calibrator": calibrator,
    "switch": switch, "chamber": chamber, "aux_supply": rails, "logger": logger, "rail_dmm": voltmeter,
}  # fmt: skip


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("starts", [20, pytest.param(1000, marks=pytest.mark.sweep)])
def test_what_the_last_user_left_changes_no_stimulus_and_no_reading(role: str, starts: int) -> None:
    print(f"seed {SEED}: {role}, {starts} starts")
    for seed in range(starts):
        with open_bench() as bench:
            ROLES[role](bench, seed)


@pytest.mark.parametrize("starts", [20, pytest.param(1000, marks=pytest.mark.sweep)])
def test_a_table_that_somebody_left_turns_as_it_is_told(starts: int) -> None:
    """Closed interlocks are told before anything is set; made safe, it is as any other table."""
    for seed in range(starts):
        with open_table() as rig:
            rig.table.left_by_another(np.random.default_rng([SEED, seed]))
            closed = "Closed" in rig.table.outputs()["interlocks"]
            if closed:
                with refused("B-INST-017", "interlock"):
                    rig.ready()
            rig.driver.make_safe()
            driver = rig.ready()
            before = rig.angles()
            driver.turn(3, 400.0, 270.0, 300.0)
            rig.clock.sleep(10.0)
            assert driver.in_position()
            assert rig.angles() == pytest.approx([*before[:2], before[2] + 400.0], abs=2e-3)


@pytest.mark.parametrize("starts", [20, pytest.param(1000, marks=pytest.mark.sweep)])
def test_lock_in_amplifiers_and_their_filter_measure_as_after_a_clean_start(starts: int) -> None:
    for seed in range(starts):
        bench = NorthBench(Turning(lambda turns: np.sin(2 * np.pi * turns + PHI_RAD)), divider=10)
        draw = np.random.default_rng([SEED, seed])
        for role in ("direct", "filtered", "filter"):
            bench.world.instruments[role].left_by_another(draw)
        bench.driver["filter"].configure(1.0)
        for role in ("direct", "filtered"):
            bench.driver[role].configure(0.3, 24, 1.0, "on")
            bench.driver[role].set_phase(0.0)
        bench.clock.sleep(20.0)
        for role, ahead_rad in (("direct", 0.0), ("filtered", np.pi / 2)):
            found = bench.driver[role].measure()
            assert found["x_V"] == pytest.approx(np.cos(PHI_RAD - ahead_rad) / np.sqrt(2), abs=4e-4)
            assert found["y_V"] == pytest.approx(np.sin(PHI_RAD - ahead_rad) / np.sqrt(2), abs=4e-4)
        bench.close()


def events_of(content: bytes) -> list[tuple[int, int]]:
    """Ticks and bits 0 to 2 of all events in blocks as frames/time_tags.yaml describes them."""
    found, at = [], 0
    while at < len(content):
        length, _, tick, clock_Hz, dropped, edges = struct.unpack_from("<HIQIIH", content, at + 4)
        assert (clock_Hz, dropped) == (10_000_000, 0)
        words = struct.unpack_from(f"<{edges}I", content, at + 28)
        found += [(tick + (word >> 3), word & 7) for word in words]
        at += length
    return found


def tags(seed: int | None) -> list[tuple[int, int]]:
    """Events of a fifth of a second of a ring laser; ``seed`` None: of a tagger nobody had before."""
    entry = {"driver": "pendulum_cnt_91", "resource": ADDRESSES["counter"], "options": {}}
    clock = VirtualClock()
    world: Any = open_world("ring_laser", clock=clock, seed=1, station={"instruments": {"tagger": entry}, "links": {}})
    manager = pyvisa.ResourceManager(world.visa_library)
    world.unit.connect("rlg", 115_200)
    world.unit.set_power(True, 0, 15.0)
    if seed is not None:
        world.instruments["tagger"].left_by_another(np.random.default_rng([SEED, seed]))
    resource = manager.open_resource(entry["resource"], resource_pyclass=MessageBasedResource)
    driver = importlib.import_module("instruments.pendulum_cnt_91").DRIVER
    tagger = driver(resource, role="tagger", clock=clock, transcript=Log(), options={})
    tagger.configure(10e6)
    clock.sleep_until_ns(5 * NS)
    tagger.start()
    clock.sleep_until_ns(5 * NS + NS // 4)
    tagger.stop()
    events = events_of(tagger.read_stream(10_000_000))
    manager.close()
    world.close()
    return [event for event in events if 50_500_000 <= event[0] < 52_000_000]


@pytest.mark.parametrize("starts", [5, pytest.param(1000, marks=pytest.mark.sweep)])
def test_a_time_tagger_stamps_as_after_a_clean_start(starts: int) -> None:
    clean = tags(None)
    assert len(clean) > 1000
    for seed in range(starts):
        assert tags(seed) == clean
