"""Simulated standards at their terminals: errors of calibrator and meters, resistances, ranges, channels; instruments
as their last user left them: after the driver's preparation the stimulus or the reading is right, by the physics of
the bench and not by what reads back; a driver may also say what is wrong.
"""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from typing import Any, NamedTuple

import numpy as np
import pytest
from fog_signal import NorthBench, Turning
from gnc_rig import open_table
from scripted import refused
from sim_bench import DRIVERS as BENCH_DRIVERS
from sim_bench import Bench, open_bench
from tagger_bench import SLOW_PS, Blocks, TaggerBench, tagger_bench

from bench.model.drivers import manual_of
from bench.model.errors import InstrumentError
from sim_instruments.bus.ohms import ACCURACY as OHMS_ACCURACY
from sim_instruments.bus.ohms import RANGES_OHM
from sim_instruments.hp_3458a import ACCURACY, Hp3458A
from sim_instruments.worlds.common.terminals import Source

DAY_S = 86_400.0


def configured(bench: Bench, range_A: float) -> Hp3458A:
    bench.send("dmm", "END ALWAYS", f"DCI {range_A:.1E}", "NPLC 100", "AZERO ON", "TRIG HOLD")
    meter = bench.world.instruments["dmm"]
    assert isinstance(meter, Hp3458A)
    assert meter.range == range_A
    return meter


class Drawn(NamedTuple):
    """Errors of the instruments of one seed: of the meter's ranges, of ohms at 100 ohm, of the calibrator."""

    amperes: dict[float, tuple[float, float]]  # by range: zero and gain
    ohms: tuple[float, float]
    calibrator: tuple[float, float, float]  # gain, zero and error of a level in A


def drawn(seed: int) -> Drawn:
    with open_bench(seed=seed) as bench:
        amperes = {}
        for range_A in (1e-4, 1e-1):
            meter = configured(bench, range_A)
            zero, *ends = (meter.error_A(current_A) / range_A for current_A in (0.0, range_A, -range_A))
            assert abs(sum(ends) / 2 - zero) < 1e-12  # gain and linearity are odd in the current
            amperes[range_A] = (zero, (ends[0] - ends[1]) / 2)
        ohms = bench.world.instruments["rail_dmm"]._ohmmeter  # type: ignore[attr-defined]
        zero, full = (ohms.error_ohm(1e2, value_ohm) / 1e2 for value_ohm in (0.0, 1e2))
        calibrator, currents = bench.world.instruments["calibrator"], []
        for level in ("0", "1.0E-04"):
            bench.send("calibrator", f"OUT {level} A, 0 HZ")
            currents.append(calibrator.true_current_A())
        level_A = currents[1] - 1e-4 * (1 + calibrator.gain) - currents[0]
        return Drawn(amperes, (zero, full - zero), (calibrator.gain, currents[0], level_A))


@pytest.fixture(scope="module")
def population() -> list[Drawn]:
    return [drawn(seed) for seed in range(300)]


def test_errors_of_meters_are_as_large_as_their_specifications(population: list[Drawn]) -> None:
    """Gain and zero of 300 meters: half of the 95 % figures, within 20 % (5 standard deviations)."""
    for range_A, (relative, floor) in ((range_A, ACCURACY[range_A]) for range_A in (1e-4, 1e-1)):
        zeros, gains = zip(*(one.amperes[range_A] for one in population), strict=True)
        assert np.std(zeros) == pytest.approx(floor / 2, rel=0.2)
        assert np.std(gains) == pytest.approx(np.hypot(relative, floor) / 2, rel=0.2)
    zeros, gains = zip(*(one.ohms for one in population), strict=True)
    of_reading, of_range = OHMS_ACCURACY[1e2]
    assert np.std(zeros) == pytest.approx(of_range / 2, rel=0.2)
    assert np.std(gains) == pytest.approx(of_reading / 2, rel=0.2)


