"""The simulated GNC bench: what a person does at it, its modules, their memories, faults and truth."""

import math
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gnc_campaigns import QUIET, Table, at, module, posed, times_ns, turning
from gnc_rig import DMM, STREAM, SUPPLY, frames_in, open_host
from one_estimate import value
from scipy.integrate import dblquad

from bench.model.clock import NS
from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.gnc.imu import GncImu, ImuOptions
from sim_instruments.worlds.gnc.magnetometer import Correction
from sim_instruments.worlds.gnc.options import FAULTS
from sim_instruments.worlds.gnc.processor import SECTOR, SIZE, Memories, ModuleDraws, Operation, Region, pattern_of
from sim_instruments.worlds.gnc.truth import _variance_of_mean, estimates

ITEMS = ("supply", "identify", "cpu", "timer", "memory", "imu", "gps", "ad", "io", "spi", "sci", "can")
TABLE = Path(__file__).resolve().parents[5] / "docs" / "method-gnc.md"
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


def window(start_s: float, end_s: float, **conditions: Any) -> RecordWindow:
    frames = round((end_s - start_s) * 200)
    return RecordWindow(1, "rs422", 0, frames, round(start_s * NS), round(end_s * NS), conditions)


def matrix(found: list[dict[str, Any]], quantity: str) -> np.ndarray:
    return np.array([[value(found, quantity, row=row, column=column) for column in "xyz"] for row in "xyz"])


def bias(found: list[dict[str, Any]], quantity: str) -> np.ndarray:
    return np.array([value(found, quantity, axis=axis) for axis in "xyz"])


def test_positions_and_rotations_turn_indicated_into_true() -> None:
    """a = K N + bias in a quiet unit's readings."""
    unit = module(posed(10.0, 37.0, -64.0), QUIET)
    found = estimates({"GNC-01": unit}, [window(100, 160, item="position"), window(200, 260, item="position")])
    indicated = unit.readings(np.array([NS])).accel_g[0]
    true = module(posed(10.0, 37.0, -64.0)).readings(np.array([NS])).accel_g[0]
    assert matrix(found, "accel_matrix") @ indicated + bias(found, "accel_bias") == pytest.approx(true, abs=1e-12)
    inverse = np.linalg.inv(matrix(found, "accel_matrix"))
    assert value(found, "accel_scale_error", axis="y") == pytest.approx(1e6 * (inverse[1, 1] - 1))
    assert value(found, "accel_cross_coupling", row="x", column="z") == pytest.approx(inverse[0, 2])
    assert {one["conditions"]["kind"] for one in found if one["quantity"].startswith("accel")} == {"accelerometer"}
    assert not [one for one in found if one["quantity"] == "gyro_matrix"]
    # w = K N - bias
    table = Table((turning(30.0), at(20.0), turning(50.0)))
    unit = module(table, QUIET)
    found = estimates({"": unit}, [window(100, 116, item="rotation", axis=axis) for axis in "xyz"])
    indicated, true = (one.readings(np.array([NS])).gyro_deg_s[0] for one in (unit, module(table)))
    result = matrix(found, "gyro_matrix") @ indicated - bias(found, "gyro_bias") / 3600
    assert result == pytest.approx(true, abs=1e-10)


def test_bias_of_rotations_leaves_out_the_axis_that_turns() -> None:
    """Each axis is averaged over the records about the other two, weighted by their lengths."""
    unit = GncImu(3, "GNC-05", ImuOptions(), Table(), Site())
    spans = {"x": (1000, 1016), "y": (2000, 2004), "z": (3000, 3030)}
    found = estimates({"GNC-05": unit}, [window(*span, item="rotation", axis=axis) for axis, span in spans.items()])

    def mean(axis: str, start_s: float, end_s: float) -> float:
        stamps = (np.arange(start_s, end_s, 0.01) * NS).astype(np.int64)
        return float(unit.gyro_bias_deg_s(stamps)[:, "xyz".index(axis)].mean() * 3600)

    expected = (16 * mean("y", *spans["x"]) + 30 * mean("y", *spans["z"])) / 46
    assert value(found, "gyro_bias", axis="y") == pytest.approx(expected, abs=0.02)
    assert abs(mean("y", *spans["x"]) - mean("y", *spans["z"])) > 0.1


@pytest.mark.parametrize("tau_s", [10.0, 300.0])
def test_stability_by_the_double_integral(tau_s: float) -> None:
    """Expected variance of 10 s means of a Gauss-Markov process: var(mean of 10 s) - var(mean of all), n/(n - 1)."""

    def of_mean(length_s: float) -> float:
        half, _ = dblquad(lambda a, b: np.exp(-(b - a) / tau_s), 0, length_s, 0, lambda b: b, epsabs=1e-6)
        return 2 * half / length_s**2

    for length_s in (10.0, 600.0):
        assert _variance_of_mean(length_s / tau_s) == pytest.approx(of_mean(length_s), rel=1e-5)


