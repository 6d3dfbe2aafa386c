"""The unit tests of a module judged from what was sent and what came back."""

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import pytest
from gnc_rig import PATTERN, ad, exchange, exchanges, imu, material, sound_items, supply
from spoken import english_left

from bench.analysis import Exchange
from bench.model.errors import FitError
from bench.systems.gnc.limits import limits_of
from bench.systems.gnc.unit_test.analysis import analyse, title_of
from bench.systems.gnc.unit_test.units import ITEMS


def verdicts(found: list[Exchange], **more: Any) -> dict[str, str]:
    """Verdict of each item by its estimate of wrong results."""
    entries = ((one.quantity, one.verdict) for one in analyse(material(found, **more)).estimates)
    return {name.removesuffix("_wrong"): verdict for name, verdict in entries if name.endswith("_wrong")}


def failed(found: list[Exchange], **more: Any) -> set[str]:
    return {name for name, verdict in verdicts(found, **more).items() if verdict != "pass"}


def test_a_sound_unit_passes_everything() -> None:
    analysis = analyse(material(exchanges()))
    assert set(verdicts(exchanges())) == {*ITEMS, "supply"}
    assert failed(exchanges()) == set()
    assert analysis.missing == []
    assert english_left(analysis) == set()
    assert {one.verdict for one in analysis.estimates} == {"pass", "none"}
    assert analysis.tables[0].rows[0][-1] == "PASS"


def changed(name: str, change: Callable[[int, Exchange], Exchange | None]) -> list[Exchange]:
    """The sound exchanges with those of one command changed or left out; ``change`` gets their number in the item."""
    number = count()
    found = [change(next(number), one) if one.name == name else one for one in exchanges()]
    return [one for one in found if one is not None]


def answered(received: bytes, only: int = 0) -> Callable[[int, Exchange], Exchange]:
    return lambda number, one: replace(one, received=received) if number == only else one


def without(*left_out: int) -> Callable[[int, Exchange], Exchange | None]:
    return lambda number, one: None if number in left_out else one


CPU, WORDS = struct.Struct("<4H4HHII"), struct.Struct("<6I")


def gps(
    north_deg: float = 37.50001, east_deg: float = 127.0, *, fix: int = 3, satellites: int = 9, height_mm: int = 80_000
) -> bytes:
    """Answer of the receiver."""
    place = (round(1e7 * north_deg), round(1e7 * east_deg))
    return struct.pack("<BBiiiH", fix, satellites, *place, height_mm, 900)


def warm(place: int, counts: int) -> bytes:
    """Answer of the IMU with a temperature of gyros or accelerometers, 0.01 degC."""
    answer = bytearray(imu())
    struct.pack_into("<h", answer, place, counts)
    return bytes(answer)