def test_errors_of_calibrators_have_the_spread_of_table_2(population: list[Drawn]) -> None:
    gains, zeros, levels = np.array([one.calibrator for one in population]).T
    for errors, spread in ((gains, 10e-6), (zeros, 3e-9), (levels, 3e-9)):
        assert np.std(errors) == pytest.approx(spread, rel=0.15)
    assert abs(np.corrcoef(zeros, levels)[0, 1]) < 0.2
    assert abs(np.corrcoef(gains, zeros)[0, 1]) < 0.2


def test_ranges_have_errors_of_their_own_that_stay_until_switched_off() -> None:
    with open_bench(seed=3) as bench:
        first = configured(bench, 1e-3).error_A(1e-3) / 1e-3
        other = configured(bench, 1e-2).error_A(1e-2) / 1e-2
        again = configured(bench, 1e-3).error_A(1e-3) / 1e-3
        assert first == again
        assert first != other
        bench.world.options["dmm_errors"] = False
        assert configured(bench, 1e-3).error_A(1e-3) == 0.0


def test_gain_of_the_calibrator_drifts_by_the_day() -> None:
    with open_bench(seed=4, options={"calibrator_gain": "off", "calibrator_floor": "off"}) as bench:
        bench.world.options["calibrator_drift_ppm"] = 2.0  # type: ignore[assignment]
        bench.send("calibrator", "OUT 1.0E-01 A, 0 HZ")
        calibrator = bench.world.instruments["calibrator"]
        before_A, before_ns = calibrator.true_current_A(), bench.clock.now_ns()
        bench.clock.sleep(DAY_S)
        after_A, after_ns = calibrator.true_current_A(), bench.clock.now_ns()
        days = (after_ns - before_ns) * 1e-9 / DAY_S
        assert (after_A - before_A) / 0.1 == pytest.approx(2e-6 * days, rel=1e-6)
        assert before_A == pytest.approx(0.1, abs=1e-11)


LEAD_OHM = 2.5


def error(bench: Bench, role: str) -> int:
    return int(bench.ask(role, "SYST:ERR?").partition(",")[0])


def wired(bench: Bench, resistance_ohm: float) -> None:
    source = Source(resistance_ohm=lambda t_ns: resistance_ohm, lead_ohm=LEAD_OHM)
    bench.world.terminals.connect(source, "rail_dmm")
    bench.world.terminals.connect(source, "logger", 103)


@pytest.mark.parametrize(("role", "channel"), [("rail_dmm", ""), ("logger", ",(@103)")])
def test_leads_cancel_with_four_wires_and_not_with_two(bench: Bench, role: str, channel: str) -> None:
    wired(bench, 138.5055)
    limit_ohm = 138.5 * OHMS_ACCURACY[1e3][0] + 1e3 * OHMS_ACCURACY[1e3][1]
    four_ohm, two_ohm = (float(bench.ask(role, f"CONF:{kind} 1000{channel}", "READ?")) for kind in ("FRES", "RES"))
    assert four_ohm == pytest.approx(138.5055, abs=2 * limit_ohm)
    assert 138.5055 + 2 * LEAD_OHM - 0.05 < two_ohm < 138.5055 + 2 * LEAD_OHM + 8.0
    assert error(bench, role) == 0


def test_a_longer_integration_has_less_noise_and_takes_longer() -> None:
    spread, takes_s = {}, {}
    for cycles in (0.2, 10.0):
        with open_bench() as bench:
            wired(bench, 100.0)
            bench.send("rail_dmm", "CONF:FRES 100", f"FRES:NPLC {cycles}")
            before_ns = bench.clock.now_ns()
            read = [float(bench.ask("rail_dmm", "READ?")) for _ in range(200)]
            spread[cycles], takes_s[cycles] = np.std(read), (bench.clock.now_ns() - before_ns) / 200e9
    assert spread[10.0] == pytest.approx(1e2 * 1e-6 / 3, rel=0.2)
    assert spread[0.2] == pytest.approx(spread[10.0] * 50**0.5, rel=0.2)
    assert takes_s[10.0] - takes_s[0.2] == pytest.approx(2 * 9.8 / 50.0, abs=0.001)  # the zero is measured too


