"""Points of an AF converter as a stranger records them: pulses by adding charge up, a meter beside, one temperature."""

from typing import Any

import numpy as np
from stranger_page import Session, documented_campaign, documented_standards, packed, shipped

SECONDS, PAUSE_s, RATE_Hz = 10, 1, 100
K0_C, BIAS_A = 1.25e-6, 3e-8
TRUTH_ppm = {"dsf_n": 412.0, "dsf_p": -230.0}
LEVELS_A = (1e-3, 1e-2, 1e-1)
METER_ZERO_A = 4e-9
THERMOMETER = """\
frame: thermometer
title: A stranger's thermometer
endian: little
sync: [0x54, 0x48]
rate: 1 Hz
fields:
  - {name: counter, type: u16, role: counter}
  - {name: unit_temperature, type: i16, scale: 0.01, unit: degC}
crc: {name: crc-16/ibm-3740, over: [counter, end], stored: little}
golden: 54 48 11 00 d3 07 40 d9
expect: {counter: 17, unit_temperature: 20.03}
"""
PORT_A = np.dtype(
    [("counter", ">u2"), ("npp", ">u2", 10), ("ppp", ">u2", 10), ("clocks", "u1", (3, 3)), ("status", ">u2")]
)
_CLOCKS = [list(int(count).to_bytes(3, "big")) for count in (2560, 100_000, 100_000)]


def points() -> list[dict[str, Any]]:
    common = {"channel": 1, "kind": "gyro", "temperature_degC": 20.0, "repeat": 0}
    closed = [
        {"current_A": level_A, "polarity": polarity, "range_A": 2.2 * (level_A or LEVELS_A[0]), "route": "closed"}
        for level_A in (0.0, *LEVELS_A)
        for polarity in (1, -1)
    ]
    return [{**common, "route": "open"}, *({**common, **point} for point in closed)]


def pulses(current_A: float, frames: int) -> tuple[Any, Any]:
    """N and P pulses of each frame: whole charges of a constant current, an error of the charge for each sign."""
    total_A = current_A - BIAS_A
    charge_C = K0_C * (1.0 + 1e-6 * TRUTH_ppm["dsf_n" if total_A > 0.0 else "dsf_p"])
    counts = np.diff(np.floor(np.arange(frames + 1) * abs(total_A) / RATE_Hz / charge_C + 0.5)).astype(int)
    return (counts, 0 * counts) if total_A > 0.0 else (0 * counts, counts)


def _said(session: Session, counter: int, current_A: float, seconds: int) -> int:
    """Frames of both ports over some seconds; returns the next counter."""
    n = seconds * RATE_Hz
    body = np.zeros(n, PORT_A)
    body["counter"] = (counter + np.arange(n)) % 65536
    body["npp"][:, 0], body["ppp"][:, 0] = pulses(current_A, n)
    body["clocks"] = _CLOCKS
    frames = packed(b"\xeb\x90", body, "crc-16/ibm-3740", "big")
    for second in range(seconds):
        at = counter // RATE_Hz + second
        warm = np.array([(at, 2003)], [("counter", "<u2"), ("unit_temperature", "<i2")])
        session.frames("port_b", at + 1.0, packed(b"TH", warm, "crc-16/ibm-3740")[0])
        session.frames("port_a", at + 1.0, b"".join(frames[RATE_Hz * second : RATE_Hz * (second + 1)]))
    return counter + n


def converter_session(analysis: str, swapped: bool = False) -> Session:
    """Open input, zeros and levels of both polarities of channel 1; before each the readings of a meter."""
    standards = documented_standards()
    standards["calibrator"] |= {
        "uncertainty": [{"range_A": 2.2 * level_A, "relative": 2e-5, "floor_A": 1e-9} for level_A in LEVELS_A],
        "corrections": [],
    }
    if analysis == "dmm_method":
        meter = [{"range_A": level_A, "relative": 2e-5, "floor_A": 1e-9} for level_A in LEVELS_A]
        standards = {"dmm": {"model": "3458A", "serial": "1", "uncertainty": meter}}
    campaign = documented_campaign("scale_factor") | {"analysis": analysis}
    session = Session(campaign, {"port_a": shipped("ngu_a"), "port_b": THERMOMETER}, standards=standards)
    for number, level_A in enumerate(LEVELS_A if analysis == "dmm_method" else ()):
        _metered(session, 0.1 * number, level_A, 0.0, zero_range_A=level_A)
    counter, lead = 0, -1 if swapped else 1
    for point in points():
        current_A = point.get("current_A", 0.0) * point.get("polarity", 0)
        if analysis == "dmm_method" and point["route"] == "closed":
            range_A = max(LEVELS_A[0], point["current_A"])
            _metered(session, counter / RATE_Hz + 0.4, range_A, abs(current_A))
        begin = _said(session, counter, current_A, PAUSE_s)
        counter = _said(session, begin, lead * current_A, SECONDS)
        session.record(begin, SECONDS * RATE_Hz, begin / RATE_Hz, counter / RATE_Hz, samples=False, **point)
    return session