WRONG: list[tuple[str, str, Callable[[int, Exchange], Exchange | None], str]] = [
    ("cpu", "multiplication", answered(CPU.pack(50, 50, 50, 50, 0, 0, 1, 0, 0, 6, 7)), "6 was due"),
    ("cpu", "division not done", answered(CPU.pack(50, 50, 50, 0, *[0] * 7)), "division: not done"),
    ("cpu", "memory", answered(CPU.pack(*[50] * 4, *[0] * 4, 3, 0, 0)), "read back wrong"),
    ("timer", "slow", answered(struct.pack("<20IB", *[1011] * 20, 20), 1), "20 of 20 intervals"),
    ("timer", "one long interval", answered(struct.pack("<20IB", *[2000] * 19, 2021, 20), 2), "1 of 20 intervals"),
    ("timer", "lost interrupt", answered(struct.pack("<20IB", *[500] * 20, 19)), "interrupts"),
    ("timer", "no 5 ms", without(3), "setting 5000 us was not tested"),
    ("memory", "stuck bit", answered(WORDS.pack(1024, 1, 0x40, 0x55555555, 0x55555557, 0), 0), "RAM write and read"),
    ("memory", "nothing checked", answered(WORDS.pack(0, 0, 0, 0, 0, 0), 3), "words that were checked"),
    ("memory", "not blank", answered(WORDS.pack(1024, 2, 0, 0xFFFFFFFF, 0, 6), 7), "SPI FLASH blank check"),
    ("memory", "erased twice", answered(WORDS.pack(1024, 0, 0, 0, 0, 7), 7), "count of erases"),
    ("memory", "no address pattern", without(5), "SDRAM with pattern address was not tested"),
    ("memory", "no blank check", without(11), "internal FLASH: erase, blank check"),
    ("imu", "rate at rest", answered(imu(rate=60_000)), "rate x at rest"),
    ("imu", "half a g", answered(imu(force_z=50_000)), "specific force"),
    ("imu", "frozen", answered(imu(high={"gyro": (20, -20, 20)})), "gyro y is frozen"),
    ("imu", "saturated", answered(imu(high={"accel": (2, 50_000, 1002)})), "accel y is at its limit"),
    ("imu", "too few samples", answered(imu(samples=30)), "samples taken"),
    ("gps", "no fix", answered(gps(fix=2)), "fix"),
    ("gps", "few satellites", answered(gps(satellites=3)), "satell"),
    ("gps", "elsewhere", answered(gps(38.50001)), "latitude"),
    ("gps", "too high", answered(gps(height_mm=80_000_000)), "height"),
    ("ad", "5 V low", answered(ad(1, c1=4800)), "5 V, its switch on"),
    ("ad", "crosstalk", answered(ad(2, c3=400), 1), "1.2 V, its switch off"),
    ("ad", "dead magnetometer", answered(ad(1, m1=0)), "field of the magnetometer"),
    ("ad", "no GND", without(3), "DIP switch 4 (GND) was not tested"),
    ("io", "stuck", answered(bytes([0, 0]), 1), "IO 1 to IO 2: level"),
    ("io", "short", answered(bytes([1, 4]), 1), "lines that must rest"),
    ("io", "one pair left out", without(22, 23), "IO 4 to IO 3 at level 0 was not tested"),
    ("spi", "line", answered(struct.pack("<HH", 0xA55A, 0xA55B)), "word on the IO lines"),
    ("sci", "bit", answered(bytes([1, *PATTERN[1:]])), "echo"),
    ("sci", "short echo", answered(PATTERN[:-1]), "echo"),
    ("can", "identifier", answered(struct.pack("<I", 0x124) + PATTERN), "identifier"),
]


@pytest.mark.parametrize(("item", "name", "change", "says"), WRONG, ids=lambda one: one if isinstance(one, str) else "")
def test_a_fault_fails_its_item_and_no_other(item: str, name: str, change: Any, says: str) -> None:
    found = changed(item, change)
    assert failed(found) == {item}, name
    wrong = next(one for one in analyse(material(found)).tables if one.title == "Wrong results")
    assert any(says in row[2] or says in row[5] for row in wrong.rows)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"status": None, "received": b"", "attempts": 3}, "nobody answered (3 attempts)"),
        ({"status": 3, "refused": True, "received": b""}, "refused the command: UNKNOWN_COMMAND"),
        ({"status": 2, "received": b""}, "status BUSY"),
        ({"status": 1}, "status FAIL"),
        ({"received": b"\x01\x02\x03"}, "B-FRAME-025"),
    ],
)
@pytest.mark.parametrize("item", ITEMS)
def test_no_answer_is_a_wrong_result_with_its_reason(item: str, change: dict[str, Any], says: str) -> None:
    if item == "sci" and "B-FRAME" in says:
        pytest.skip("an echo may have any length")
    found = changed(item, lambda number, one: replace(one, **change) if number == 0 else one)
    assert failed(found) == {item}
    log = analyse(material(found)).attachments[f"GNC-01/{item}/log.txt"]
    assert says in log
    assert "FAIL" in log


@pytest.mark.parametrize("item", ITEMS)
def test_what_was_not_tested_never_passes(item: str) -> None:
    found = [one for one in exchanges() if one.item != item]
    analysis = analyse(material(found))
    assert item not in verdicts(found)
    assert analysis.missing == [f"unit GNC-01: {title_of(item)} was not tested"]
    row = dict(zip(analysis.tables[1].headers, analysis.tables[1].rows[0], strict=True))
    assert row[title_of(item)] == "not tested"
    assert analysis.tables[0].rows[0][-1] == "not tested"
    assert json.loads(analysis.attachments["GNC-01/summary.json"])["verdict"] == "not tested"