@pytest.mark.parametrize(("role", "channel"), [("rail_dmm", ""), ("logger", ",(@103)")])
def test_overload_at_120_percent_and_automatic_range(bench: Bench, role: str, channel: str) -> None:
    wired(bench, 121.0)
    assert float(bench.ask(role, f"CONF:FRES 100{channel}", "READ?")) == 9.9e37
    assert float(bench.ask(role, f"CONF:FRES AUTO{channel}", "READ?")) == pytest.approx(121.0, abs=0.1)
    wired(bench, 119.0)
    assert float(bench.ask(role, f"CONF:FRES 100{channel}", "READ?")) == pytest.approx(119.0, abs=0.1)


def test_resolution_integration_time_and_autozero_are_those_of_the_manual(bench: Bench) -> None:
    assert float(bench.ask("rail_dmm", "CONF:FRES 100,3E-4", "FRES:NPLC?")) == 1.0
    assert bench.ask("rail_dmm", "CONF?") == '"FRES +1.000000E+02,+3.000000E-04"'
    assert float(bench.ask("rail_dmm", "CONF:FRES 100,DEF", "FRES:NPLC?")) == 10.0
    bench.send("rail_dmm", "CONF:FRES 1000,3E-5")
    assert error(bench, "rail_dmm") == 532
    assert float(bench.ask("logger", "CONF:FRES 100,(@101,102)", "FRES:NPLC? (@102)")) == 1.0
    assert bench.ask("logger", "FRES:NPLC 10,(@102)", "FRES:NPLC? (@101,102)") == "+1.00000000E+00,+1.00000000E+01"
    bench.send("rail_dmm", f"CONF:FRES {RANGES_OHM[-1] * 2}")
    assert error(bench, "rail_dmm") == -222
    # 34401A User's Guide, autozero: it applies to volts and two-wire ohms; four wires switch it on
    assert bench.ask("rail_dmm", "CONF:RES 100", "ZERO:AUTO OFF", "ZERO:AUTO?") == "0"
    assert bench.ask("rail_dmm", "CONF:FRES 100", "ZERO:AUTO?") == "1"
    assert bench.ask("rail_dmm", "ZERO:AUTO OFF", "ZERO:AUTO?") == "1"


def test_a_channel_waits_for_its_delay(bench: Bench) -> None:
    wired(bench, 100.0)
    takes_s = []
    for setting in ("CONF:FRES 100,(@103)", "ROUT:CHAN:DEL 0.5,(@103)"):
        bench.send("logger", setting)
        before_ns = bench.clock.now_ns()
        assert float(bench.ask("logger", "READ?")) == pytest.approx(100.0, abs=0.1)
        takes_s.append((bench.clock.now_ns() - before_ns) * 1e-9)
    assert takes_s[1] == pytest.approx(takes_s[0] + 0.5, abs=0.001)


def test_a_voltage_hangs_where_the_world_connects_it(bench: Bench) -> None:
    for role, channel, question in (("rail_dmm", 0, "MEAS:VOLT:DC?"), ("logger", 104, "MEAS:VOLT:DC? (@104)")):
        bench.world.terminals.connect(Source(voltage_V=lambda t_ns: 1.25), role, channel)
        assert float(bench.ask(role, question)) == pytest.approx(1.25, abs=1e-3)


