"""Judges of the test items: the processor and its interfaces (arithmetic, timer, memories; IO loop-back, SPI, SCI, CAN,
serial number), the sensors and the supply (IMU, satellite navigation, analogue inputs; voltage at the board and current
of the module), and the static checks (sizes and resistances that a person measured before a unit was powered).

Source: GNC-module paper, table 1, section 3 (2) and 5.1 (checks before power); limits of ranges, of the supply and of
the size in table 3. A random pair of IO lines is not enough, all ordered pairs are due.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

from bench.analysis import Document, GivenValue, Reading
from bench.model.units import plain_quantity
from bench.systems.gnc.estimators.sensor_noise import expected_range
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.unit_test.answers import Answer, Findings, Wrong, whole
from bench.systems.gnc.wording import quantity_word, say


@dataclass(frozen=True)
class Rules:
    """Rules by which modules are judged: their limits, and ``imu`` and ``site`` as the sequence states them."""

    limits: Limits
    imu: Document
    site: Document


def judge(item: str, answers: Sequence[Answer], rules: Rules) -> Findings:
    """Return what the commands of an item show, which of them are wrong, and what was never asked for."""
    findings = Findings()
    for answer in whole(answers, findings):
        JUDGES[item](answer, rules, findings)
    names, due = _DUE.get(item, ((), {}))
    asked = {tuple(answer.asked.get(name) for name in names) for answer in answers}
    for request, what in due.items():
        if request not in asked:
            findings.missing(answers[-1].exchange.begin_s, what)
    if item in _TOGETHER:
        _TOGETHER[item](answers, findings)
    return findings


IDENTITY = "identify"
OPERATIONS = ("addition", "subtraction", "multiplication", "division")
SETTINGS_us = (500, 1000, 2000, 5000)
REGIONS = ("RAM", "SDRAM", "SPI FLASH", "internal FLASH")
PATTERNS = ("0x55", "0xAA", "address")
_WRITTEN, _FLASH = (0, 1), (2, 3)  # regions
_WRITE_READ, _ERASE, _BLANK, _PROGRAM, _VERIFY = range(5)
_FLASH_ORDER = (_ERASE, _BLANK, _PROGRAM, _VERIFY)
_STEPS = ("write_read", "erase", "blank_check", "program", "verify")
_WORD = 4  # bytes
_TICK_STD_us = 12.0**-0.5  # intervals are whole microseconds
LINES = (1, 2, 3, 4)
_SERIAL_BYTES = 12


def judge_cpu(answer: Answer, rules: Rules, findings: Findings) -> None:
    """All four operations must be done, none of them wrong, and no memory cell either."""
    fields = answer.fields
    for name, done, wrong in zip(OPERATIONS, fields["operations"], fields["wrong"], strict=True):
        operation = say(f"cpu.{name}")
        first = say("cpu.first", count=wrong, due=fields["first_expected"], came=fields["first_received"])
        findings.expect(done > 0, answer, say("cpu.not_done", operation=operation), say("cpu.some"), done)
        what = say("cpu.wrong", operation=operation, wrong=wrong, done=done)
        findings.expect(wrong == 0, answer, what, 0, first)
    findings.expect(fields["memory_wrong"] == 0, answer, say("cpu.memory"), 0, fields["memory_wrong"])


def judge_timer(answer: Answer, rules: Rules, findings: Findings) -> None:
    """At every setting as many interrupts as asked for, 20 at least, none of the intervals off by more than 1 %."""
    most, least = rules.limits["timer_interval_error"], int(rules.limits["timer_ticks"])
    setting, ticks = answer.asked.get("setting_us", 0), answer.asked.get("ticks", 0)
    if not setting:
        return
    intervals = answer.fields["intervals_us"][:ticks]
    due = max(ticks, least)
    findings.expect(len(intervals) >= due, answer, say("timer.few", setting=setting), due, len(intervals))
    heard = answer.fields["interrupts"]
    findings.expect(heard == ticks and heard >= least, answer, say("timer.interrupts", setting=setting), due, heard)
    errors = [value / setting - 1.0 for value in intervals]
    outside = sum(abs(error) > most for error in errors)
    worst = max(errors, key=abs, default=0.0)
    what = say("timer.outside", setting=setting, outside=outside, count=len(errors), most=100 * most)
    findings.expect(not outside, answer, what, setting, say("timer.worst", worst=setting * (1 + worst)))
    if errors:
        place = {"setting_ms": setting / 1000.0}
        std = _TICK_STD_us / setting
        findings.measure("timer_interval_error", "1", worst, std, place, most, len(errors))


def judge_memory(answer: Answer, rules: Rules, findings: Findings) -> None:
    """RAM and SDRAM with every pattern; FLASH erased, blank, programmed, verified in this order, erased once each."""
    asked, fields = answer.asked, answer.fields
    if not asked:
        return
    what = say("memory.wrong", place=_of_memory(answer), wrong=fields["wrong"], checked=fields["checked"])
    first = say(
        "memory.first",
        count=fields["wrong"],
        address=fields["address"],
        came=fields["received"],
        due=fields["expected"],
    )
    findings.expect(fields["wrong"] == 0, answer, what, 0, first)
    due = asked["length"] // _WORD
    text = say("memory.checked", place=_of_memory(answer))
    findings.expect(0 < due == fields["checked"], answer, text, max(due, 1), fields["checked"])


def _of_memory(answer: Answer) -> str:
    operation, region = answer.asked["operation"], REGIONS[answer.asked["region"]]
    if operation == _WRITE_READ:
        return say("memory.write_read", region=region, pattern=PATTERNS[answer.asked["pattern"]])
    step = say(f"memory.{_STEPS[operation]}") if operation < len(_STEPS) else str(operation)
    return say("memory.step", region=region, step=step)


def judge_flash(answers: Sequence[Answer], findings: Findings) -> None:
    """Each FLASH goes through a whole cycle, and is erased as often as that was asked for."""
    for region in _FLASH:
        if not _in_order([answer.asked["operation"] for answer in answers if answer.asked.get("region") == region]):
            findings.missing(answers[-1].exchange.begin_s, say("memory.cycle", region=REGIONS[region]))
    for region in _FLASH:
        _erases([answer for answer in answers if answer.asked.get("region") == region and answer.fields], findings)


def _in_order(steps: Sequence[int]) -> bool:
    """Return True if the steps hold a whole FLASH cycle, in its order."""
    left = iter(steps)
    return all(step in left for step in _FLASH_ORDER)


def _erases(answers: Sequence[Answer], findings: Findings) -> None:
    """Every erase that was asked for counts once, whatever had to be repeated on the link; nothing else erases."""
    for before, after in pairwise(answers):
        due = before.fields["erases"] + (after.asked["operation"] == _ERASE)
        findings.expect(
            after.fields["erases"] == due,
            after,
            say("memory.erases", place=_of_memory(after)),
            due,
            after.fields["erases"],
        )


def judge_io(answer: Answer, rules: Rules, findings: Findings) -> None:
    """Each of the 12 ordered pairs of lines at both levels: the input reads the level, no other line follows."""
    if answer.asked:
        line = say("io.line", output=answer.asked["output"], input=answer.asked["input"])
        level, read = answer.asked["level"], answer.fields["read"]
        findings.expect(read == level, answer, say("io.level", line=line), level, read)
        findings.expect(
            answer.fields["others"] == 0, answer, say("io.others", line=line), 0, bin(answer.fields["others"])
        )


def judge_spi(answer: Answer, rules: Rules, findings: Findings) -> None:
    """The word comes back, and the IO lines beside the bus saw the same."""
    word = answer.asked.get("word")
    for name in ("received", "observed"):
        value = answer.fields[name]
        findings.expect(value == word, answer, say(f"spi.{name}"), _word(word), _word(value))


def judge_sci(answer: Answer, rules: Rules, findings: Findings) -> None:
    """Return what was sent comes back unchanged, and it is not nothing."""
    sent, echo = str(answer.asked.get("pattern", "")), str(answer.fields["echo"])
    findings.expect(bool(sent), answer, say("sci.nothing"), say("sci.pattern"), say("sci.none"))
    findings.expect(echo == sent, answer, say("sci.echo"), sent, echo)


def judge_identifiers(answers: Sequence[Answer], findings: Findings) -> None:
    """CAN answers under the identifier it was sent with."""
    for answer in answers:
        if answer.fields:
            sent, received = answer.asked.get("identifier"), answer.fields["identifier"]
            findings.expect(received == sent, answer, say("can.identifier"), sent, received)


def judge_identity(answer: Answer, rules: Rules, findings: Findings) -> None:
    """The serial number that the module gives is that of the unit that should be in the socket, its first 12 signs."""
    unit = str(answer.exchange.conditions.get("unit", ""))[:_SERIAL_BYTES]
    told = bytes.fromhex(answer.fields["unit_serial"]).decode("ascii", "replace").strip(" \0")
    findings.expect(not unit or told == unit, answer, say("identify.serial"), unit, told)


def _word(value: int | None) -> str:
    return say("unknown") if value is None else f"{value:#06x}"


AXES = ("x", "y", "z")
SOURCES_V: Mapping[int, tuple[str, float]] = {1: ("5 V", 5.0), 2: ("3.3 V", 3.3), 3: ("1.2 V", 1.2), 4: ("GND", 0.0)}
_FLOATING_DIP = 5
_MAGNETIC = 3  # channels in front of those that the DIP switches feed
_MIDDLE_V, _V_gauss = 2.5, 0.2
# Fewer samples of a sound sensor may be equal by chance: its noise is 14 steps wide for gyros, 1 for accelerometers.
_ENOUGH = {"gyro": 5, "accel": 20}
_FIX_3D = 3
_SIGMAS = 5.0
_METRES_deg = 111_195.0  # of latitude
_COORDINATES_deg = {"latitude": 90.0, "longitude": 180.0}
_HEIGHTS_m = (-500.0, 9000.0)
_MEASURED = {"measure_voltage": ("supply_voltage", "V"), "measure_current": ("supply_current", "A")}
_SENT = say("static.question")


def judge_imu(answer: Answer, rules: Rules, findings: Findings) -> None:
    """Ten values of a module at rest: rates small, 1 g in all, temperatures possible; nothing frozen or saturated."""
    imu, limits, fields = rules.imu, rules.limits, answer.fields
    ranges = {"gyro": float(imu.get("gyro_range_deg_s", 400.0)), "accel": float(imu.get("accel_range_g", 50.0))}
    noise = {kind: _noise(fields, kind) for kind in ranges}
    for k, (axis, rate) in enumerate(zip(AXES, fields["gyro"], strict=True)):
        most = limits["gyro_at_rest"]
        due = say("within.unit", most=most, unit="deg/s")
        findings.expect(abs(rate) <= most, answer, say("imu.rate", axis=axis), due, f"{rate:.4f}")
        findings.measure("imu_rate", "deg/s", rate, noise["gyro"][k], {"axis": axis})
    for k, (axis, force) in enumerate(zip(AXES, fields["accel"], strict=True)):
        findings.measure("imu_acceleration", "g", force, noise["accel"][k], {"axis": axis})
    size, most = math.hypot(*fields["accel"]), limits["acceleration_error"]
    due = say("within.of", due=1.0, most=most, unit="g")
    findings.expect(abs(size - 1.0) <= most, answer, say("imu.force"), due, f"{size:.4f} g")
    _temperatures(answer, limits, findings)
    for kind, reach in ranges.items():
        _alive(answer, kind, reach, findings)


def _noise(fields: Document, kind: str) -> list[float]:
    """Return the standard uncertainty of each mean, by the span of its samples."""
    spans, samples = zip(fields[f"{kind}_low"], fields[f"{kind}_high"], strict=True), fields["samples"]
    if samples < 2:
        return [0.0 for _ in spans]
    deviations = expected_range(samples) * math.sqrt(samples)
    return [(high - low) / deviations for low, high in spans]


def _temperatures(answer: Answer, limits: Limits, findings: Findings) -> None:
    low, high = limits["imu_temperature_low"], limits["imu_temperature_high"]
    for kind in ("gyro", "accel"):
        value = answer.fields[f"{kind}_temperature"]
        due = say("between.unit", low=low, high=high, unit="degC")
        findings.expect(low <= value <= high, answer, say(f"imu.temperature.{kind}"), due, f"{value:.2f} degC")
        findings.measure("imu_temperature", "degC", value, 0.0, {"kind": kind})


def _alive(answer: Answer, kind: str, reach: float, findings: Findings) -> None:
    taken, due = answer.fields["samples"], answer.asked.get("samples", 0)
    if kind == "gyro":
        findings.expect(taken == due, answer, say("imu.samples"), due, taken)
    lows, highs = answer.fields[f"{kind}_low"], answer.fields[f"{kind}_high"]
    for axis, low, high in zip(AXES, lows, highs, strict=True):
        frozen = low == high and taken >= _ENOUGH[kind]
        sensor = say(f"imu.sensor.{kind}", axis=axis)
        times = say("imu.times", count=taken, value=low)
        findings.expect(not frozen, answer, say("imu.frozen", sensor=sensor), say("imu.differ"), times)
        saturated = max(abs(low), abs(high)) >= reach
        due_text, span = say("within", most=reach), say("between", low=low, high=high)
        findings.expect(not saturated, answer, say("imu.saturated", sensor=sensor), due_text, span)


def judge_gps(answer: Answer, rules: Rules, findings: Findings) -> None:
    """A fix in three dimensions, satellites enough, and a position that can be that of the bench.

    The position of one fix may be off by five times the 1-sigma figures of table 3: enough to tell a receiver that
    works from one that does not, and no test of its accuracy.
    """
    fields = answer.fields
    findings.expect(fields["fix"] == _FIX_3D, answer, say("gps.fix"), say("gps.three"), fields["fix"])
    least = int(rules.limits["gps_satellites"])
    due = say("gps.or_more", least=least)
    findings.expect(fields["satellites"] >= least, answer, say("gps.satellites"), due, fields["satellites"])
    _place(answer, rules.limits, rules.site, findings)
    findings.measure("gps_satellites", "1", float(fields["satellites"]))
    for name in ("latitude", "longitude"):
        findings.measure(f"gps_{name}", "deg", fields[name])
    findings.measure("gps_height", "m", fields["height"])
    findings.measure("gps_time_to_fix", "s", fields["time_to_fix"] / 1000.0)


def _place(answer: Answer, limits: Limits, site: Document, findings: Findings) -> None:
    """Against the site as far as the sequence states it; a coordinate it does not state must only be one on Earth."""
    reach_m = _SIGMAS * limits["horizontal_error"]
    latitude, longitude = answer.fields["latitude"], answer.fields["longitude"]
    scale_m = {"latitude": _METRES_deg, "longitude": _METRES_deg * math.cos(math.radians(latitude))}
    for name, value in (("latitude", latitude), ("longitude", longitude)):
        due, most = site.get(f"{name}_deg"), _COORDINATES_deg[name]
        away = 0.0 if due is None else (value - float(due) + 180.0) % 360.0 - 180.0  # 180 East is 180 West
        ok = abs(value) <= most if due is None else abs(away) * scale_m[name] <= reach_m
        text = (
            say("between.unit", low=-most, high=most, unit="deg")
            if due is None
            else say("gps.near", due=float(due), reach=reach_m)
        )
        findings.expect(ok, answer, say(f"gps.{name}"), text, f"{value:.6f} deg")
    due, height, reach_m = site.get("height_m"), answer.fields["height"], _SIGMAS * limits["height_error"]
    ok = _HEIGHTS_m[0] <= height <= _HEIGHTS_m[1] if due is None else abs(height - float(due)) <= reach_m
    text = (
        say("between.unit", low=_HEIGHTS_m[0], high=_HEIGHTS_m[1], unit="m")
        if due is None
        else say("within.of", due=float(due), most=reach_m, unit="m")
    )
    findings.expect(ok, answer, say("gps.height"), text, f"{height:.1f} m")


def judge_ad(answer: Answer, rules: Rules, findings: Findings) -> None:
    """Each source on its own DIP switch and on no other channel; the floating channel is reported and never judged."""
    volts, dip, limits = answer.fields["volts"], answer.asked.get("dip", 0), rules.limits
    _field(answer, volts[:_MAGNETIC], limits, findings)
    for switch, (name, source_V) in SOURCES_V.items():
        value = volts[_MAGNETIC + switch - 1]
        due = source_V if switch == dip else 0.0
        most = max(limits["ad_ground"], limits["ad_tolerance"] * due)
        what = say("ad.on" if switch == dip else "ad.off", source=name)
        due_text = say("within.of", due=due, most=most, unit="V")
        findings.expect(abs(value - due) <= most, answer, what, due_text, f"{value:.3f} V")
        if switch == dip:
            findings.measure("ad_volts", "V", value, 0.0, {"source": name})
    if dip == _FLOATING_DIP:
        findings.remarks.append(say("ad.floating", value=volts[_MAGNETIC + _FLOATING_DIP - 1]))


def _field(answer: Answer, volts: Sequence[float], limits: Limits, findings: Findings) -> None:
    """The magnetometer outputs must be those of a field that the Earth and the module around them can give."""
    gauss = [(value - _MIDDLE_V) / _V_gauss for value in volts]
    low, high = limits["ad_field_low"], limits["ad_field_high"]
    size = math.hypot(*gauss)
    received = f"{size:.3f} gauss ({', '.join(f'{value:.3f} V' for value in volts)})"
    due = say("between.unit", low=low, high=high, unit="gauss")
    findings.expect(low <= size <= high, answer, say("ad.field"), due, received)


JUDGES: Mapping[str, Callable[[Answer, Rules, Findings], None]] = {
    # the six rows of table 1 of the GNC-module paper, then what its section 3 (2) adds
    "cpu": judge_cpu,
    "timer": judge_timer,
    "memory": judge_memory,
    "imu": judge_imu,
    "gps": judge_gps,
    "ad": judge_ad,
    "io": judge_io,
    "spi": judge_spi,
    "sci": judge_sci,
    "can": judge_sci,
    IDENTITY: judge_identity,
}
_TOGETHER: Mapping[str, Callable[[Sequence[Answer], Findings], None]] = {
    "memory": judge_flash,
    "can": judge_identifiers,
}
# names of what a request says, and the sentence on each request that is due
_DUE: Mapping[str, tuple[tuple[str, ...], Mapping[tuple[int, ...], str]]] = {
    "timer": (("setting_us",), {(setting,): say("timer.setting", setting=setting) for setting in SETTINGS_us}),
    "memory": (
        ("region", "operation", "pattern"),
        {
            (region, _WRITE_READ, number): say("memory.pattern", region=REGIONS[region], pattern=pattern)
            for region in _WRITTEN
            for number, pattern in enumerate(PATTERNS)
        },
    ),
    "ad": (
        ("dip",),
        {(switch,): say("ad.switch", switch=switch, source=name) for switch, (name, _) in SOURCES_V.items()},
    ),
    "io": (
        ("output", "input", "level"),
        {
            (*pair, level): say("io.at_level", line=say("io.line", output=pair[0], input=pair[1]), level=level)
            for pair in permutations(LINES, 2)
            for level in (0, 1)
        },
    ),
}


def judge_supply(readings: Sequence[Reading], limits: Limits) -> tuple[Findings, list[Reading]]:
    """Voltage 5 V and current 0.49 A, each within 5 % unless the sequence says otherwise; and the readings used."""
    findings, used = Findings(), []
    for reading in readings:
        if reading.name not in _MEASURED:
            continue
        used.append(reading)
        quantity, unit = _MEASURED[reading.name]
        due, most = limits[quantity], limits[f"{quantity}_deviation"]
        sent = f"{reading.role} {reading.name}"
        due_text = say("within.percent", due=due, unit=unit, most=100 * most)
        if not isinstance(reading.value, int | float):
            findings.wrong.append(
                Wrong(reading.t_s, say("supply.no_reading", quantity=quantity), sent, due_text, say("nothing"))
            )
            continue
        value, place = float(reading.value), {"role": reading.role}
        deviation = value / due - 1.0
        findings.measure(quantity, unit, value, 0.0, place)
        findings.measure(f"{quantity}_deviation", "1", deviation, 0.0, place, most)
        if not abs(deviation) <= most:
            findings.wrong.append(Wrong(reading.t_s, quantity_word(quantity), sent, due_text, f"{value:.4f} {unit}"))
    taken = {reading.name for reading in used}
    for name, (quantity, _) in _MEASURED.items():
        if used and name not in taken:
            text, nothing = say("supply.unmeasured", quantity=quantity_word(quantity)), say("nothing")
            findings.wrong.append(Wrong(used[-1].t_s, text, nothing, say("supply.a_reading"), nothing))
    return findings, used


def judge_static(given: Sequence[GivenValue], limits: Limits) -> Findings:
    """Each value within the limits it was asked with, a size within that of the specification too.

    Each is two quantities: the value, and by how much it is outside its limits, which is judged (limit 0).
    """
    findings = Findings()
    for check in given:
        low = -math.inf if check.low is None else check.low
        high = min(math.inf if check.high is None else check.high, limits.get(check.quantity, math.inf))
        due = _due(low, high, check.unit)
        if check.value is None or not math.isfinite(check.value):
            findings.wrong.append(
                Wrong(check.t_s, say("static.no_value", quantity=check.quantity), _SENT, due, say("nothing"))
            )
            continue
        beyond = max(low - check.value, check.value - high, 0.0)
        findings.measure(check.quantity, check.unit, check.value)
        findings.measure(f"{check.quantity}_beyond_limits", check.unit, beyond, limit=0.0)
        if beyond > 0.0:
            received = plain_quantity(check.value, check.unit)
            findings.wrong.append(Wrong(check.t_s, quantity_word(check.quantity), _SENT, due, received))
    return findings


def _due(low: float, high: float, unit: str) -> str:
    least, most = plain_quantity(low, unit), plain_quantity(high, unit)
    if math.isfinite(low) and math.isfinite(high):
        return say("static.between", least=least, most=most)
    if math.isfinite(low):
        return say("static.least", least=least)
    return say("static.most", most=most) if math.isfinite(high) else ""