def test_the_floating_channel_is_reported_and_never_judged() -> None:
    found = changed("ad", answered(ad(5, c5=-9000), 4))
    assert failed(found) == set()
    assert any("floating channel: -9.000 V (reported, not judged)" in note for note in analyse(material(found)).notes)
    assert not any(one.conditions.get("source") == "floating" for one in analyse(material(found)).estimates)


@pytest.mark.parametrize(
    ("volts", "amperes", "says"),
    [(5.26, 0.488, "supply voltage"), (5.0, 0.52, "supply current"), (None, 0.49, "no reading")],
)
def test_the_supply_is_judged_by_its_readings(volts: float | None, amperes: float, says: str) -> None:
    readings = supply(volts, amperes)
    assert failed(exchanges(), readings=readings) >= {"supply"}
    assert says in analyse(material(exchanges(), readings)).attachments["GNC-01/supply/log.txt"]
    assert failed(exchanges(), readings=supply()[:1]) == {"supply"}  # of which one half was measured


def test_several_units_are_told_apart_and_one_failing_loop_fails_the_item() -> None:
    first, second = exchanges("A-1"), exchanges("B-2", first=100)
    name, sent, received = sound_items()[0]
    spoiled = received[:8] + b"\x01" + received[9:]
    again = [
        exchange(name, sent, text, 200 + k, conditions={"unit": "B-2"}) for k, text in enumerate([received, spoiled])
    ]
    analysis = analyse(material(first + second + again, supply(unit="A-1") + supply(unit="B-2")))
    wrong = {(one.conditions["unit"], one.quantity): (one.value, one.n) for one in analysis.estimates}
    assert wrong["A-1", "cpu_wrong"] == (0.0, 1)
    assert wrong["B-2", "cpu_wrong"] == (1.0, 3)
    assert [row[-1] for row in analysis.tables[0].rows] == ["PASS", "FAIL"]
    assert {path.split("/")[0] for path in analysis.attachments} == {"A-1", "B-2"}
    unsafe = analyse(material(exchanges("../x y"), supply(unit="../x y")))
    assert {path.split("/")[0] for path in unsafe.attachments} == {"_x_y"}


def test_times_are_those_of_the_bench_clock_with_utc_beside_them() -> None:
    analysis = analyse(material(exchanges()))
    summary = json.loads(analysis.attachments["GNC-01/summary.json"])
    last = len(sound_items()) - 1
    assert summary["begin_s"] == 100.0
    assert summary["elapsed_s"] == pytest.approx(0.1 * last + 0.01)
    assert summary["begin_utc"] == "2000-01-01T00:01:40.000Z"
    assert next(one.value for one in analysis.estimates if one.quantity == "test_time") == summary["elapsed_s"]
    assert "start    100.000 s  2000-01-01T00:01:40.000Z" in analysis.attachments["GNC-01/cpu/log.txt"]


EAST = {"longitude_deg": 179.9999}
NORTH = {"latitude_deg": 60.0, "longitude_deg": 10.0}  # a degree of longitude is shorter there


