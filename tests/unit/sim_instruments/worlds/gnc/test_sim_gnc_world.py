"""The simulated GNC bench: what a person does at it, its modules, their faults: each fails its unit tests."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from gnc_judge import ITEMS, failed_items
from gnc_rig import DMM, STATION, STREAM, SUPPLY, frames_in, open_host

from bench.model.clock import VirtualClock
from bench.model.errors import InputError
from bench.model.installed import offers
from bench.model.ports import RecordWindow
from sim_instruments.worlds.gnc.magnetometer import Correction
from sim_instruments.worlds.gnc.options import FAULTS, parse_faults
from sim_instruments.worlds.simulation import open_world, options_of

TABLE = Path(__file__).resolve().parents[5] / "docs" / "gnc-faults.md"
ROW = re.compile(r"^\| (\d+) \| `(\w+)` \| (.+) \| ([\w, ]+) \|$", re.MULTILINE)


def imu_means(host):
    status, found = host.ask(0x13, "B", 100)
    assert status == 0
    return struct.unpack("<6i2h12iB", found)[:6]


def identity(host):
    return host.ask(0x01)[1][13:25]


def test_a_unit_that_is_put_in_starts_at_once_and_is_the_same_when_it_comes_back():
    with open_host() as host:
        first, current_A = imu_means(host), host.world.load[1]
        host.world.operate("unit", "GNC-02")
        host.clock.sleep(2)
        assert identity(host) == b"GNC-02      "
        assert np.abs(np.subtract(imu_means(host), first)).max() > 100
        assert host.world.load[1] != current_A
        host.world.operate("unit", "GNC-01")
        host.clock.sleep(2)
        assert host.world.load[1] == current_A
        assert np.abs(np.subtract(imu_means(host)[3:], first[3:])).max() < 100  # 1 mg of warming and turn-on


def test_a_module_is_a_function_of_seed_and_serial():
    found = {}
    for seed in (1, 2):
        for serial in ("A", "B"):
            with open_host(seed, serial) as host, open_host(seed, serial) as again:
                assert imu_means(host) == imu_means(again)
                assert host.world.load == again.world.load
                found[seed, serial] = imu_means(host)
    assert len(set(found.values())) == 4


def test_the_mounting_decides_which_axis_feels_gravity():
    with open_host(options={"imu_errors": "off", "noise": "off"}) as host:
        felt = {}
        for axis in ("x", "y", "z"):
            host.world.operate("mounting", axis)
            host.clock.sleep(1)
            felt[axis] = [round(value / 100_000) for value in imu_means(host)[3:]]
    assert felt == {"x": [0, 0, 1], "y": [1, 0, 0], "z": [0, 1, 0]}


def test_samples_before_an_act_do_not_know_of_it():
    with open_host(options={"imu_errors": "off", "noise": "off"}) as host:
        host.ask(0x20, "BHI", 7, 200, 0)
        host.clock.sleep(10)
        host.world.operate("mounting", "y")
        host.clock.sleep(10)
        rows = np.array([row[8] for row in _rows(host.read())])
    assert rows[:1990].min() > 990
    assert abs(rows[2010:]).max() < 10


def _rows(received):
    return [struct.unpack("<2IB9ih", f.payload) for f in frames_in(received) if f.kind == STREAM]


def test_the_table_disturbs_the_magnetometer_but_a_non_magnetic_one_does_not():
    with open_host() as host:
        read = {}
        for table in ("bench", "non_magnetic", "turntable"):
            host.world.operate("table", table)
            host.clock.sleep(0.1)
            read[table] = struct.unpack("<4h", host.ask(0x30)[1])[1:]
    assert np.abs(np.subtract(read["bench"], read["non_magnetic"])).max() < 40
    assert np.abs(np.subtract(read["bench"], read["turntable"])).max() > 200


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("chamber", 1, "B-SIM-018"),
        ("unit", "", "B-SIM-019"),
        ("unit", "x" * 13, "B-SIM-019"),
        ("unit", "Größe", "B-SIM-019"),
        ("dip_switch", 6, "B-SIM-019"),
        ("dip_switch", "1.5", "B-SIM-019"),
        ("mounting", "w", "B-SIM-019"),
        ("table", "wood", "B-SIM-019"),
    ],
)
def test_what_a_person_cannot_do_is_refused(name, value, code):
    with open_host(on=False) as host, pytest.raises(InputError, match=code):
        host.world.operate(name, value)


def test_nobody_operates_the_other_bench():
    world = open_world("af_converter", clock=VirtualClock(), seed=1, station={"instruments": {}})
    with pytest.raises(InputError, match="B-SIM-018"):
        world.operate("unit", "X")
    world.close()


def test_a_dip_switch_may_be_written_as_a_whole_number_of_any_kind():
    with open_host(on=False) as host:
        for value in (3, "3", 3.0, np.int64(3)):
            host.world.operate("dip_switch", 0)
            host.world.operate("dip_switch", value)
            assert host.world.dip_switch == 3


def test_supply_and_meter_see_the_module():
    with open_host(on=False) as host:
        supply, meter = host.instrument(SUPPLY), host.instrument(DMM)
        assert abs(float(meter.query("READ?"))) < 1e-3
        for message in ("VOLT 5", "CURR 0.6", "OUTP ON"):
            supply.write(message)
        assert float(meter.query("READ?")) == pytest.approx(5.0, abs=2e-3)
        assert float(supply.query("MEAS:CURR?")) == pytest.approx(0.49, rel=0.04)
        host.clock.sleep(2)
        assert host.exchange(0x01) is not None
        supply.write("CURR 0.3")
        assert host.exchange(0x01) is None, "the limit is below what the module draws"
        supply.write("CURR 0.6")
        supply.write("VOLT 4.2")
        host.clock.sleep(2)
        assert host.exchange(0x01) is None
        assert float(supply.query("MEAS:CURR?")) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(
    "options", [{"hysteresis": "on"}, {"noise": "yes"}, {"tilt_arcmin": "61"}, {"tilt_arcmin": "-1"}]
)
def test_options_that_are_none_of_this_world_are_refused(options):
    with pytest.raises(InputError, match="B-SIM-002"):
        open_world("gnc_module", clock=VirtualClock(), seed=1, station=STATION, options=options)


def test_every_world_tells_its_options():
    assert set(options_of("gnc_module")) == {"imu_errors", "noise", "tilt_arcmin", "faults"}
    assert "calibrator_gain" in options_of("af_converter")
    worlds = {offer.name for offer in offers("worlds")}
    assert worlds == {"af_converter", "gnc_module", "fog_north", "plain_unit", "ring_laser", "time_sync"}


def test_truth_is_told_by_unit():
    with open_host() as host:
        host.world.operate("unit", "GNC-02")
        windows = [
            RecordWindow(1, "rs422", 0, 200, 10**9, 2 * 10**9, {"item": "position", "unit": unit, "up": "+x"})
            for unit in ("GNC-01", "GNC-02")
        ]
        found = host.world.truth(windows)
    values = {
        (e["conditions"]["unit"], e["value"])
        for e in found
        if e["quantity"] == "accel_matrix" and (e["conditions"]["row"], e["conditions"]["column"]) == ("x", "x")
    }
    assert len(values) == 2
    assert len({unit for unit, _ in values}) == 2


@pytest.mark.parametrize("roll_deg", [-179.0, -90.0, -30.0, 0.0, 45.0, 120.0])
def test_roll_of_an_exact_field(roll_deg):
    """Sensors with offset, gain and angle, written down forwards: y = y_true / K, x = x_true cos a + y_true sin a."""
    offset, gain, alpha = (120, -340, 55), 1.07, math.radians(1.5)
    x_true, y_true = 3000 * math.cos(math.radians(roll_deg)), -3000 * math.sin(math.radians(roll_deg))
    x = x_true * math.cos(alpha) + y_true * math.sin(alpha) + offset[0]
    y = y_true / gain + offset[1]
    found_deg, corrected = Correction(offset, gain, math.sin(alpha)).roll((round(x), round(y), 1055))
    assert found_deg == pytest.approx(roll_deg, abs=0.05)
    assert corrected == (pytest.approx(x_true, abs=2), pytest.approx(y_true, abs=2), 1000)


def test_roll_over_the_link_uses_the_correction_that_was_set():
    with open_host(options={"noise": "off"}) as host:
        plain_deg, *plain = struct.unpack("<4h", host.ask(0x30)[1])
        assert host.ask(0x31, "5h", plain[0] - 1000, plain[1], 0, 10_000, 0) == (0, b"")
        moved_deg, *moved = struct.unpack("<4h", host.ask(0x30)[1])
        assert moved == [1000, 0, plain[2]]
        assert moved_deg == 0
        assert plain_deg == pytest.approx(100 * math.degrees(math.atan2(-plain[1], plain[0])), abs=1)
        host.power(False)
        host.power()
        host.clock.sleep(1.6)
        assert struct.unpack("<4h", host.ask(0x30)[1])[1:] == tuple(plain), "without power it is forgotten"


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_fails_exactly_its_tests(name):
    with open_host(3, "GNC-02", on=False, options={"faults": f"GNC-01=sci_silent,GNC-02={name}"}) as host:
        assert failed_items(host)[0] == set(FAULTS[name].fails)


def test_the_table_of_the_documentation_is_the_one_of_the_code():
    told = {name: (int(code), wrong, fails) for code, name, wrong, fails in ROW.findall(TABLE.read_text())}
    meant = {
        name: (fault.code, fault.wrong, "all" if fault.fails == ITEMS else ", ".join(fault.fails))
        for name, fault in FAULTS.items()
    }
    assert told == meant
    assert len(told) >= 25
    assert len({fault.code for fault in FAULTS.values()}) == len(FAULTS)


def test_two_faults_at_once_fail_the_tests_of_both():
    with open_host(3, "A", on=False, options={"faults": "A=gps_silent+io_open"}) as host:
        assert failed_items(host)[0] == {"gps", "io", "spi"}


@pytest.mark.parametrize("name", ["cpu_carry", "gps_silent", "spi_lost_clock"])
def test_a_fault_can_be_switched_on_by_a_command(name):
    with open_host(3) as host:
        assert host.ask(0x7E, "B", FAULTS[name].code) == (0, b"")
        assert failed_items(host)[0] == set(FAULTS[name].fails)


def sound_modules_pass(seeds):
    for seed in seeds:
        serial = f"GNC-{seed:03}"
        with open_host(seed, serial, on=False) as host:
            failed, duration_s = failed_items(host)
        assert not failed, (seed, failed)
        assert 8.0 <= duration_s <= 9.0, (seed, duration_s)  # the rest up to 10 s is left to boot and controller


def test_a_module_without_faults_passes_and_takes_its_time():
    sound_modules_pass(range(8))


@pytest.mark.sweep
def test_two_hundred_modules_without_faults_pass():
    sound_modules_pass(range(200))


def test_a_module_passes_again_and_again():
    with open_host(9, on=False) as host:
        assert failed_items(host)[0] == set()
        host.instrument(SUPPLY).write("OUTP OFF")
        host.board.module.memories.erases.update(dict.fromkeys(host.board.module.memories.erases, 0))
        assert failed_items(host)[0] == set()


@pytest.mark.parametrize("text", ["GNC-01", "GNC-01=", "=cpu_carry", "GNC-01=cpu_cary", "GNC-01=cpu_carry+"])
def test_an_option_that_cannot_be_read_is_refused(text):
    with pytest.raises(InputError, match="B-SIM-002"):
        parse_faults(text)
    with pytest.raises(InputError, match="B-SIM-002"):
        open_world("gnc_module", clock=None, seed=1, station={}, options={"faults": text})


@pytest.mark.parametrize("text", ["", "none"])
def test_no_faults(text):
    assert parse_faults(text) == {}


def test_the_nearest_fault_is_named():
    with pytest.raises(InputError) as caught:
        parse_faults("GNC-01=flash_week_cell")
    assert "'flash_weak_cell'" in str(caught.value.next_step)