def test_stability_is_what_many_units_scatter() -> None:
    """Four units over 20 minutes of rest: the ratio of what is found to the truth is 1 within its scatter."""
    ratios = []
    for serial in ("GNC-01", "GNC-02", "GNC-03", "GNC-04"):
        unit = GncImu(8, serial, ImuOptions(), Table(), Site())
        unit.power.on(0)
        found = estimates({serial: unit}, [window(1000, 2200, item="stability")])
        counts = unit.sample(times_ns(1200.0, first_s=1000.0))
        for quantity, raw, scale in (("gyro", counts.gyro, 18.0), ("accel", counts.accel, 1.0)):
            s = (raw.reshape(120, 2000, 3).mean(axis=1) * scale).std(axis=0, ddof=1)
            ratios.append(s / bias(found, f"{quantity}_bias_stability"))
    assert np.mean(ratios[::2]) == pytest.approx(1.0, abs=0.08)
    assert np.mean(ratios[1::2]) == pytest.approx(1.0, abs=0.08)


def test_repeatability_is_that_of_the_true_means() -> None:
    unit = GncImu(8, "GNC-01", ImuOptions(), Table(), Site())
    for cycle in range(6):
        unit.power.on(cycle * 2000 * NS)
        unit.power.off((cycle * 2000 + 1900) * NS)
    windows = [window(k * 2000 + 1000, k * 2000 + 1600, item="repeatability", repeat_index=k) for k in range(6)]
    found = estimates({"GNC-01": unit}, windows)
    stamps = (np.arange(1000, 1600) * NS)[None, :] + (np.arange(6) * 2000 * NS)[:, None]
    means = np.array([unit.gyro_bias_deg_s(row).mean(axis=0) * 3600 for row in stamps])
    assert bias(found, "gyro_bias_repeatability") == pytest.approx(means.std(axis=0, ddof=1), rel=0.02)
    assert 1.0 < bias(found, "gyro_bias_repeatability").mean() < 8.0
    assert 0.01 < bias(found, "accel_bias_repeatability").mean() < 0.1
    assert estimates({"GNC-01": unit}, windows[:1]) == []


def test_magnetometer_in_the_plane_of_its_turn() -> None:
    table = Table((at(90.0), at(0), turning(15.0)), "z", "turntable")
    unit = module(table, QUIET)
    found = estimates({"": unit}, [window(10, 190, item="magnetometer", mounting="z", rate_deg_s=15.0)])
    north_gauss = 0.43 * np.cos(np.deg2rad(55)) * np.cos(np.deg2rad(4))  # along z, without the turntable's iron
    plane = unit.magnetometer.in_plane(np.sqrt(0.43**2 - north_gauss**2), north_gauss)
    assert value(found, "mag_radius") == pytest.approx(plane.radius_gauss)
    assert value(found, "mag_offset", axis="x") == pytest.approx(plane.offset_gauss[0], abs=1e-12)
    assert value(found, "mag_gain") == pytest.approx(plane.gain)
    assert value(found, "mag_angle") == pytest.approx(plane.angle_deg)
    assert matrix(found, "mag_matrix") @ unit.magnetometer.matrix == pytest.approx(np.eye(3), abs=1e-12)


def test_several_units() -> None:
    """Each by its own sensors, named in the conditions; a unit nobody knows and a record of no item give nothing."""
    units = {serial: GncImu(1, serial, QUIET, Table(), Site()) for serial in ("GNC-01", "GNC-02")}
    records = [window(1, 2, item="bias", unit=serial) for serial in ("GNC-02", "GNC-01", "GNC-03")]
    found = estimates(units, records)
    for serial, unit in units.items():
        rates = [
            GncImu(1, serial, QUIET, Table(), Site(90.0, 9.8, azimuth)).readings(np.array([NS])) for azimuth in (0, 180)
        ]
        earth = unit.errors.gyro.sensitivity[2, 2] * 15.041067
        expected = np.mean([one.gyro_deg_s[0, 2] for one in rates]) * 3600 - earth  # at rest, without Earth's rate
        assert value(found, "gyro_bias", unit=serial, axis="z") == pytest.approx(expected, abs=2e-3)
    assert {one["conditions"]["unit"] for one in found} == {"GNC-01", "GNC-02"}
    assert estimates(units, [window(1, 2), window(3, 4, item="memory")]) == []


def test_flip_and_random_walks() -> None:
    upright, turned = (
        module(posed(0, 0, inner), ImuOptions(noise=False)).readings(np.array([NS])).accel_g[0] for inner in (0, 180)
    )
    mine = module(Table(), ImuOptions(noise=False))
    found = estimates({"": mine}, [window(1, 180, item="flip", up="+z"), window(200, 380, item="flip", up="-z")])
    assert bias(found, "accel_bias") == pytest.approx(-(upright + turned) / 2, abs=1e-12)
    assert not np.allclose(bias(found, "accel_bias"), -mine.accel_bias_g(np.array([NS]))[0], rtol=1e-3)
    assert bias(found, "angle_random_walk") == pytest.approx([0, 0, 0])
    noisy = GncImu(1, "GNC-01", ImuOptions(), Table(), Site())
    found = estimates({"": noisy}, [window(1, 180, item="bias")])
    assert bias(found, "angle_random_walk") == pytest.approx(noisy.errors.gyro.white * 60)
    assert bias(found, "velocity_random_walk") == pytest.approx([0.1, 0.1, 0.1])