@pytest.mark.parametrize(
    ("command", "number", "answer", "site", "fails"),
    [
        ("gps", 0, gps(89.9, -179.9), {}, False),
        ("gps", 0, gps(90.1, 10.0), {}, True),
        ("gps", 0, gps(10.0, 180.1), {}, True),
        ("gps", 0, gps(0.0, -179.9998), EAST, False),
        ("gps", 0, gps(0.0, -179.9990), EAST, True),
        ("gps", 0, gps(60.0, 10.0008), NORTH, False),  # 44 m
        ("gps", 0, gps(60.0, 10.0010), NORTH, True),
        *(
            ("imu", 0, warm(place, counts), None, not -4000 <= counts <= 8500)
            for place in (24, 26)
            for counts in (-4000, -4001, 8500, 8501)
        ),
        ("ad", 0, ad(1, c1=5099), None, False),
        ("ad", 0, ad(1, c1=5101), None, True),
        ("ad", 3, ad(4, c4=51), None, True),
        ("imu", 0, imu(rate=39_900), None, False),  # 1.995 deg/s
        ("imu", 0, imu(rate=40_100), None, True),
        ("imu", 0, imu(force_z=109_900), None, False),
        ("imu", 0, imu(force_z=110_100), None, True),
        ("imu", 0, imu(force_z=89_900), None, True),
    ],
)
def test_on_both_sides_of_a_limit(
    command: str, number: int, answer: bytes, site: dict[str, float] | None, fails: bool
) -> None:
    more = {} if site is None else {"site": site}
    assert failed(changed(command, answered(answer, number)), **more) == ({command} if fails else set())


def test_a_memory_test_of_nothing_is_no_pass() -> None:
    """RAM with 0x55 over no bytes: nothing wrong, nothing checked."""
    empty = {"sent": struct.pack("<BBBII", 0, 0, 0, 0, 0), "received": WORDS.pack(0, 0, 0, 0, 0, 0)}
    assert failed(changed("memory", lambda at, one: replace(one, **empty) if at == 0 else one)) == {"memory"}


def test_limits_without_a_sequence_are_those_of_the_paper() -> None:
    """Table 3: 26 x 26 x 32 mm, 5 V and 0.49 A within 5 %, 10 deg/h, 2 mg, couplings of 0.001; a timer within 1 %."""
    limits = limits_of({})
    assert [limits[name] for name in ("width", "depth", "height")] == [0.026, 0.026, 0.032]
    assert [limits[f"supply_{name}"] for name in ("voltage", "current")] == [5.0, 0.49]
    assert limits["supply_voltage_deviation"] == limits["supply_current_deviation"] == 0.05
    assert 3600.0 * limits["gyro_bias_stability"] == pytest.approx(10.0)
    assert 1e3 * limits["accel_bias_stability"] == pytest.approx(2.0)
    assert limits["gyro_cross_coupling"] == limits["accel_cross_coupling"] == 1e-3
    assert [limits["timer_interval_error"], limits["timer_ticks"]] == [0.01, 20.0]
    assert [limits["horizontal_error"], limits["height_error"]] == [10.0, 15.0]
    slow = changed("timer", answered(struct.pack("<20IB", *[1011] * 20, 20), 1))
    assert failed(slow, limits={"timer_interval_error": {"value": 2.0, "unit": "%"}}) == set()  # the sequence wins


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        ({"timer_interval_eror": {"value": 1.0, "unit": "%"}}, "did you mean 'timer_interval_error'"),
        ({"timer_interval_error": {"value": 1.0, "unit": "V"}}, "quantity of V|is a quantity|V"),
        ({"timer_interval_error": {"value": 1.0}}, "unit"),
    ],
)
def test_limits_that_are_not_usable(limits: dict[str, Any], says: str) -> None:
    with pytest.raises(FitError, match=f"B-GNC-001.*({says})"):
        analyse(material(exchanges(), limits=limits))


def test_nothing_tested() -> None:
    with pytest.raises(FitError, match="B-GNC-002"):
        analyse(material([], []))


def test_an_item_that_nobody_judges_neither_passes_nor_fails() -> None:
    found = [*exchanges(), replace(exchanges()[0], item="vibration")]
    analysis = analyse(material(found))
    assert "vibration" not in verdicts(found)
    assert analysis.missing == []
    assert json.loads(analysis.attachments["GNC-01/vibration/result.json"])["verdict"] == "not tested"
    assert json.loads(analysis.attachments["GNC-01/summary.json"])["verdict"] == "pass"
    table = analysis.tables[1]
    assert dict(zip(table.headers, table.rows[0], strict=True))["vibration"] == "not tested"
    stray = replace(exchanges()[0], item="gps")  # another command under the name of an item is no test of it
    assert failed([*exchanges(), stray]) == {"gps"}
    assert failed([*(one for one in exchanges() if one.item != "gps"), stray]) == {"gps"}