def _metered(session: Session, t_s: float, range_A: float, current_A: float, **conditions: Any) -> None:
    """Three readings on one range; the meter has a zero of its own."""
    session.reading(t_s, "dmm", "configure_current", range_A, **conditions)
    for k in range(3):
        session.reading(t_s + 0.01 * (k + 1), "dmm", "measure_current", current_A + METER_ZERO_A, **conditions)


WINDOW_s, LAG_s, RAMP_K0_C = 100, 1200.0, 1e-7
COLD_degC, HOT_degC = 5.0, 35.0
RAMP_BIAS_A, SLOPE_A_degC, WIDTH_A, PLAY_degC = 3e-8, 2e-10, 4e-9, 1.5  # at 20 degC; of the loop, and its half-width
BRANCHES = (("hold_start", 36), ("up", 180), ("hold_top", 36), ("down", 180), ("hold_end", 36))
FRAME = np.dtype([("counter", ">u2"), ("npp", ">u4", 10), ("ppp", ">u4", 10), ("clocks", ">u4", 3), ("status", ">u2")])


def _temperatures() -> tuple[Any, Any]:
    """Of the air and of the unit each 10 s, degC; an hour at rest is in front."""
    corners_s = np.cumsum([0, 3600, *(WINDOW_s * windows for _, windows in BRANCHES)])
    t_s = np.arange(0.0, corners_s[-1] + 1.0, 10.0)
    air = np.interp(t_s, corners_s[2:5], [COLD_degC, HOT_degC, HOT_degC])
    down = t_s > corners_s[4]
    air[down] = np.interp(t_s[down], corners_s[4:6], [HOT_degC, COLD_degC])
    unit = air.copy()
    for k in range(1, t_s.size):
        unit[k] = unit[k - 1] + (air[k - 1] - unit[k - 1]) * 10.0 / LAG_s
    return air, unit


def _bias_A(unit: Any) -> Any:
    """A line over temperature, and half of the loop that follows the turns of the temperature with some play."""
    state, states = -1.0, []
    for step in np.diff(unit, prepend=unit[0]):
        state = min(1.0, max(-1.0, state + step / PLAY_degC))
        states.append(state)
    return RAMP_BIAS_A + SLOPE_A_degC * (unit - 20.0) - 0.5 * WIDTH_A * np.array(states)


def ramp_session() -> Session:
    """There and back, channel 7 alone has a converter."""
    campaign = documented_campaign("scale_factor") | {"analysis": "bias_ramp"}
    channel = {
        "number": 7,
        "kind": "accelerometer",
        "k0_C": RAMP_K0_C,
        "full_scale_A": 0.0242,
        "sensor_full_scale": 20.2,
    }
    campaign["channels"] = [campaign["channels"][0] | channel | {"sensor_unit": "g"}]
    thermometer = THERMOMETER.replace("rate: 1 Hz", "rate: 0.02 Hz")
    session = Session(campaign, {"port_a": shipped("ngu_a_100s"), "port_b": thermometer})
    air, unit = _temperatures()
    for k in range(0, air.size, 6):
        session.event("environment", 10.0 * k, air_degC=air[k], unit_degC=unit[k])
    for number, k in enumerate(range(0, air.size, 5)):
        body = np.array([(number, round(100.0 * unit[k]))], [("counter", "<u2"), ("unit_temperature", "<i2")])
        session.frames("port_b", 10.0 * k, packed(b"TH", body, "crc-16/ibm-3740")[0])
    _windows(session, unit)
    return session


def _windows(session: Session, unit: Any) -> None:
    rng, total = np.random.default_rng(8), sum(windows for _, windows in BRANCHES)
    charge_C = _bias_A(unit)[360:-1].reshape(total, 10).mean(axis=1) * WINDOW_s
    charge_C = charge_C + rng.normal(0.0, 2e-9 * WINDOW_s**0.5, total)
    body = np.zeros(total, FRAME)
    body["counter"] = np.arange(total)
    body["ppp"][:, 6] = np.diff(np.floor(np.concatenate(([0.0], np.cumsum(charge_C))) / RAMP_K0_C))
    body["clocks"] = (25_600_000, 1_000_000_000, 1_000_000_000)
    frames = packed(b"\xeb\xa0", body, "crc-16/ibm-3740", "big")
    branches = [name for name, windows in BRANCHES for _ in range(windows)]
    for number, (frame, branch) in enumerate(zip(frames, branches, strict=True)):
        begin_s = 3600.0 + WINDOW_s * number
        session.frames("port_a", begin_s + WINDOW_s, frame)
        session.record(number, 1, begin_s, begin_s + WINDOW_s, samples=False, route="open", branch=branch)
