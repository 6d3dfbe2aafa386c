"""Judges of the sensors: IMU, satellite navigation, analogue inputs.

Source: GNC-module paper, table 1, rows 4 to 6, and section 3 (2) 4; limits of ranges in table 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bench.systems.gnc.limits import Limits
from bench.systems.gnc.unit_test.answers import Answer, Findings, Measured, whole

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


def judge_imu(answers: Sequence[Answer], limits: Limits, imu: Mapping[str, Any]) -> Findings:
    """Ten values of a module at rest: rates small, 1 g in all, temperatures possible; nothing frozen or saturated."""
    found = Findings()
    ranges = {"gyro": float(imu.get("gyro_range_deg_s", 400.0)), "accel": float(imu.get("accel_range_g", 50.0))}
    for one in whole(answers, found):
        fields = one.fields
        noise = {kind: _noise(fields, kind) for kind in ranges}
        for k, (axis, rate) in enumerate(zip(AXES, fields["gyro"], strict=True)):
            most = limits["gyro_at_rest"]
            found.expect(abs(rate) <= most, one, f"rate {axis} at rest", f"within {most:g} deg/s", f"{rate:.4f}")
            found.measured.append(Measured("imu_rate", "deg/s", rate, noise["gyro"][k], {"axis": axis}))
        for k, (axis, force) in enumerate(zip(AXES, fields["accel"], strict=True)):
            found.measured.append(Measured("imu_acceleration", "g", force, noise["accel"][k], {"axis": axis}))
        size, most = math.hypot(*fields["accel"]), limits["acceleration_error"]
        found.expect(abs(size - 1.0) <= most, one, "specific force at rest", f"1 g within {most:g} g", f"{size:.4f} g")
        _temperatures(one, limits, found)
        for kind, reach in ranges.items():
            _alive(one, kind, reach, found)
    return found


def _noise(fields: Mapping[str, Any], kind: str) -> list[float]:
    """Standard uncertainty of each mean by the span of its samples, four standard deviations for some tens of them."""
    spans = zip(fields[f"{kind}_low"], fields[f"{kind}_high"], strict=True)
    return [(high - low) / 4.0 / math.sqrt(max(fields["samples"], 1)) for low, high in spans]


def _temperatures(one: Answer, limits: Limits, found: Findings) -> None:
    low, high = limits["imu_temperature_low"], limits["imu_temperature_high"]
    for kind in ("gyro", "accel"):
        value = one.fields[f"{kind}_temperature"]
        due = f"{low:g} to {high:g} degC"
        found.expect(low <= value <= high, one, f"{kind} temperature", due, f"{value:.2f} degC")
        found.measured.append(Measured("imu_temperature", "degC", value, 0.0, {"kind": kind}))


def _alive(one: Answer, kind: str, reach: float, found: Findings) -> None:
    taken, due = one.fields["samples"], one.asked.get("samples", 0)
    if kind == "gyro":
        found.expect(taken == due, one, "samples taken", due, taken)
    lows, highs = one.fields[f"{kind}_low"], one.fields[f"{kind}_high"]
    for axis, low, high in zip(AXES, lows, highs, strict=True):
        frozen = low == high and taken >= _ENOUGH[kind]
        found.expect(not frozen, one, f"{kind} {axis} is frozen", "values that differ", f"{taken} times {low:g}")
        saturated = max(abs(low), abs(high)) >= reach
        found.expect(not saturated, one, f"{kind} {axis} is at its limit", f"within {reach:g}", f"{low:g} to {high:g}")


def judge_gps(answers: Sequence[Answer], limits: Limits, site: Mapping[str, Any]) -> Findings:
    """A fix in three dimensions, satellites enough, and a position that can be that of the bench.

    The position of one fix may be off by five times the 1-sigma figures of table 3: enough to tell a receiver that
    works from one that does not, and no test of its accuracy.
    """
    found = Findings()
    for one in whole(answers, found):
        fields = one.fields
        found.expect(fields["fix"] == _FIX_3D, one, "fix", "3 (three dimensions)", fields["fix"])
        least = int(limits["gps_satellites"])
        found.expect(fields["satellites"] >= least, one, "satellites", f"{least} or more", fields["satellites"])
        _place(one, limits, site, found)
        found.measured.append(Measured("gps_satellites", "1", float(fields["satellites"])))
        for name in ("latitude", "longitude"):
            found.measured.append(Measured(f"gps_{name}", "deg", fields[name]))
        found.measured.append(Measured("gps_height", "m", fields["height"]))
        found.measured.append(Measured("gps_time_to_fix", "s", fields["time_to_fix"] / 1000.0))
    return found


def _place(one: Answer, limits: Limits, site: Mapping[str, Any], found: Findings) -> None:
    """Against the site as far as the sequence states it; a coordinate it does not state must only be one on Earth."""
    reach_m = _SIGMAS * limits["horizontal_error"]
    latitude, longitude = one.fields["latitude"], one.fields["longitude"]
    scale_m = {"latitude": _METRES_deg, "longitude": _METRES_deg * math.cos(math.radians(latitude))}
    for name, value in (("latitude", latitude), ("longitude", longitude)):
        due, most = site.get(f"{name}_deg"), _COORDINATES_deg[name]
        away = 0.0 if due is None else (value - float(due) + 180.0) % 360.0 - 180.0  # 180 East is 180 West
        ok = abs(value) <= most if due is None else abs(away) * scale_m[name] <= reach_m
        text = f"-{most:g} to {most:g} deg" if due is None else f"{float(due):.5f} deg within {reach_m:g} m"
        found.expect(ok, one, name, text, f"{value:.6f} deg")
    due, height, reach_m = site.get("height_m"), one.fields["height"], _SIGMAS * limits["height_error"]
    ok = _HEIGHTS_m[0] <= height <= _HEIGHTS_m[1] if due is None else abs(height - float(due)) <= reach_m
    text = f"{_HEIGHTS_m[0]:g} to {_HEIGHTS_m[1]:g} m" if due is None else f"{float(due):g} m within {reach_m:g} m"
    found.expect(ok, one, "height", text, f"{height:.1f} m")


def judge_ad(answers: Sequence[Answer], limits: Limits) -> Findings:
    """Each source on its own DIP switch and on no other channel; the floating channel is reported and never judged."""
    found = Findings()
    for one in whole(answers, found):
        volts, dip = one.fields["volts"], one.asked.get("dip", 0)
        _field(one, volts[:_MAGNETIC], limits, found)
        for switch, (name, source_V) in SOURCES_V.items():
            value = volts[_MAGNETIC + switch - 1]
            due = source_V if switch == dip else 0.0
            most = max(limits["ad_ground"], limits["ad_tolerance"] * due)
            state = "on" if switch == dip else "off"
            due_text = f"{due:g} V within {most:g} V"
            found.expect(abs(value - due) <= most, one, f"{name}, its switch {state}", due_text, f"{value:.3f} V")
            if switch == dip:
                found.measured.append(Measured("ad_volts", "V", value, 0.0, {"source": name}))
        if dip == _FLOATING_DIP:
            text = f"floating channel: {volts[_MAGNETIC + _FLOATING_DIP - 1]:.3f} V (reported, not judged)"
            found.remarks.append(text)
    asked = {one.asked.get("dip") for one in answers}
    for switch, (name, _) in SOURCES_V.items():
        if switch not in asked:
            found.missing(answers[-1].exchange.begin_s, f"DIP switch {switch} ({name})")
    return found


def _field(one: Answer, volts: Sequence[float], limits: Limits, found: Findings) -> None:
    """The magnetometer outputs must be those of a field that the Earth and the module around them can give."""
    gauss = [(value - _MIDDLE_V) / _V_gauss for value in volts]
    low, high = limits["ad_field_low"], limits["ad_field_high"]
    size = math.hypot(*gauss)
    received = f"{size:.3f} gauss ({', '.join(f'{value:.3f} V' for value in volts)})"
    found.expect(low <= size <= high, one, "field of the magnetometer", f"{low:g} to {high:g} gauss", received)
