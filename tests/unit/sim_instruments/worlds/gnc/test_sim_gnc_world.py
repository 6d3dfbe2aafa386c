"""The simulated GNC bench: what a person does at it, its modules, their memories, their faults."""

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from gnc_rig import DMM, STREAM, SUPPLY, frames_in, open_host

from sim_instruments.worlds.gnc.magnetometer import Correction
from sim_instruments.worlds.gnc.options import FAULTS
from sim_instruments.worlds.gnc.processor import SECTOR, SIZE, Memories, ModuleDraws, Operation, Region, pattern_of

ITEMS = ("supply", "identify", "cpu", "timer", "memory", "imu", "gps", "ad", "io", "spi", "sci", "can")
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


def test_the_mounting_decides_which_axis_feels_gravity_from_the_act_on():
    with open_host(options={"imu_errors": "off", "noise": "off"}) as host:
        felt = {}
        for axis in ("y", "z", "x"):
            host.world.operate("mounting", axis)
            host.clock.sleep(1)
            felt[axis] = [round(value / 100_000) for value in imu_means(host)[3:]]
        host.ask(0x20, "BHI", 7, 200, 0)
        host.clock.sleep(10)
        host.world.operate("mounting", "y")
        host.clock.sleep(10)
        along_z = np.array([struct.unpack("<2IB9ih", f.payload)[8] for f in frames_in(host.read()) if f.kind == STREAM])
    assert felt == {"x": [0, 0, 1], "y": [1, 0, 0], "z": [0, 1, 0]}
    assert along_z[:1990].min() > 990
    assert abs(along_z[2010:]).max() < 10


def test_the_table_disturbs_the_magnetometer_but_a_non_magnetic_one_does_not():
    with open_host() as host:
        read = {}
        for table in ("bench", "non_magnetic", "turntable"):
            host.world.operate("table", table)
            host.clock.sleep(0.1)
            read[table] = struct.unpack("<4h", host.ask(0x30)[1])[1:]
    assert np.abs(np.subtract(read["bench"], read["non_magnetic"])).max() < 40
    assert np.abs(np.subtract(read["bench"], read["turntable"])).max() > 200


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


def test_faults_are_of_one_unit_several_at_once_or_switched_on_by_a_command():
    """What each fault fails is asked through the whole product: tests/systems/gnc/test_gnc_unit_tests.py."""
    with open_host(3, "GNC-02", options={"faults": "GNC-01=sci_silent,GNC-02=gps_silent+io_open"}) as host:
        assert host.ask(0x14)[0] != 0
        assert host.ask(0x16, "3B", 1, 4, 1) != (0, bytes([1, 0]))
        assert host.ask(0x18, extra=b"UV") == (0, b"UV")
        assert host.ask(0x7E, "B", FAULTS["sci_silent"].code) == (0, b"")
        assert host.ask(0x18, extra=b"UV") != (0, b"UV")
    with open_host(on=False, options={"faults": "GNC-01=supply_short"}) as host:
        supply = host.instrument(SUPPLY)
        for message in ("VOLT 5", "CURR 0.6", "OUTP ON"):
            supply.write(message)
        host.clock.sleep(2)
        assert host.exchange(0x01) is None


def test_the_table_of_the_documentation_is_the_one_of_the_code():
    told = {name: (int(code), wrong, fails) for code, name, wrong, fails in ROW.findall(TABLE.read_text())}
    meant = {
        name: (fault.code, fault.wrong, "all" if fault.fails == ITEMS else ", ".join(fault.fails))
        for name, fault in FAULTS.items()
    }
    assert told == meant
    assert len(told) >= 25
    assert len({fault.code for fault in FAULTS.values()}) == len(FAULTS)


WORDS = SECTOR // 4


def memories(*faults, seed=1, serial="GNC-01"):
    return Memories(ModuleDraws(seed, serial), set(faults))


def prepared(memory, region, pattern=2, length=SECTOR):
    memory.do(region, Operation.ERASE, 0, 0, length)
    memory.do(region, Operation.PROGRAM, pattern, 0, length)
    return memory.do(region, Operation.VERIFY, pattern, 0, length)


def test_patterns_reach_the_end_of_a_memory():
    words = np.array([0, 1, 1024])
    assert [hex(v) for v in pattern_of(0, words)] == ["0x55555555"] * 3
    assert [hex(v) for v in pattern_of(1, words)] == ["0xaaaaaaaa"] * 3
    assert list(pattern_of(2, words)) == [0, 4, 4096]
    memory = memories()
    for region, operation in ((Region.RAM, Operation.WRITE_READ), (Region.SPI_FLASH, Operation.ERASE)):
        assert memory.do(region, operation, 2, SIZE[region] - 4, 4).checked == 1


def test_flash_is_programmed_to_zeros_and_erased_by_sectors():
    memory = memories()
    prepared(memory, Region.SPI_FLASH, pattern=0)
    memory.do(Region.SPI_FLASH, Operation.PROGRAM, 1, 0, SECTOR)
    found = memory.do(Region.SPI_FLASH, Operation.VERIFY, 1, 0, SECTOR)
    assert (found.wrong, found.expected, found.received) == (WORDS, 0xAAAAAAAA, 0)
    memory = memories()
    memory.do(Region.SPI_FLASH, Operation.ERASE, 0, SECTOR - 4, 8)
    assert memory.do(Region.SPI_FLASH, Operation.BLANK_CHECK, 0, 0, 2 * SECTOR).wrong == 0
    assert memory.do(Region.SPI_FLASH, Operation.BLANK_CHECK, 0, 2 * SECTOR, 4).wrong == 1