def settled_A(bench: Bench, current: str, row: int = 1, channel: int = 1) -> float:
    """Current in the channel without the leakage of the route."""
    bench.send("calibrator", "STBY")
    bench.send("switch", ":OPEN ALL", f":CLOS (@1!{row}!{channel})")
    bench.send("calibrator", f"OUT {current} A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)
    return bench.unit.inputs[channel] - bench.world.wiring.leakage_A[row - 1, channel - 1]


@pytest.mark.parametrize(
    ("offset_A", "scale", "bits", "current_A"), [(5e-4, 1.0, 256, 1.5e-3), (0.0, 1.01, 512, 1.01e-3)]
)
def test_an_offset_or_a_scale_factor_is_told_by_the_status_alone(
    bench: Bench, offset_A: float, scale: float, bits: int, current_A: float
) -> None:
    calibrator = bench.world.instruments["calibrator"]
    calibrator.offset_A, calibrator.scale = offset_A, scale
    assert settled_A(bench, "1.0E-03") == pytest.approx(current_A, rel=1e-4)
    assert int(bench.ask("calibrator", "ISR?")) == 4097 | bits
    assert bench.ask("calibrator", "OUT?") == "1.0000000E-03,A,0.00E+00"
    assert settled_A(bench, "0") == pytest.approx(offset_A, abs=1e-7)
    bench.send("calibrator", "*RST")
    assert bench.ask("calibrator", "ISR?") == "4096"
    assert settled_A(bench, "1.0E-03") == pytest.approx(1e-3, rel=1e-4)


def test_errors_are_common_to_polarity_channel_and_time() -> None:
    with open_bench(seed=4) as bench:
        first_A = settled_A(bench, "1.0E-02")
        assert first_A != 1e-2
        assert settled_A(bench, "1.0E-02", row=2) == pytest.approx(-first_A, abs=1e-17)
        bench.clock.sleep(36_000.0)
        assert settled_A(bench, "1.0E-02", channel=9) == pytest.approx(first_A, abs=1e-17)


def test_zero_shows_the_offset_of_its_range() -> None:
    with open_bench(seed=4) as bench:
        low_A = settled_A(bench, "0")
        settled_A(bench, "1.0E-01")
        bench.send("calibrator", "RANGELCK ON")
        high_A = settled_A(bench, "0")
        assert 0 < abs(low_A) < 5 * 3e-9
        assert 5 * 3e-9 < abs(high_A) < 5 * 3.5e-7


def test_gain_and_floor_can_be_switched_off() -> None:
    with open_bench(seed=4, options={"calibrator_gain": "off"}) as bench:
        assert abs(settled_A(bench, "2.0E-01") - 0.2) < 5 * 0.7e-6
    with open_bench(seed=4, options={"calibrator_floor": "off"}) as bench:
        gain = settled_A(bench, "2.0E-01") / 0.2 - 1
        assert settled_A(bench, "3.0E-05") / 3e-5 - 1 == pytest.approx(gain, abs=1e-9)
        assert 0 < abs(gain) < 50e-6
    with open_bench(seed=4, options={"calibrator_gain": "off", "calibrator_floor": "off"}) as bench:
        assert settled_A(bench, "2.0E-01") == pytest.approx(0.2, abs=1e-16)


SEED = 1900
PHI_RAD = 0.576
FREQUENCY_Hz, AMPLITUDE_V, VOLTAGE_V, CURRENT_A = 1e7, 2.5, 15.0, 0.1


def generator(bench: Bench, driver: Any) -> None:
    driver.square(FREQUENCY_Hz, AMPLITUDE_V)
    driver.output_on()
    seen = bench.world.instruments["function_generator"]
    assert seen.true_frequency_Hz == pytest.approx(FREQUENCY_Hz, rel=5e-6)
    assert seen.open_amplitude_V == pytest.approx(AMPLITUDE_V, rel=1e-3)
    assert (seen.function, seen.offset_V, seen.polarity, seen.duty_percent) == ("SQU", 0.0, "NORM", 50.0)


def counter(bench: Bench, driver: Any) -> None:
    source = bench.world.instruments["function_generator"]
    bench.send("function_generator", "FUNC SQU", "FREQ 10 MHz", "OUTP ON")
    driver.identify()
    began_ns = bench.clock.now_ns()
    assert driver.measure_frequency(1.0) == pytest.approx(source.true_frequency_Hz, rel=6e-9)
    assert bench.clock.now_ns() - began_ns == pytest.approx(1.1e9, abs=0.3e9)


def supply(bench: Bench, driver: Any) -> None:
    driver.configure(VOLTAGE_V, 1.5, 18.0)
    driver.output_on()
    seen = bench.world.instruments["supply"]
    bench.send("supply", "*TRG")
    assert (seen.supplied_V, seen.current_A, seen.over_current_trip) == (VOLTAGE_V, 1.5, True)
    assert driver.measure_current() == pytest.approx(bench.world.load[1], abs=2e-3)
    changes = len(bench.unit.power)
    seen.press("INH")  # the line is pulled and let go: what goes off stays off
    seen.press("INH")
    assert not any(on for _, on, _ in bench.unit.power[changes:])


def meter(bench: Bench, driver: Any) -> None:
    bench.world.options["dmm_errors"] = False
    bench.send("calibrator", f"OUT {CURRENT_A:E} A, 0 HZ", "OPER")
    bench.clock.sleep(30.0)
    driver.configure_current(CURRENT_A)
    for _ in range(2):
        assert driver.measure_current() == pytest.approx(bench.world.wiring.loop_current_A, rel=1e-7)


def calibrator(bench: Bench, driver: Any) -> None:
    driver.identify()
    if bench.world.instruments["calibrator"].limits["A"][1] < CURRENT_A:
        with refused("B-INST-005"):
            driver.output(CURRENT_A)
        return
    driver.output(CURRENT_A)
    driver.operate()
    bench.clock.sleep(10.0)
    assert bench.world.wiring.loop_current_A == pytest.approx(CURRENT_A, rel=2e-4)
    assert bench.ask("calibrator", "ISR?") == "4097"  # on, settled and nothing else


def switch(bench: Bench, driver: Any) -> None:
    seen = bench.world.instruments["switch"]
    other_card, four_poles = seen.of_slot(1, "CTYPe") != "C7012", seen.of_slot(1, "POLE") == "4"
    code = "B-INST-005" if other_card or (1, 2, 3) in seen.forbidden else "B-INST-015" if four_poles else ""
    with refused(code) if code else nullcontext():
        driver.route(3, -1)
    bench.clock.sleep(60.0)
    assert seen.outputs() == {"closed": [] if code else ["1!2!3"]}


def chamber(bench: Bench, driver: Any) -> None:
    driver.set_temperature(40.0, 0.5)
    driver.run()
    before_degC = bench.world.thermal.setpoint_degC(bench.clock.now_ns())
    bench.clock.sleep(600.0)
    assert bench.world.thermal.setpoint_degC(bench.clock.now_ns()) - before_degC == pytest.approx(5.0)
    bench.clock.sleep(4 * 3600.0)
    assert float(bench.world.thermal.air_degC(bench.clock.now_ns())) == pytest.approx(40.0, abs=0.1)


def rails(bench: Bench, driver: Any) -> None:
    driver.configure(2, VOLTAGE_V, 0.5)
    driver.configure(3, -5.0, 0.5)
    driver.output_on()
    seen = bench.world.instruments["aux_supply"]
    assert [seen.output(rail)[0] for rail in range(3)] == pytest.approx([0.0, VOLTAGE_V, -5.0], rel=1e-3)


def logger(bench: Bench, driver: Any) -> None:
    thermal, connect = bench.world.thermal, bench.world.terminals.connect
    connect(Source(resistance_ohm=lambda t_ns: 115.0), "logger", 103)
    assert driver.measure_resistance(103, 100.0, 10) == pytest.approx(115.0, abs=0.1)
    thermal.ramp(80.0, 5.0, 0)
    bench.clock.sleep(1200.0)
    true = [float(of(bench.clock.now_ns())) for of in (thermal.lab_degC, thermal.air_degC)]
    assert driver.scan() == pytest.approx(true, abs=1.0)
    connect(Source(resistance_ohm=lambda t_ns: 1e6), "logger", 102)
    with refused("B-INST-007"):
        driver.scan()


def voltmeter(bench: Bench, driver: Any) -> None:
    bench.send("aux_supply", "INST P6V", "VOLT 5", "OUTP ON")
    true_V = bench.world.instruments["aux_supply"].output(0)[0]
    assert driver.measure_voltage() == pytest.approx(true_V, rel=1e-4)


def lock_in(bench: NorthBench, driver: Any) -> None:
    """A seventh harmonic, as large as the signal, must neither be detected nor overload the input."""
    bench.driver["filter"].configure(1.0)
    driver.configure(0.3, 24, 1.0, "on")
    driver.set_phase(0.0)
    for _ in range(2):  # the flags of the first reading are those of the beginning
        bench.clock.sleep(10.0)
        found = driver.measure()
    angle_rad = PHI_RAD - (np.pi / 2 if driver.role == "filtered" else 0.0)
    assert found["x_V"] == pytest.approx(np.cos(angle_rad) / np.sqrt(2), abs=4e-4)
    assert found["y_V"] == pytest.approx(np.sin(angle_rad) / np.sqrt(2), abs=4e-4)
    assert (found["overload"], found["unlocked"]) == (False, False)


def level(bench: NorthBench, driver: Any) -> None:
    """The axis is tilted another way from now on."""
    began_ns = bench.clock.now_ns()
    bench.world.level_mrad = lambda t_ns: (1.2344, -0.0406) if t_ns > began_ns else (0.3, 0.2)
    bench.clock.sleep(20.0)
    assert driver.measure() == {"x_mrad": 1.234, "y_mrad": -0.041, "temperature_degC": 23.0}
    bench.world.level_mrad = lambda _: (0.0, -3.1)
    with refused("B-INST-019", "working range.*level the sensor"):
        driver.measure()
    bench.world.level_mrad = None  # a bench without a tilt
    assert driver.measure()["x_mrad"] == 0.0


def tagger(bench: TaggerBench, driver: Any) -> None:
    driver.configure(100e6)
    driver.start()
    bench.clock.sleep(0.5)
    found = Blocks(driver.read_stream(10**8))
    k = np.arange(len(found.ticks)) + round(found.ticks[0] * 1e4 / SLOW_PS)
    assert len(k) > 14_000
    np.testing.assert_array_equal(found.ticks, bench.edges.times_ps(k) // 10_000)
    np.testing.assert_array_equal(found.words & 7, bench.edges.flags(k))


@contextmanager
def opened(role: str, dialect: int = 0) -> Iterator[tuple[Any, Any]]:
    """A bench with this role, and its driver."""
    if role in BENCH_DRIVERS:
        options = OPTIONS[dialect].get(role, {})
        with open_bench(instruments={role: options}) as bench:
            bench.send("switch", ":CLOS (@1!1!1)")
            yield bench, bench.driver(role, options=options)
    elif role == "tagger":
        with tagger_bench(SLOW_PS) as alone:
            yield alone, alone.tagger
    else:
        tones = Turning(lambda turns: np.sin(2 * np.pi * turns + PHI_RAD) + np.sin(14 * np.pi * turns))
        with closing(NorthBench(tones, divider=10)) as north:
            yield north, north.driver[role]


@contextmanager
def refused_by_name(rows: list[str]) -> Iterator[None]:
    """Let what is refused pass if it names one of the rows of the state table that the last user left."""
    try:
        yield
    except InstrumentError as error:
        if error.code != "B-INST-019" or not set(error.message.partition(": ")[0].split(", ")) <= set(rows):
            raise


ROLES: dict[str, Callable[[Bench, Any], None]] = {
    "function_generator": generator, "counter": counter, "supply": supply, "dmm": meter, "calibrator": calibrator,
    "switch": switch, "chamber": chamber, "aux_supply": rails, "logger": logger, "rail_dmm": voltmeter,
    "tagger": tagger, "level": level, "direct": lock_in, "filtered": lock_in,
    "filter": lambda bench, _: lock_in(bench, bench.driver["filtered"]),
}  # fmt: skip
OPTIONS: tuple[dict[str, dict[str, Any]], ...] = ({}, {"chamber": {"dialect": "8800"}})  # of every other start


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("starts", [20, pytest.param(1000, marks=pytest.mark.sweep)])
def test_what_the_last_user_left_changes_no_stimulus_and_no_reading(role: str, starts: int) -> None:
    print(f"seed {SEED}: {role}, {starts} starts")
    for seed in range(starts):
        with opened(role, seed % 2) as (bench, driver):
            rows = bench.world.instruments[role].left_by_another(np.random.default_rng([SEED, seed]))
            with refused_by_name(rows):
                ROLES[role](bench, driver)


def held_and_shown(driver: Any, device: Any, name: str, setting: str) -> None:
    """Leave a setting of a row: a command is taken without an error, and the question of the row shows it."""
    row = driver.states[name]
    device.leave(setting)
    driver.introduce()
    assert setting.startswith("key ") or driver.drain_errors() == [], setting
    shown = {one.name: (one.right, one.command != "") for one in driver.state_rows()}
    told = (False, bool(row.set or row.by)) if row.ask else (None, True)
    assert shown.get(name, (None, True)) == told, setting


def test_what_may_be_left_at_a_table_is_held_and_shown() -> None:
    manual = manual_of("acutrol_3000")
    assert manual is not None
    for name, setting in [(name, setting) for name, row in manual.states.items() for setting in row.left]:
        with open_table() as rig:
            held_and_shown(rig.driver, rig.table, name, setting)


@pytest.mark.parametrize("role", ROLES)
def test_what_a_last_user_may_leave_is_held_and_shown_by_questions_alone(role: str) -> None:
    with opened(role) as (_, driver):
        manual = manual_of(type(driver).__module__.rpartition(".")[2])
    assert manual is not None
    for name, row in manual.states.items():
        for setting in row.left:
            with opened(role, dialect=1) as (bench, driver):
                held_and_shown(driver, bench.world.instruments[role], name, setting)
                sent = {str(manual.find(text)) for _, direction, text, _ in bench.log.lines if direction == "tx"}
                assert {manual.commands[form].touch for form in sent - {"END ALWAYS;QFORMAT NORM"}} == {"asks"}, setting


@pytest.mark.parametrize("starts", [20, pytest.param(1000, marks=pytest.mark.sweep)])
def test_a_table_that_somebody_left_turns_as_it_is_told(starts: int) -> None:
    """Closed interlocks and another scale are told before anything is set; made safe, it is as any other table."""
    for seed in range(starts):
        with open_table() as rig:
            rows = rig.table.left_by_another(np.random.default_rng([SEED, seed]))
            wrong = "Closed" in rig.table.outputs()["interlocks"] or "scaling" in rows
            if wrong:
                with pytest.raises(InstrumentError, match=r"B-INST-017: .*interlock|B-INST-004: .*:conf:scal"):
                    rig.ready()
            if wrong or seed % 2:
                rig.driver.make_safe()
            rig.send(*(f":conf:scal {axis},360,360,0,deg" for axis in (1, 2, 3)))  # a person has seen to it
            driver = rig.ready()
            before = rig.angles()
            driver.turn(3, 400.0, 270.0, 300.0)
            rig.clock.sleep(10.0)
            assert driver.in_position()
            assert rig.angles() == pytest.approx([*before[:2], before[2] + 400.0], abs=2e-3)
            driver.spin(3, 150.0)
            rig.world.switches.switch("table_interlock")
            rig.clock.sleep(1.0)
            assert rig.rates() == [0.0, 0.0, 0.0]
